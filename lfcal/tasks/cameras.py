"""Load the camera of a preset or a file, and report its assumed and implausible values."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import StorageError, choose, note, warn

if TYPE_CHECKING:
    from lfcal.camera import Camera, ImportOptions, Quantity

__all__ = [
    "OF_NOISE",
    "OF_RAW_NOISE",
    "OF_WEIGHTS",
    "assumed_in_words",
    "is_camera_file",
    "load_camera",
    "load_file",
    "note_assumed",
    "note_camera",
    "preset_names",
]


OF_NOISE = tuple(
    f"sensor.{name}" for name in ("bit_depth", "full_well_e", "read_noise_e", "dark_current_e_s", "black_level")
)
"""Paths of the values on which the noise of white-corrected frames depends."""

OF_RAW_NOISE = (*OF_NOISE, "sensor.prnu", "sensor.dsnu_e")
"""Paths of the values on which the noise of uncorrected frames depends."""

OF_WEIGHTS = (*OF_NOISE, "sensor.saturation")
"""Paths of the values on which the weights of pixels depend."""


def preset_names() -> tuple[str, ...]:
    """Return the names of the built-in cameras."""
    from lfcal.camera import PRESETS

    return tuple(PRESETS)


def is_camera_file(name: str) -> bool:
    """Return whether ``name`` is not the name of a preset, and therefore refers to a camera file."""
    from lfcal.camera import PRESETS

    return name not in PRESETS


def load_camera(
    name: str,
    *,
    light: bool = True,
    only: Collection[str] | None = None,
    without_lattice: Collection[str] | None = None,
) -> Camera:
    """Return the camera of a preset or of a file in any known format, and report assumed and implausible values.

    For a preset, nothing is reported. Set ``light=False`` if the result does not depend on light and noise; their
    assumed values are then not reported. ``only`` contains the paths of the values on which the result depends; other
    assumed values are not reported. None: the result depends on all values. For a camera without a lattice,
    ``without_lattice`` replaces ``only`` unless it is None.
    """
    from lfcal.camera import PRESETS, preset

    if name in PRESETS:
        return preset(name)
    camera, notes = load_file(name)
    only = without_lattice if without_lattice is not None and not camera.has_lattice else only
    note_camera(camera, Path(name), notes, light=light, only=only)
    return camera


def load_file(name: str, options: ImportOptions | None = None) -> tuple[Camera, tuple[str, ...]]:
    """Return the camera of the file ``name``, and the notes of the reader of its format, as `import_camera` does."""
    from lfcal.camera import CAMERA_FORMATS, PRESETS, import_camera

    path = Path(name)
    if not path.exists():
        known = ", ".join(PRESETS)
        formats = ", ".join(form.name for form in CAMERA_FORMATS)
        meant = choose(name, PRESETS).replace("choose one of these", "check the name")
        raise StorageError.expected("camera", f"a preset ({known}) or a file ({formats})", name, meant)
    found = import_camera(path, options)
    return found.camera, found.notes


def note_camera(
    camera: Camera,
    path: Path,
    notes: tuple[str, ...] = (),
    *,
    light: bool = True,
    only: Collection[str] | None = None,
) -> None:
    """Report the assumed values of ``camera``, ``notes``, and the implausible values.

    Messages begin with the name of the file ``path``. ``light`` and ``only`` select assumed values as in
    `assumed_in_words`.
    """
    from lfcal.camera import doubts

    if words := assumed_in_words(camera, light=light, only=only):
        note(f"{path.name}: assumed: {words}; {_remedy(camera, path, only)}")
    for one in notes:
        note(f"{path.name}: {one}")
    for doubt in doubts(camera):
        warn(f"{path.name}: {doubt}")


def note_assumed(camera: Camera | None, where: str, *, quiet: bool = False, light: bool = True) -> None:
    """Report the assumed values of the camera in a plan or an H, unless it is None or ``quiet`` is set.

    ``where`` names the plan or H in the message; ``light`` is as in `assumed_in_words`.
    """
    if camera is not None and not quiet and (words := assumed_in_words(camera, light=light)):
        note(f"{where}: assumed values of the camera: {words}")


def _assumed(camera: Camera, only: Collection[str] | None = None) -> list[Quantity]:
    from lfcal.camera import quantities_of

    there = {path for path in camera.marks.paths("assumed") if only is None or path in only}
    return [quantity for quantity in quantities_of(camera) if quantity.path in there]


def _remedy(camera: Camera, path: Path, only: Collection[str] | None = None) -> str:
    """Return the commands that state or measure the assumed values."""
    found = _assumed(camera, only)
    if all(q.path in OF_RAW_NOISE for q in found):
        return f"measure it with lfcal camera sensor FLATS DARKS --camera {path.name} -o camera.json"
    options = dict.fromkeys(q.option for q in found if q.option and not q.light)
    measured = {"lattice.rotation_rad", "lattice.offset_um"} if camera.has_lattice else {"lattice.lens_centres_um"}
    seen = measured & {q.path for q in found}
    remedies = []
    if options or not seen:
        stating = " ".join(options) or "--set PATH=VALUE"
        remedies.append(f"state it with lfcal camera import {path.name} {stating} -o camera.json")
    if seen:
        checked = f"camera check {path.name} WHITE -o camera.json"
        measuring = checked if camera.has_lattice else f"white WHITE --camera {path.name} -o FOLDER"
        remedies.append(f"measure the array with lfcal {measuring}")
    return ", ".join(remedies)


def assumed_in_words(camera: Camera, *, light: bool = True, only: Collection[str] | None = None) -> str:
    """Return the assumed values of ``camera`` as one line; empty if there are none.

    Assumed values of light and noise are only counted, or ignored with ``light=False``. ``only`` contains the paths of
    the values to consider. None: all.
    """
    from lfcal.camera import value_at

    found = _assumed(camera, only)
    parts = [f"{q.label} {q.text(value_at(camera, q.path))}" for q in found if not q.light]
    count = sum(quantity.light for quantity in found) if light else 0
    if count:
        parts.append(f"{count} value{'s' * (count > 1)} of light and noise (lfcal camera show)")
    return "; ".join(parts)
