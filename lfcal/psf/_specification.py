"""Check an H file against the published specification of its version, in ``schema/``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import LfcalError
from lfcal.base.h5 import H5File
from lfcal.psf._json_schema import Deviation, deviations
from lfcal.psf.store import REGIONS, VERSION

__all__ = ["SCHEMA", "describe", "deviations_of", "schema"]

SCHEMA = Path(__file__).parent / "schema" / "lfcal-psf-4.schema.json"
EARLIER = Path(__file__).parent / "schema" / "lfcal-psf-2.schema.json"
"""Schema of versions 2 and 3."""


@cache
def schema(version: int = VERSION) -> dict[str, Any]:
    """Return the schema of a version of the format, from 2 on."""
    found: dict[str, Any] = json.loads((SCHEMA if version >= VERSION else EARLIER).read_text(encoding="utf-8"))
    return found


def deviations_of(file: H5File) -> list[str]:
    """Return the deviations of an H file from the specification of its version, one line each with the place."""
    unread: list[str] = []
    description = describe(file, unread)
    found = list(deviations(description, schema(file.attributes().integer("version") or VERSION)))
    return [*unread, *(line for line in map(_line, found) if not any(line.startswith(u.split(":")[0]) for u in unread))]


def describe(file: H5File, unread: list[str]) -> dict[str, Any]:
    """Return an H file in the form that the schema describes: names, types, shapes and attributes, without data.

    Entries that cannot be read are left out and listed in ``unread``.
    """
    whole = _matrix(file, "", unread)
    if REGIONS in file:
        matrices = {name: _matrix(file, f"{REGIONS}/{name}", unread) for name in file.names(REGIONS)}
        whole["groups"] = {REGIONS: {"groups": matrices}}
    return whole


def _matrix(file: H5File, group: str, unread: list[str]) -> dict[str, Any]:
    known = schema(file.attributes().integer("version") or VERSION)["$defs"]["matrix"]["properties"]["datasets"][
        "properties"
    ]
    prefix = f"{group}/" if group else ""
    datasets = {}
    for name in known:
        if f"{prefix}{name}" not in file:
            continue
        try:
            data = file.dataset(f"{prefix}{name}", holes=True)
        except LfcalError as error:
            unread.append(f"/{prefix}{name}: {str(error).partition(': ')[2]}")
            continue
        datasets[name] = {
            "dtype": data.dtype.name,
            "shape": list(data.shape),
            "chunks": None if data.chunks is None else list(data.chunks),
            "attributes": _plain(data.attributes.plain()),
        }
    return {"attributes": _plain(file.attributes(group).plain()), "datasets": datasets}


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: value.tolist() if isinstance(value, np.ndarray | np.generic) else value for name, value in values.items()
    }


def _line(found: Deviation) -> str:
    """Return a deviation with its place in words of HDF5."""
    place = "".join(_steps(found.place))
    # attributes of the file itself have no separate path
    place = place if place.startswith("/") else f"/{place}"
    return f"{place}: {found.what}"


def _steps(place: tuple[str | int, ...]) -> Iterator[str]:
    """Yield the parts of a path: groups and datasets by name, then an attribute or a property."""
    rest = list(place)
    while rest:
        key = rest.pop(0)
        if key in ("groups", "datasets"):
            if rest:
                yield f"/{rest.pop(0)}"
        elif key == "attributes":
            yield f", attribute {rest.pop(0)}" if rest else ", attributes"
        elif isinstance(key, int):
            yield f"[{key}]"
        else:
            yield f", {key}"
