"""Open the cameras of commands, presets or files, and report their assumed values once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import StorageError, choose, note, warn

if TYPE_CHECKING:
    from lfcal.camera import Camera, ImportOptions, Quantity

__all__ = ["assumed_in_words", "is_camera_file", "load_camera", "load_file", "preset_names", "tell", "tell_assumed"]


def preset_names() -> tuple[str, ...]:
    """Return the names of cameras that need no file."""
    from lfcal.camera import PRESETS

    return tuple(PRESETS)


def is_camera_file(name: str) -> bool:
    """Return whether a camera given by ``name`` is a file."""
    from lfcal.camera import PRESETS

    return name not in PRESETS


def load_camera(name: str, *, light: bool = True) -> Camera:
    """Return the camera of a preset, or of a file in any known format; report assumed and implausible values.

    With ``light=False``, assumed values of light and noise are not reported: the result does not depend on them.
    """
    from lfcal.camera import PRESETS, preset

    if name in PRESETS:
        return preset(name)
    camera, notes = load_file(name)
    tell(camera, Path(name), notes, light=light)
    return camera


def load_file(name: str, options: ImportOptions | None = None) -> tuple[Camera, tuple[str, ...]]:
    """Return the camera of a file, and the remarks of its reader."""
    from lfcal.camera import CAMERA_FORMATS, PRESETS, import_camera

    path = Path(name)
    if not path.exists():
        known = ", ".join(PRESETS)
        formats = ", ".join(form.name for form in CAMERA_FORMATS)
        meant = choose(name, PRESETS).replace("choose one of these", "check the name")
        raise StorageError.expected("camera", f"a preset ({known}) or a file ({formats})", name, meant)
    found = import_camera(path, options)
    return found.camera, found.notes


def tell(camera: Camera, path: Path, notes: tuple[str, ...] = (), *, light: bool = True) -> None:
    """Report the assumed values of ``camera``, remarks of its reader, and implausible values."""
    from lfcal.camera import doubts

    if words := assumed_in_words(camera, light=light):
        note(f"{path.name}: assumed: {words}; {_remedy(camera, path)}")
    for one in notes:
        note(f"{path.name}: {one}")
    for doubt in doubts(camera):
        warn(f"{path.name}: {doubt}")


def tell_assumed(camera: Camera | None, where: str, *, quiet: bool = False, light: bool = True) -> None:
    """Report the assumed values of the camera in ``where``, the name of a plan or an H."""
    if camera is not None and not quiet and (words := assumed_in_words(camera, light=light)):
        note(f"{where}: assumed of the camera: {words}")


def _assumed(camera: Camera) -> list[Quantity]:
    from lfcal.camera import quantities_of

    there = set(camera.marks.paths("assumed"))
    return [quantity for quantity in quantities_of(camera) if quantity.path in there]


def _remedy(camera: Camera, path: Path) -> str:
    """Return the commands that state or measure the assumed values."""
    found = _assumed(camera)
    options = dict.fromkeys(q.option for q in found if q.option and not q.light)
    seen = {"lattice.rotation_rad", "lattice.offset_um"} & {q.path for q in found}
    remedies = []
    if options or not seen:
        stating = " ".join(options) or "--set PATH=VALUE"
        remedies.append(f"state it with lfcal camera import {path.name} {stating} -o camera.json")
    if seen:
        remedies.append(f"measure the array with lfcal camera check {path.name} WHITE -o camera.json")
    return ", ".join(remedies)


def assumed_in_words(camera: Camera, *, light: bool = True) -> str:
    """Return the assumed values of ``camera`` as one line, or an empty text; those of ``light`` are only counted."""
    from lfcal.camera import value_at

    found = _assumed(camera)
    parts = [f"{q.label} {q.text(value_at(camera, q.path))}" for q in found if not q.light]
    count = sum(quantity.light for quantity in found) if light else 0
    if count:
        parts.append(f"{count} value{'s' * (count > 1)} of light and noise (lfcal camera show)")
    return "; ".join(parts)
