"""A frame as ``lfcal views`` cuts it: its colours, the lattice and the weights, and what is printed of its views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError
from lfcal.camera import Camera
from lfcal.cli._colour_planes import ColourReading, Planes, mean_plane, read_planes

if TYPE_CHECKING:
    from lfcal.lattice import FrameLattice, TypeOf, Views

__all__ = ["GivenLattice", "ViewedFrame", "viewed_frame"]


@dataclass(frozen=True)
class GivenLattice:
    """What is given of the lattice: a white image, kind and pitch (px) that lead its fit; or the file of a lattice."""

    white: Path | None
    file: Path | None
    kind: str
    pitch_px: float


@dataclass(frozen=True)
class ViewedFrame:
    """The colours of a frame and of its white image, the lattice and its source, lens types, dark lenslets, radius."""

    planes: Planes
    lattice: FrameLattice
    source: str
    type_of: TypeOf | None
    missing: Sequence[tuple[int, int]] = ()
    white: Planes | None = None
    radius_px: float | None = None

    def rows(self, found: dict[str, list[Views]]) -> list[list[str]]:
        """Return the rows of the table of the views, ``found`` by lens type and colour."""
        views, lattice = next(iter(found.values()))[0], self.lattice
        count, masked = len(views.offsets), int((~views.mask).sum())
        turned = f"turned by {math.degrees(lattice.rotation_rad):+.3f}°"
        table = [
            ["lattice", f"{lattice.kind}, {lattice.pitch_px:.3f} px, {turned}, {self.source}"],
            ["views", f"{count} x {count}, a pixel of the micro-images apart"],
            *([f"samples of a view{k.replace('_type', ', type ')}", of[0].grid.described()] for k, of in found.items()),
            ["distance of samples", f"{views.step_px[0]:.3f} px down, {views.step_px[1]:.3f} px right"],
            ["rows run along", "the frame" if views.rotation_rad == 0 else f"the lattice ({turned})"],
        ]
        if masked:
            table.append(["seen by no lenslet", f"{masked} of {views.mask.size} samples (NaN in views.tif)"])
        return table if "" in self.planes else [*table, ["colours", ", ".join(self.planes)]]

    def to_dict(self, found: dict[str, list[Views]]) -> dict[str, Any]:
        """Return the same as plain values."""
        views = next(iter(found.values()))[0]
        names = ("kind", "pitch_px", "row_pitch_px", "rotation_rad")
        return {
            "lattice": {name: getattr(self.lattice, name) for name in names} | {"source": self.source},
            "views": len(views.offsets),
            "fields": {label.lstrip("_") or "all": _field(of[0]) for label, of in found.items()},
            **{name: getattr(views, name) for name in ("step_px", "rotation_rad", "radius_px")},
            "colours": [name for name in self.planes if name],
        }


def _field(views: Views) -> dict[str, Any]:
    """Return where the samples of a set of views lie, and what of the field they are."""
    grid, masked = views.grid, int((~views.mask).sum())
    own = {"shape": views.shape, "whole": grid.field_shape, "kept": grid.kept}
    return own | {"masked": masked, "corner_px": grid.corner_px}


def viewed_frame(path: Path, given: GivenLattice, camera: Camera | None, reading: ColourReading) -> ViewedFrame:
    """Return a frame and what its views are cut on: the best is a white image.

    Without one the lattice is the measured one, or the one that the camera states. Micro-images then count evenly up to
    the lenslets' clear aperture, or to half a pitch.
    """
    from lfcal.lattice import cropped, lattice_of, load_lattice

    planes = read_planes(path, reading)
    if given.white is not None:
        return _by_white(planes, given.white, given, camera, reading)
    shape = next(iter(planes.values())).shape
    missing: Sequence[tuple[int, int]] = ()
    type_of, clear = None, math.inf
    if camera is not None:
        clear = camera.lattice.clear_diameter_um / camera.sensor.pixel_um
    if given.file is not None:
        fit = load_lattice(given.file)
        lattice, missing = cropped(fit, shape, reading.origin), fit.dead_lenslets
        source = f"of {given.file.name}; no white image: aperture"
    elif camera is not None:
        lattice = lattice_of(camera, shape, reading.origin)
        type_of = camera.lattice.type_of if len(camera.lattice.types) == 3 else None
        source = f"of camera {camera.name}; no white image: clear aperture"
    else:
        raise InputError("lattice: expected --white, --lattice or --camera, got none; give one")
    radius = min(clear, lattice.pitch_px, lattice.row_pitch_px) / 2
    return ViewedFrame(planes, lattice, f"{source} of {2 * radius:.2f} px", type_of, missing, radius_px=radius)


def _by_white(
    planes: Planes, white: Path, given: GivenLattice, camera: Camera | None, reading: ColourReading
) -> ViewedFrame:
    """Return what a white image says; its lattice is fitted, unless it was measured before."""
    from lfcal.lattice import classify_lens_types, cropped, expected_blur, fit_lattice, load_lattice

    light = read_planes(white, reading)
    if light.keys() != planes.keys():
        wanted, got = (", ".join(one) or "none (grey)" for one in (planes, light))
        raise InputError.expected(str(white), f"colours {wanted}", got, "use one camera for both")
    bright, source = mean_plane(light), f"of {white.name}"
    if given.file is not None:
        fit, source = load_lattice(given.file), f"of {given.file.name}, light of {white.name}"
        if fit.shape != bright.shape:
            raise InputError.expected(str(white), f"the {fit.shape} px of the lattice", bright.shape, "use its own")
    else:
        kind = given.kind or (camera.lattice.kind if camera else None)
        fit = fit_lattice(bright, kind=kind, pitch_px=given.pitch_px or None)
    type_of = None
    if camera is not None and len(camera.lattice.types) == 3:
        type_of = classify_lens_types(bright, fit, expected_blur(camera)).type_of
    rows, columns = next(iter(planes.values())).shape
    top, left = reading.origin or (0, 0)
    lit = {name: plane[top : top + rows, left : left + columns] for name, plane in light.items()}
    return ViewedFrame(planes, cropped(fit, (rows, columns), reading.origin), source, type_of, fit.dead_lenslets, lit)
