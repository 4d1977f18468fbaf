"""On what ``lfcal views`` cuts a frame: the lattice of a white image or measured before, or the one a camera states."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import InputError
from lfcal.camera import Camera
from lfcal.cli._colour_planes import ColourReading, Planes, mean_plane, read_planes
from lfcal.tasks import load_lattice

if TYPE_CHECKING:
    from lfcal.lattice import FrameLattice, TypeOf

__all__ = ["Cutting", "Given", "ViewedFrame", "cutting_of"]


@dataclass(frozen=True)
class Cutting:
    """On what views are cut: lattice and its source, lens types, lenslets without light, white planes, radius."""

    lattice: FrameLattice
    type_of: TypeOf | None
    missing: list[tuple[int, int]]
    white: Planes | None
    radius_px: float | None
    source: str


@dataclass(frozen=True)
class Given:
    """What is given of the lattice: a white image, kind and pitch (px) that lead its fit; or the file of one."""

    white: Path | None
    lattice: Path | None = None
    kind: str = ""
    pitch_px: float = 0.0


@dataclass(frozen=True)
class ViewedFrame:
    """A frame by its colours, on what it is cut, and the camera where it is described."""

    planes: Planes
    cutting: Cutting
    camera: Camera | None


def cutting_of(frame: Planes, given: Given, camera: Camera | None, reading: ColourReading) -> Cutting:
    """Return what views of ``frame`` are cut on.

    A white image says it best; without one a measured lattice or the camera's description does, and micro-images count
    evenly up to the lenslets' clear aperture, or to half a pitch.
    """
    from lfcal.lattice import cropped, lattice_of

    shape = next(iter(frame.values())).shape
    if given.white is not None:
        return _by_white(frame, given.white, given, camera, reading)
    if given.lattice is not None:
        fit = load_lattice(given.lattice)
        lattice = cropped(fit, shape, reading.origin)
        radius = _radius(lattice, camera)
        source = f"of {given.lattice.name}; no white image: aperture of {2 * radius:.2f} px"
        return Cutting(lattice, None, fit.dead_lenslets, None, radius, source)
    if camera is None:
        raise InputError("lattice: expected --white, --lattice or --camera, got none; give one")
    lattice = lattice_of(camera, shape, reading.origin)
    radius = _radius(lattice, camera)
    source = f"of camera {camera.name}; no white image: clear aperture of {2 * radius:.2f} px"
    return Cutting(lattice, camera.lattice.type_of if _three(camera) else None, [], None, radius, source)


def _three(camera: Camera | None) -> bool:
    return camera is not None and len(camera.lattice.types) == 3


def _radius(lattice: FrameLattice, camera: Camera | None) -> float:
    clear = [] if camera is None else [camera.lattice.clear_diameter_um / camera.sensor.pixel_um]
    return min(*clear, lattice.pitch_px, lattice.row_pitch_px) / 2


def _by_white(frame: Planes, white: Path, given: Given, camera: Camera | None, reading: ColourReading) -> Cutting:
    """Return what a white image says; its lattice is fitted, unless it was measured before."""
    from lfcal.lattice import classify_lens_types, cropped, expected_blur, fit_lattice

    shape = next(iter(frame.values())).shape
    planes = read_planes(white, reading)
    if planes.keys() != frame.keys():
        raise InputError.expected(str(white), f"colours {_names(frame)}", _names(planes), "use one camera for both")
    bright, source = mean_plane(planes), f"of {white.name}"
    if given.lattice is not None:
        fit = load_lattice(given.lattice)
        if fit.shape != bright.shape:
            raise InputError.expected(str(white), f"the {fit.shape} px of the lattice", bright.shape, "use its own")
        source = f"of {given.lattice.name}, light of {white.name}"
    else:
        kind = given.kind or (camera.lattice.kind if camera else None)
        fit = fit_lattice(bright, kind=kind, pitch_px=given.pitch_px or None)
    type_of = None
    if camera is not None and _three(camera):
        type_of = classify_lens_types(bright, fit, expected_blur(camera)).type_of
    lattice = cropped(fit, shape, reading.origin)
    top, left = reading.origin or (0, 0)
    part = (slice(top, top + shape[0]), slice(left, left + shape[1]))
    lit = {name: plane[part] for name, plane in planes.items()}
    return Cutting(lattice, type_of, fit.dead_lenslets, lit, None, source)


def _names(planes: Planes) -> str:
    return ", ".join(planes) or "none (grey)"
