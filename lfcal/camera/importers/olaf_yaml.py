"""Reader for configurations of oLaF and pyolaf: a flat yaml file (Stefanoiu et al. 2019, LFM_setCameraParams)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from lfcal.base import FileFormatError, InputError
from lfcal.camera.draft import Draft
from lfcal.camera.importers.camera_format import CameraFormat, Imported, ImportOptions, number, required

__all__ = ["FORMAT"]

MAX_CHARACTERS = 1 << 16
"""Largest size of a file (bytes); real files have 1 kB."""

ENTRIES = (
    ("M", "optics.magnification"),
    ("NA", "optics.numerical_aperture"),
    ("n", "optics.medium_index"),
    ("ftl", "optics.tube_length_um"),
    ("lensPitch", "lattice.pitch_um"),
    ("pixelPitch", "sensor.pixel_um"),
    ("WaveLength", "wavelength_um"),
)
"""Entries in the file, and paths in lfcal; all lengths are in µm."""


def _read(text: str, source: Path, options: ImportOptions) -> Imported:
    entries = _entries(text, source)
    what = str(source)
    for name in ("M", "NA", "ftl", "fm", "lensPitch", "pixelPitch"):
        required(entries, name, what)
    draft = Draft("Microscope", options.values)
    draft.put("lattice.kind", _kind(entries, what))
    for name, path in ENTRIES:
        draft.put(path, number(entries, name, what))
    focal = _focal_lengths(entries, what)
    draft.put("lattice.types", focal)
    draft.put("lattice.gap_um", number(entries, "mla2sensor", what) or None)
    notes = _place(entries, focal, draft, what)
    try:
        return Imported(draft.camera(source.stem), notes)
    except InputError as error:
        raise FileFormatError(f"{source}: {error}") from None


class _Plain(yaml.SafeLoader):  # type: ignore[misc]  # yaml has no types
    """Loads plain entries without references, since a few references can expand to gigabytes of text."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Refuse references."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("a reference (*name), which is not allowed in a camera file")
        return super().compose_node(parent, index)


def _entries(text: str, source: Path) -> Mapping[str, Any]:
    if len(text) > MAX_CHARACTERS:
        raise FileFormatError.expected(str(source), "a configuration of at most 64 kB", "more", "check the path")
    try:
        data = yaml.load(text, _Plain)
    except Exception as error:  # yaml's constructors of dates and numbers can raise any error
        parse_error = isinstance(error, yaml.YAMLError | ValueError)
        reason = " ".join(str(error).split())[:200] if parse_error else "an invalid yaml value"
        raise FileFormatError.expected(str(source), "yaml", reason, "correct the file") from None
    if not isinstance(data, Mapping):
        raise FileFormatError.expected(str(source), "named entries", type(data).__name__, "correct the file")
    # the Fourier microscope has its lenslets in a pupil plane: a different instrument with different entries
    if "noLensHoriz" in data or "f1" in data:
        raise FileFormatError.expected(
            str(source),
            "a light-field microscope",
            "a Fourier light-field microscope",
            "lfcal does not support such cameras",
        )
    return data


def _kind(entries: Mapping[str, Any], what: str) -> str | None:
    grid = entries.get("gridType")
    if grid not in (None, "reg", "hex"):
        raise FileFormatError.expected(f"{what}: gridType", "reg or hex", repr(grid)[:40], "correct it")
    return {"reg": "square", "hex": "hexagonal", None: None}[grid]


def _focal_lengths(entries: Mapping[str, Any], what: str) -> tuple[float, ...]:
    """Return the focal lengths of the lens types: one, or three if ``focus`` is multi."""
    given = entries["fm"]
    parts = given if isinstance(given, list) else [given]
    found = tuple(number({"fm": part}, "fm", what) for part in parts)
    lengths = tuple(f for f in found if f is not None)
    several = entries.get("focus") == "multi"
    if len(lengths) != len(parts) or len(lengths) != (3 if several else 1):
        wanted = "three focal lengths" if several else "one focal length (focus: single)"
        raise FileFormatError.expected(f"{what}: fm", wanted, f"{len(lengths)}", "correct it")
    return lengths


def _place(entries: Mapping[str, Any], focal: tuple[float, ...], draft: Draft, what: str) -> tuple[str, ...]:
    """Set the gap as oLaF would if the file does not state it; return a remark about the position of the array."""
    tube, array = number(entries, "ftl", what), number(entries, "tube2mla", what) or 0.0
    design = entries.get("plenoptic", 1)
    if design not in (1, 2):
        raise FileFormatError.expected(f"{what}: plenoptic", "1 or 2", repr(design)[:40], "correct it")
    if design == 1:
        draft.put("lattice.gap_um", focal[0], "derived")
        return ()
    if array and tube and array != tube:
        # f-numbers match: gap over pitch is the distance of the array over the tube lens's lit diameter
        objective = tube / draft.get("optics.magnification")
        lit = _lit_radius(tube, array, objective, draft.get("optics.numerical_aperture"))
        draft.put("lattice.gap_um", array * draft.get("lattice.pitch_um") / (2 * lit), "derived")
    return (
        "a defocused design (plenoptic: 2): depth 0 in lfcal is the plane imaged onto the lenslets, not the "
        "objective's focal plane",
    )


def _lit_radius(tube: float, array: float, objective: float, na: float) -> float:
    """Return the radius of the tube lens illuminated by a point imaged onto the array (µm), as in oLaF."""
    apart = objective + tube
    image = apart - tube * array / (array - tube)
    return abs((image - apart) * objective * na / image)


FORMAT = CameraFormat(
    "oLaF yaml",
    (".yaml", ".yml"),
    lambda head: re.search(r"^\s*(lensPitch|gridType)\s*:", head, re.MULTILINE) is not None and head[:1] != "{",
    _read,
)
