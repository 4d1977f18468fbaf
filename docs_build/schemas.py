"""JSON Schemas of camera, plan and session, made from their records by ``python -m docs_build.schemas``."""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from lfcal.acquire import SessionFile, session_file
from lfcal.acquire.frame_plan import FramePlan
from lfcal.acquire.options import Options
from lfcal.acquire.session_file import Devices, Run
from lfcal.camera import Camera, ScanPlan, description, plan
from lfcal.camera.description import MARKS, Marks

ROOT = Path(__file__).parents[1]
DRAFT = "https://json-schema.org/draft/2020-12/schema"
LEAVES = {float: "number", int: "integer", str: "string", bool: "boolean", NoneType: "null"}

OMITTED: dict[type, frozenset[str]] = {
    Options: frozenset(field.name for field in fields(Options)),
    Devices: frozenset({"optics", "settings", "automatic"}),
    Run: frozenset({"recording", "stage"}),
    SessionFile: frozenset({"kept_aside", "target"}),
}
"""Optional entries of files."""

Schema = dict[str, Any]


class _Maker:
    """Maker of schemas; it collects their definitions by name."""

    def __init__(self) -> None:
        self.definitions: dict[str, Schema] = {}

    def of(self, hint: Any) -> Schema:
        """Return the schema of a type."""
        if hint in LEAVES:
            return {"type": LEAVES[hint]}
        if hint is Marks:
            return {"type": "object", "additionalProperties": {"enum": list(MARKS)}}
        if hint is FramePlan:
            return {"type": "object", "description": "plan of a target"}
        if is_dataclass(hint):
            self._define(hint)
            return {"$ref": f"#/$defs/{hint.__name__}"}
        origin, arguments = get_origin(hint), get_args(hint)
        if origin is UnionType:
            return {"anyOf": [self._choice(one, arguments) for one in arguments]}
        if origin is tuple and arguments[-1] is ...:
            return {"type": "array", "items": self.of(arguments[0])}
        if origin is tuple:
            count = len(arguments)
            return {"type": "array", "items": self.of(arguments[0]), "minItems": count, "maxItems": count}
        assert issubclass(origin, Mapping), hint
        return {"type": "object", "additionalProperties": self.of(arguments[1])}

    def _choice(self, hint: Any, others: tuple[Any, ...]) -> Schema:
        """Return the schema of one type of several; the entry ``type`` distinguishes records."""
        if sum(map(is_dataclass, others)) < 2:
            return self.of(hint)
        made = self.record(hint)
        # a lattice of lenslets without a type is periodic
        optional = hint.__name__ == "LensletLattice"
        made["properties"] = {"type": {"const": hint.__name__}, **made["properties"]}
        made["required"] = [*([] if optional else ["type"]), *made["required"]]
        self.definitions[hint.__name__] = made
        return {"$ref": f"#/$defs/{hint.__name__}"}

    def _define(self, kind: Any) -> None:
        if kind.__name__ not in self.definitions:
            self.definitions[kind.__name__] = {}  # it may contain itself
            self.definitions[kind.__name__] = self.record(kind)

    def record(self, kind: Any) -> Schema:
        """Return the schema of a record: an object with exactly its entries."""
        hints, said = get_type_hints(kind), dict(_described(kind))
        entries = {
            field.name: self.of(hints[field.name]) | ({"description": said[field.name]} if field.name in said else {})
            for field in fields(kind)
        }
        if kind in (Camera, ScanPlan):
            module = description if kind is Camera else plan
            versions = {module.VERSION, getattr(module, "LATTICE_VERSION", module.VERSION)}
            entries = {"format": {"const": module.FORMAT}, "version": {"enum": sorted(versions)}, **entries}
        return {
            "type": "object",
            "properties": entries,
            "required": [name for name in entries if name not in OMITTED.get(kind, ())],
            "additionalProperties": False,
        }


def _described(kind: Any) -> Iterator[tuple[str, str]]:
    """Yield name and description of each attribute in the docstring of a record."""
    text = inspect.getdoc(kind) or ""
    _, _, listed = text.partition("Attributes\n----------\n")
    for entry in re.finditer(r"^(\w[\w, ]*)\n((?:    .*\n?)+)", listed.partition("\n\n")[0] + "\n", re.MULTILINE):
        words = " ".join(entry.group(2).replace("`", "").split())
        yield from ((name.strip(), words) for name in entry.group(1).split(","))


def schemas() -> dict[Path, Schema]:
    """Return the schemas by the path of their files."""
    made = {}
    for kind, module, title in (
        (Camera, description, "Camera of lfcal"),
        (ScanPlan, plan, "Scan plan of lfcal"),
        (SessionFile, session_file, "Session of lfcal"),
    ):
        version = getattr(module, "TARGET_VERSION", module.VERSION)
        maker = _Maker()
        whole = maker.record(kind)
        if kind is SessionFile:
            versions = {"enum": [session_file.VERSION, version]}
            whole["properties"] = {"format": {"const": module.FORMAT}, "version": versions, **whole["properties"]}
            whole["required"] = ["format", "version", *whole["required"]]
        name = f"{module.FORMAT}-{version}"
        head = {"$schema": DRAFT, "$id": f"urn:{name.replace('-', ':')}", "title": f"{title}, version {version}"}
        folder = Path(inspect.getfile(module)).parent / "schema"
        made[folder / f"{name}.schema.json"] = {**head, **whole, "$defs": dict(sorted(maker.definitions.items()))}
    return made


def text_of(schema: Schema) -> str:
    """Return a schema as text."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    for path, schema in schemas().items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text_of(schema), encoding="utf-8")
        print(path.relative_to(ROOT))
