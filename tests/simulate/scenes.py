"""Scenes small enough for tests: a three-type hexagonal camera and a square microscope."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import LensletLattice, LensType, Microscope
from lfcal.simulate.scene import PupilIris, Scene

PIXEL = 5.5


def camera_scene(v: float = 3.0, **changes: Any) -> Scene:
    """Return a telecentric plane at virtual depth v of lenslets of 15 px at f/5, in focus at v = 2, 3 and 5."""
    pitch = 15 * PIXEL
    gap = 5 * pitch
    types = tuple(LensType.focused_at(depth, gap) for depth in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", pitch, gap, types, clear_um=14.5 * PIXEL)
    values: dict[str, Any] = {
        "wavelength_um": 0.55,
        "pixel_um": PIXEL,
        "image_um": v * gap,
        "lattice": lattice,
        "cutout": (61, 61),
        "period": (26, 45),
        "f_number": 5.0,
        "iris": PupilIris(9, 0.0, 0.1),
    }
    return Scene(**(values | changes))


def microscope_scene(z_um: float = 5.0, **changes: Any) -> Scene:
    """Return a plane of a 20x/0.5 microscope with square lenslets of 9 px."""
    pixel, optics = 8.0, Microscope(20.0, 0.5, 1.0)
    lattice = LensletLattice("square", 9 * pixel, 1440.0, (LensType(1440.0),))
    values: dict[str, Any] = {
        "wavelength_um": 0.525,
        "pixel_um": pixel,
        "image_um": -400 * z_um,
        "lattice": lattice,
        "cutout": (45, 45),
        "period": (9, 9),
        "f_number": 20.0,
        "aperture": "cell",
        "objective": optics,
        "z_um": z_um,
    }
    return Scene(**(values | changes))


def relative_error(found: NDArray[Any], wanted: NDArray[Any]) -> float:
    """Return sum |found - wanted| / sum |wanted|."""
    a, b = np.asarray(found, np.float64), np.asarray(wanted, np.float64)
    return float(np.abs(a - b).sum() / np.abs(b).sum())


def moments(image: NDArray[Any]) -> tuple[float, float]:
    """Return the light's centre (y, x) from the middle of a cutout (pixels)."""
    light = np.asarray(image, np.float64)
    y, x = (np.arange(n) - n // 2 for n in light.shape)
    return float((light.sum(1) * y).sum() / light.sum()), float((light.sum(0) * x).sum() / light.sum())
