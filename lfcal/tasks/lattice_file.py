"""``lattice.json`` as ``lfcal white`` writes it, read again: a lattice is measured once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import (
    FileFormatError,
    InputError,
    check_choice,
    check_number,
    check_tuple,
    check_type,
    parse_json,
    read_text,
)

if TYPE_CHECKING:
    from lfcal.lattice import LatticeFit

__all__ = ["LATTICE_FORMAT", "LATTICE_VERSION", "load_lattice"]

LATTICE_FORMAT, LATTICE_VERSION = "lfcal-lattice", 1
REMEDY = "write it with lfcal white"
MAX_SIDE_PX = 20_000
MIN_PITCH_PX = 4.0
MAX_ANGLE_RAD = 4.0


def load_lattice(path: Path) -> LatticeFit:
    """Return the lattice of a ``lattice.json``; its lenslets are those of its frame, and only dead ones are known.

    Raises
    ------
    FileFormatError
        If the file is something else, or a number in it cannot be.
    """
    data = parse_json(read_text(path), str(path), remedy=REMEDY)
    if not isinstance(data, dict) or (data.get("format"), data.get("version")) != (LATTICE_FORMAT, LATTICE_VERSION):
        raise FileFormatError.expected(
            str(path), f"{LATTICE_FORMAT} of version {LATTICE_VERSION}", "something else", REMEDY
        )
    try:
        return _fit(data)
    except KeyError as error:
        raise FileFormatError.expected(str(path), f"an entry {error}", "none", REMEDY) from None
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from None


def _fit(data: dict[str, Any]) -> LatticeFit:
    import numpy as np

    from lfcal.lattice import LatticeFit

    check_choice("lattice", data["kind"], ("square", "hexagonal"))
    rows, columns = check_tuple("shape", data["shape"], 2, integer=True, at_least=1, at_most=MAX_SIDE_PX)
    numbers = {name: data[name] for name in ("pitch_px", "row_pitch_px", "rotation_rad", "shear_rad")}
    for name, value in numbers.items():
        low, high = (MIN_PITCH_PX, MAX_SIDE_PX) if "pitch" in name else (-MAX_ANGLE_RAD, MAX_ANGLE_RAD)
        check_number(name, value, at_least=low, at_most=high)
    for name in ("pitch_error_px", "residual_rms_px"):
        check_number(name, data[name], at_least=0)
    origin = check_tuple("origin_px", data["origin_px"], 2)
    check_type("dead", data["dead"], list)
    dead = [check_tuple("dead lenslet (q, r)", place, 2, integer=True) for place in data["dead"]]
    empty = np.zeros((0, 2))
    bare = LatticeFit(
        kind=data["kind"],
        shape=(rows, columns),
        origin_px=origin,
        pitch_error_px=data["pitch_error_px"],
        residual_rms_px=data["residual_rms_px"],
        index=empty.astype(np.intp),
        measured_px=empty,
        light=empty[:, 0],
        dead=np.zeros(0, bool),
        distortion=_distortion(data["distortion"]),
        form=str(data["form"]),
        reason=str(data["reason"]),
        **numbers,
    )
    return _with_lenslets(bare, dead)


def _distortion(data: Any) -> Any:
    from lfcal.camera import LatticeDistortion

    if data is None:
        return None
    check_type("distortion", data, dict)
    return LatticeDistortion(data["model"], data["centre_px"], data["scale_px"], data["terms_px"])


def _with_lenslets(bare: LatticeFit, dead: list[tuple[Any, ...]]) -> LatticeFit:
    """Return the fit with every lenslet of its frame, nothing measured, and the dead ones marked."""
    import numpy as np

    index = bare.model.within(bare.shape, 0.5 * bare.pitch_px)
    gone = set(dead)
    nothing = np.full(index.shape, np.nan)
    marked = np.array([(int(q), int(r)) in gone for q, r in index], bool)
    return replace(bare, index=index, measured_px=nothing, light=nothing[:, 0], dead=marked)
