"""Reader for configurations of oLaF and pyolaf: a flat yaml file (Stefanoiu et al. 2019, LFM_setCameraParams).

Files for Fourier light-field microscopes (FLFM_setCameraParams) state the focal length ``fobj`` of the objective and
the relay lenses ``f1`` and ``f2``. They also state the number of elemental images, and their distance in pixels.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from lfcal.base import FileFormatError, InputError, format_count
from lfcal.camera.draft import Draft
from lfcal.camera.importers.camera_format import CameraFormat, Imported, ImportOptions, number, required

__all__ = ["FORMAT"]

MOST_ACROSS = 100
"""Largest number of elemental images along a side."""

MAX_CHARACTERS = 1 << 16
"""Largest size of a file (characters); real files have 1 kB."""

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
    if "noLensHoriz" in entries or "f1" in entries:
        return _read_fourier(entries, source, options)
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


class _AliasError(Exception):
    """Error raised for an alias (``*name``) in a file."""


class _Plain(yaml.SafeLoader):  # type: ignore[misc]  # yaml has no types
    """YAML loader without aliases, because a few aliases can expand to gigabytes of text."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Raise an error for aliases."""
        if self.check_event(yaml.AliasEvent):
            raise _AliasError
        return super().compose_node(parent, index)


def _entries(text: str, source: Path) -> Mapping[str, Any]:
    if len(text) > MAX_CHARACTERS:
        raise FileFormatError.expected(
            str(source), "a configuration of at most 64 kB", "a larger file", "check the path"
        )
    try:
        data = yaml.load(text, _Plain)
    except _AliasError:
        raise FileFormatError.expected(
            str(source), "YAML without aliases", "an alias (*name)", "replace each alias by its value"
        ) from None
    except Exception as error:  # yaml's constructors of dates and numbers can raise any error
        parse_error = isinstance(error, yaml.YAMLError | ValueError)
        reason = " ".join(str(error).split())[:200] if parse_error else "an invalid YAML value"
        raise FileFormatError.expected(str(source), "YAML", reason, "correct the file") from None
    if not isinstance(data, Mapping):
        raise FileFormatError.expected(str(source), "named entries", type(data).__name__, "correct the file")
    return data


FOURIER_ENTRIES = (
    ("NA", "optics.numerical_aperture"),
    ("n", "optics.medium_index"),
    ("f1", "optics.tube_length_um"),
    ("f2", "lattice.fourier_um"),
    ("lensPitch", "lattice.clear_um"),
    ("mla2sensor", "lattice.gap_um"),
    ("pixelPitch", "sensor.pixel_um"),
    ("WaveLength", "wavelength_um"),
)
"""Entries of a Fourier light-field microscope, and paths in lfcal; all lengths are in µm."""


def _read_fourier(entries: Mapping[str, Any], source: Path, options: ImportOptions) -> Imported:
    what = str(source)
    for name in ("fobj", "NA", "f1", "f2", "fm", "lensPitch", "pixelPitch", "noLensHoriz", "noLensVert"):
        required(entries, name, what)
    draft = Draft("FourierMicroscope", options.values)
    for name, path in FOURIER_ENTRIES:
        draft.put(path, number(entries, name, what))
    tube, objective = number(entries, "f1", what), number(entries, "fobj", what)
    if not tube or not objective:
        raise FileFormatError.expected(f"{what}: f1, fobj", "focal lengths above zero", "zero", "correct these entries")
    draft.put("optics.magnification", tube / objective, "derived")
    draft.put("lattice.focal_lengths_um", _focal_lengths(entries, what))
    try:
        centres, dark = _lit_centres(entries, draft, what)
        draft.put("lattice.lens_centres_um", centres)
        camera = draft.camera(source.stem)
    except InputError as error:
        raise FileFormatError(f"{source}: {error}") from None
    notes = (f"{dark} of {dark + len(centres)} lenslets are outside the pupil and were left out",) if dark else ()
    return Imported(camera, notes)


def _lit_centres(entries: Mapping[str, Any], draft: Draft, what: str) -> tuple[tuple[tuple[float, float], ...], int]:
    """Return the centres of the lenslets that the pupil illuminates, and the number of the other lenslets."""
    counts = [number(entries, name, what) for name in ("noLensHoriz", "noLensVert")]
    if not all(n is not None and n == int(n) and 1 <= n <= MOST_ACROSS for n in counts):
        wanted = f"whole numbers from 1 to {MOST_ACROSS}"
        raise FileFormatError.expected(
            f"{what}: noLensHoriz, noLensVert", wanted, " and ".join(map(str, counts)), "correct these entries"
        )
    across, down = (int(n or 0) for n in counts)
    spacing = number(entries, "spacingPixels", what)
    pitch = draft.get("lattice.clear_um") if spacing is None else spacing * draft.get("sensor.pixel_um")
    hexagonal = _kind(entries, what) == "hexagonal"
    # 1: odd rows are shifted, 2: even ones, counted from 1
    shifted = 0 if entries.get("shiftRow", 1) == 1 else 1
    row = pitch * (math.sqrt(3) / 2 if hexagonal else 1.0)
    places = [
        (q * pitch + (pitch / 2 if hexagonal and r % 2 == shifted else 0.0), r * row)
        for r in range(down)
        for q in range(across)
    ]
    # about the middle lenslet, or the middle of two: the axis passes there
    x, y = places[(down // 2) * across + across // 2]
    if not across % 2:
        x -= pitch / 2
    if not down % 2:
        y -= row / 2
    optics = draft.get
    pupil = optics("optics.numerical_aperture") * optics("lattice.fourier_um") / optics("optics.magnification")
    centred = [(round(a - x, 6), round(b - y, 6)) for a, b in places]
    lit = tuple(one for one in centred if math.hypot(*one) - optics("lattice.clear_um") / 2 < pupil)
    return lit, len(centred) - len(lit)


def _kind(entries: Mapping[str, Any], what: str) -> str | None:
    grid = entries.get("gridType")
    if grid not in (None, "reg", "hex"):
        raise FileFormatError.expected(f"{what}: gridType", "reg or hex", repr(grid)[:40], "write one of these")
    return {"reg": "square", "hex": "hexagonal", None: None}[grid]


def _focal_lengths(entries: Mapping[str, Any], what: str) -> tuple[float, ...]:
    """Return the focal lengths of the lens types: one, or three if ``focus`` is ``multi``."""
    given = entries["fm"]
    parts = given if isinstance(given, list) else [given]
    found = tuple(number({"fm": part}, "fm", what) for part in parts)
    lengths = tuple(f for f in found if f is not None)
    several = entries.get("focus") == "multi"
    if len(lengths) != len(parts) or len(lengths) != (3 if several else 1):
        wanted = "three focal lengths" if several else "one focal length (focus: single)"
        raise FileFormatError.expected(
            f"{what}: fm", wanted, format_count(len(lengths), "focal length", "focal lengths"), "correct this entry"
        )
    return lengths


def _place(entries: Mapping[str, Any], focal: tuple[float, ...], draft: Draft, what: str) -> tuple[str, ...]:
    """Set the gap as oLaF does if the file does not state it; return a note about the position of the array."""
    tube, array = number(entries, "ftl", what), number(entries, "tube2mla", what) or 0.0
    design = entries.get("plenoptic", 1)
    if design not in (1, 2):
        raise FileFormatError.expected(f"{what}: plenoptic", "1 or 2", repr(design)[:40], "write one of these")
    if design == 1:
        draft.put("lattice.gap_um", focal[0], "derived")
        return ()
    if array and tube and array != tube:
        # f-numbers match: gap over pitch is the distance of the array over the tube lens's lit diameter
        objective = tube / draft.get("optics.magnification")
        lit = _lit_radius(tube, array, objective, draft.get("optics.numerical_aperture"))
        draft.put("lattice.gap_um", array * draft.get("lattice.pitch_um") / (2 * lit), "derived")
    return (
        "defocused design (plenoptic: 2): in lfcal, depth 0 is the plane that is imaged onto the lenslets, "
        "not the focal plane of the objective",
    )


def _lit_radius(tube: float, array: float, objective: float, na: float) -> float:
    """Return the radius of the tube lens illuminated by a point imaged onto the array (µm), as in oLaF."""
    apart = objective + tube
    image = apart - tube * array / (array - tube)
    return abs((image - apart) * objective * na / image)


FORMAT = CameraFormat(
    "oLaF YAML",
    (".yaml", ".yml"),
    lambda head: re.search(r"^\s*(lensPitch|gridType)\s*:", head, re.MULTILINE) is not None and head[:1] != "{",
    _read,
)
