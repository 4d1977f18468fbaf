"""What ``lfcal views`` reads: frames plane by plane of their colours, and the lattice that they are cut on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.camera import Camera
from lfcal.errors import FileFormatError, InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.lattice.micro_images import FrameLattice, TypeOf

__all__ = ["CHANNELS", "Cutting", "Reading", "Scene", "cutting_of", "read_planes"]

CHANNELS = ("", "R", "G", "B", "each")
"""Colours that are taken; empty: all of a mosaic, the only one of a grey frame."""

COLOURS = ("R", "G", "B")

Planes = dict[str, "NDArray[np.float32]"]


@dataclass(frozen=True)
class Reading:
    """How frames are read: colour, pattern of their colour filters, dark frame, first pixel on the sensor."""

    channel: str
    cfa: str
    dark: Path | None
    origin: tuple[int, int] | None


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


def read_planes(path: Path, reading: Reading) -> Planes:
    """Return the colours of a frame less its dark frame, ``(rows, columns)`` each; "" is the plane of a grey frame."""
    from lfcal.frames import open_image

    wanted = COLOURS if reading.channel == "each" else (reading.channel,) if reading.channel else ()
    try:
        image = open_image(path)
    except FileFormatError as error:
        if 'colour="G"' not in str(error):
            raise
        if not wanted:
            # the library's word for the option is not the command's
            raise FileFormatError(str(error).replace('colour="G"', "--channel G, or all with --channel each")) from None
        return {name: _plane(path, reading.dark, name) for name in wanted}
    cfa = reading.cfa or str(image.metadata.get("cfa", ""))
    level = image.metadata.get("black_level", 0)
    image.close()
    if cfa:
        return _mosaic(path, cfa, level, reading.dark, wanted or COLOURS)
    if wanted:
        raise InputError.expected(
            f"colour of {path}",
            "a colour frame or mosaic",
            "a grey frame",
            "leave --channel out, or add --cfa, e.g. GRBG",
        )
    return {"": _plane(path, reading.dark, None)}


def _plane(path: Path, dark: Path | None, colour: str | None) -> NDArray[np.float32]:
    import numpy as np

    from lfcal.frames import read_image

    image = read_image(path, colour=colour).astype(np.float32)
    return image if dark is None else image - _level(dark, image.shape, colour)


def _level(dark: Path, shape: tuple[int, ...], colour: str | None) -> NDArray[Any]:
    from lfcal.frames import read_image

    level = read_image(dark, colour=colour)
    if level.shape != shape:
        raise InputError.expected(str(dark), f"{shape} px", f"{level.shape} px", "use one sensor setting")
    return level


def _mosaic(path: Path, cfa: str, black: Any, dark: Path | None, names: tuple[str, ...]) -> Planes:
    import numpy as np

    from lfcal.cli.multiplex_figures import without_dark
    from lfcal.frames import read_image
    from lfcal.multiplex import cfa as modulator_of
    from lfcal.multiplex import demultiplex

    frame = read_image(path)
    light = without_dark(frame, black) if dark is None else frame - _level(dark, frame.shape, None).astype(np.float32)
    colours = demultiplex(light, modulator_of(cfa))
    return {name: np.ascontiguousarray(colours[COLOURS.index(name)], np.float32) for name in names}


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
    bright = sum(planes.values()) / len(planes)
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
