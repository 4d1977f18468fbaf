"""Reader for metadata of napari-LF: the settings of its calibration as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError, InputError, parse_json
from lfcal.camera.draft import Draft
from lfcal.camera.importers.camera_format import CameraFormat, Imported, ImportOptions, number, required

__all__ = ["FORMAT"]

ENTRIES = (
    ("objective_magnification", "optics.magnification", 1.0),
    ("objective_na", "optics.numerical_aperture", 1.0),
    ("medium_index", "optics.medium_index", 1.0),
    ("tubelens_focal_length", "optics.tube_length_um", 1e3),  # mm
    ("ulens_pitch", "lattice.pitch_um", 1.0),
    ("ulens_focal_distance", "lattice.gap_um", 1.0),
    ("pixel_size", "sensor.pixel_um", 1.0),
    ("pixel_fill_factor", "sensor.fill_factor", 1.0),
    ("center_wavelength", "wavelength_um", 1e-3),  # nm
)
"""Entry in the file, path in lfcal, and factor to lfcal's unit; lengths are in µm unless stated otherwise."""

NEEDED = ("objective_magnification", "objective_na", "ulens_pitch", "pixel_size")


def _read(text: str, source: Path, options: ImportOptions) -> Imported:
    data = parse_json(text, str(source))
    entries = data.get("calibrate") if isinstance(data, Mapping) else None
    if not isinstance(entries, Mapping):
        raise FileFormatError.expected(
            str(source), 'the entry "calibrate"', "none", "choose a metadata file of napari-LF"
        )
    what = f"{source}: calibrate"
    for name in NEEDED:
        required(entries, name, what)
    draft = Draft("Microscope", options.values)
    for name, path, scale in ENTRIES:
        draft.put(path, number(entries, name, what, scale))
    focal = number(entries, "ulens_focal_length", what)
    draft.put("lattice.types", None if focal is None else (focal,))
    # napari-LF supports only square arrays, and the file does not say so
    draft.put("lattice.kind", "square", "derived")
    try:
        return Imported(draft.camera(source.stem), _notes(entries, what))
    except InputError as error:
        raise FileFormatError(f"{source}: {error}") from None


def _notes(entries: Mapping[str, Any], what: str) -> tuple[str, ...]:
    fill = number(entries, "ulens_fill_factor", what)
    if fill is None or fill == 1:
        return ()
    return (
        f"the file states that lenslets fill a fraction of {fill:g}, but not whether of their area or of their "
        "width; their diameter is assumed to be the pitch; state it if it differs (--set lattice.clear_um=…)",
    )


FORMAT = CameraFormat(
    "napari-LF metadata",
    (".json", ".txt"),
    lambda head: head[:1] == "{" and '"calibrate"' in head and '"ulens_pitch"' in head,
    _read,
)
