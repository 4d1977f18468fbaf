"""System configuration (.cfg) and metadata (metadata.txt) of Micro-Manager: pixel size, magnification, sensor.

The pixel size in these files refers to the specimen. The pixel size of the sensor is derived from it and from the
magnification, which may appear in the objective's label. Micro-Manager has no information on lenslets.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError, InputError, parse_json
from lfcal.camera.draft import Draft
from lfcal.camera.importers.camera_format import CameraFormat, Imported, ImportOptions

__all__ = ["FORMAT"]

OBJECTIVE = re.compile(r"(?<![\d.])(\d+(?:\.\d+)?)\s*[xX×]|[xX×]\s?(\d+(?:\.\d+)?)(?![\d.])")
"""A magnification in a label, such as ``Nikon 20X Plan Fluor`` or ``Plan-Apo x63``."""
APERTURE = re.compile(r"(?:NA\s*|/\s?)([01]\.\d+)")

UNKNOWN = (
    "Micro-Manager files do not describe lenslets; pitch, gap and focal length are assumed; measure the "
    "array with lfcal camera check"
)


@dataclass
class _Preset:
    """Resolution preset: pixel size at the specimen (µm), and the labels that select it."""

    pixel_um: float | None = None
    label: str = ""


def _read(text: str, source: Path, options: ImportOptions) -> Imported:
    draft = Draft("Microscope", options.values)
    if text.lstrip()[:1] == "{":
        _summary(text, source, draft)
    else:
        _take(draft, *_chosen(_presets(text, source), options.resolution, source))
    draft.put("lattice.kind", "square", "assumed")
    draft.put("lattice.focus", (math.inf,), "assumed")
    try:
        return Imported(draft.camera(source.stem), (UNKNOWN,))
    except InputError as error:
        raise FileFormatError(f"{source}: {error}") from None


def _presets(text: str, source: Path) -> dict[str, _Preset]:
    found: dict[str, _Preset] = {}
    for line in text.splitlines():
        # lines are commands with commas; lines that begin with # are comments
        parts = [part.strip() for part in line.split(",")]
        if parts[0] == "ConfigPixelSize" and len(parts) >= 5:
            preset = found.setdefault(parts[1], _Preset())
            preset.label = f"{preset.label} {','.join(parts[4:])}".strip()
        elif parts[0] == "PixelSize_um" and len(parts) >= 3:
            size = _positive(parts[2], f"{source}: PixelSize_um of {parts[1]}")
            found.setdefault(parts[1], _Preset()).pixel_um = size
    return {name: preset for name, preset in found.items() if preset.pixel_um is not None}


def _positive(text: str, what: str) -> float | None:
    try:
        value = float(text.split("#")[0])
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise FileFormatError.expected(what, "a length in µm", repr(text)[:40], "replace it with a number")
    return value or None  # 0 means unknown


def _chosen(presets: dict[str, _Preset], name: str, source: Path) -> tuple[float, str]:
    names = ", ".join(presets) or "none"
    if not presets:
        raise FileFormatError.expected(
            str(source),
            "a pixel size (PixelSize_um)",
            "none",
            "calibrate the pixel size in Micro-Manager, or use lfcal camera new",
        )
    if name not in presets and (name or len(presets) > 1):
        got = repr(name) if name else f"{len(presets)} of them"
        raise InputError.expected(
            f"{source}: resolution preset", f"one of {names}", got, "choose one (--resolution NAME)"
        )
    preset = presets[name or next(iter(presets))]
    assert preset.pixel_um is not None
    return preset.pixel_um, preset.label


def _take(draft: Draft, specimen_um: float, label: str) -> None:
    """Set NA, magnification and pixel pitch from the pixel size at the specimen and the label of the objective."""
    if aperture := APERTURE.search(label):
        draft.put("optics.numerical_aperture", float(aperture[1]), "derived")
    match = OBJECTIVE.search(label)
    if draft.mark("sensor.pixel_um") == "assumed" and match:
        # the label's magnification and the specimen's pixel size give the sensor pixel, including any relay
        draft.put("optics.magnification", float(match[1] or match[2]), "derived")
    if draft.mark("optics.magnification") != "assumed":
        draft.put("sensor.pixel_um", _tidy(specimen_um * draft.get("optics.magnification")), "derived")
    mark = "assumed" if draft.mark("sensor.pixel_um") == "assumed" else "derived"
    draft.put("optics.magnification", _tidy(draft.get("sensor.pixel_um") / specimen_um), mark)


def _tidy(value: float) -> float:
    return float(f"{value:.9g}")


def _summary(text: str, source: Path, draft: Draft) -> None:
    """Set the values in the summary of a recording: width, height, bit depth, pixel size."""
    data = parse_json(text, str(source), finite=False)
    summary = data.get("Summary") if isinstance(data, Mapping) else None
    if not isinstance(summary, Mapping):
        raise FileFormatError.expected(
            str(source), 'the entry "Summary"', "none", "choose a metadata file of Micro-Manager"
        )
    size = [_whole(summary, name, source) for name in ("Height", "Width")]
    if None not in size:
        draft.put("sensor.shape", tuple(size))
    draft.put("sensor.bit_depth", _whole(summary, "BitDepth", source))
    specimen = summary.get("PixelSize_um", summary.get("PixelSizeUm"))
    if isinstance(specimen, int | float) and specimen > 0:
        _take(draft, float(specimen), "")


def _whole(summary: Mapping[str, Any], name: str, source: Path) -> int | None:
    value = summary.get(name)
    if value is None:
        return None
    if type(value) is not int or not 0 < value <= 200_000:
        raise FileFormatError.expected(f"{source}: {name}", "a whole number", repr(value)[:40], "check the file")
    return value


def _recognises(head: str) -> bool:
    if head[:1] == "{":
        return '"Summary"' in head
    return re.search(r"^(Device,|Property,Core,|ConfigPixelSize,|PixelSize_um,)", head, re.MULTILINE) is not None


FORMAT = CameraFormat("Micro-Manager configuration", (".cfg", ".txt"), _recognises, _read)
