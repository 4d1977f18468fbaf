"""On what ``lfcal views`` cuts a frame: the lattice of a white image, or the one a camera states."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.camera import Camera
from lfcal.cli.colour_planes import Planes, Reading, mean_plane, read_planes
from lfcal.errors import InputError

if TYPE_CHECKING:
    from lfcal.lattice.micro_images import FrameLattice, TypeOf

__all__ = ["Cutting", "Scene", "cutting_of"]


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
class Scene:
    """A frame by its colours, on what it is cut, and the camera where it is described."""

    planes: Planes
    cutting: Cutting
    camera: Camera | None


def cutting_of(
    frame: Planes, white: Path | None, camera: Camera | None, reading: Reading, options: tuple[str, float]
) -> Cutting:
    """Return what views of ``frame`` are cut on; ``options`` are kind and pitch (px) of a white image's lattice.

    A white image says it best; without one the camera's description does, and micro-images count evenly up to the
    lenslets' clear aperture.
    """
    from lfcal.lattice import classify_lens_types, cropped, expected_blur, fit_lattice, lattice_of

    shape = next(iter(frame.values())).shape
    three = camera is not None and len(camera.lattice.types) == 3
    if white is None:
        if camera is None:
            raise InputError("lattice: expected --white or --camera, got neither; give one, or both")
        lattice = lattice_of(camera, shape, reading.origin)
        radius = (
            min(camera.lattice.clear_diameter_um / camera.sensor.pixel_um, lattice.pitch_px, lattice.row_pitch_px) / 2
        )
        source = f"of camera {camera.name}; no white image: clear aperture of {2 * radius:.2f} px"
        return Cutting(lattice, camera.lattice.type_of if three else None, [], None, radius, source)
    planes = read_planes(white, reading)
    if planes.keys() != frame.keys():
        raise InputError.expected(str(white), f"colours {_names(frame)}", _names(planes), "use one camera for both")
    bright = mean_plane(planes)
    kind, pitch = options
    fit = fit_lattice(bright, kind=kind or (camera.lattice.kind if camera else None), pitch_px=pitch or None)
    type_of = None
    if three and camera is not None:
        type_of = classify_lens_types(bright, fit, expected_blur(camera)).type_of
    lattice = cropped(fit, shape, reading.origin)
    top, left = reading.origin or (0, 0)
    part = (slice(top, top + shape[0]), slice(left, left + shape[1]))
    lit = {name: plane[part] for name, plane in planes.items()}
    return Cutting(lattice, type_of, fit.dead_lenslets, lit, None, f"of {white.name}")


def _names(planes: Planes) -> str:
    return ", ".join(planes) or "none (grey)"
