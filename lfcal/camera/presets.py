"""Built-in cameras."""

from __future__ import annotations

import math
from collections.abc import Callable

from lfcal.base import InputError, any_of, choose
from lfcal.camera.description import Camera
from lfcal.camera.lattice import LensletLattice, LensType
from lfcal.camera.main_lens import MainLens, Microscope
from lfcal.camera.pupil_lenslets import PupilLenslets
from lfcal.camera.sensor import Sensor

__all__ = ["PRESETS", "preset"]


def _hexagonal(pitch_um: float, f_number: float, clear_um: float, depths: tuple[float, ...]) -> LensletLattice:
    # gap from the lenslets' f-number: if it equals the main lens's working f-number, micro-images just touch
    gap = pitch_um * f_number
    types = tuple(LensType.focused_at(v, gap) for v in depths)
    return LensletLattice("hexagonal", pitch_um, gap, types, clear_um=clear_um)


def r29() -> Camera:
    """Return the Raytrix R29 camera of Eberhart et al. 2020; its period is 95 x 55 positions (x × y).

    The manufacturer does not publish the focal lengths of the lenslets. The three types are assumed to be in focus at
    virtual depths of 2, 3 and 5.
    """
    pixel = 5.5
    return Camera(
        "r29",
        MainLens(200e3, 4.0, 1e6, blades=9, blade_rotation_rad=0.1),
        _hexagonal(31.7 * pixel, 5.0, 31.0 * pixel, (2.0, 3.0, 5.0)),
        Sensor((4384, 6576), pixel, 12, 20e3, 12.0),
        wavelength_um=0.55,
        bandwidth_um=0.02,
    )


def bench() -> Camera:
    """Return a small camera with three lens types and a period of 33 x 19 positions (x × y), for tests and the demo."""
    pixel = 5.5
    # an odd, small cell whose period is nearly whole: 33 = 3 x 11, 19.05 = 2 x 11 sqrt(3)/2
    pitch = 11.0 * pixel
    return Camera(
        "bench",
        MainLens(50e3, 4.0, 300e3, blades=7, blade_rotation_rad=0.2),
        _hexagonal(pitch, 4.8, 10.6 * pixel, (2.0, 3.0, 5.0)),
        Sensor((320, 320), pixel, 12, 20e3, 8.0, black_level=64.0),
        wavelength_um=0.55,
        bandwidth_um=0.02,
    )


def lfm_20x05() -> Camera:
    """Return the 20x/0.5 light-field microscope of Broxton et al. 2013, with a lenslet pitch of 125 µm (15 px)."""
    pixel = 125.0 / 15
    return Camera(
        "lfm_20x05",
        Microscope(20.0, 0.5, 1.0),
        LensletLattice("square", 125.0, 2500.0, (LensType.focused_at(math.inf, 2500.0),)),
        Sensor((2160, 2560), pixel, 16, 30e3, 1.5, black_level=100.0),
        wavelength_um=0.525,
        bandwidth_um=0.02,
    )


def lfm_60x12() -> Camera:
    """Return a 60x/1.2 water-immersion light-field microscope with a lenslet pitch of 100 µm (15.385 px).

    The focal length of the lenslets is 2.5 mm, the pixel pitch 6.5 µm.
    """
    return Camera(
        "lfm_60x12",
        Microscope(60.0, 1.2, 1.35),
        LensletLattice("square", 100.0, 2500.0, (LensType.focused_at(math.inf, 2500.0),)),
        Sensor((2048, 2048), 6.5, 16, 30e3, 1.5, black_level=100.0),
        wavelength_um=0.593,
        bandwidth_um=0.02,
    )


def flfm_20x05() -> Camera:
    """Return a 20x/0.5 Fourier light-field microscope with 7 hexagonally arranged lenslets in a 7.5 mm pupil.

    The design follows Guo et al. 2019: the lateral resolution of a lenslet, 1.6 µm, corresponds to two pixels. It is
    λ/(2 NA) with a third of the objective's NA, because three lenslets fit across the pupil.
    """
    pitch = 2500.0
    ring = tuple((pitch * math.cos(k * math.pi / 3), pitch * math.sin(k * math.pi / 3)) for k in range(6))
    centres = ((0.0, 0.0), *((round(x, 6), round(y, 6)) for x, y in ring))
    return Camera(
        "flfm_20x05",
        Microscope(20.0, 0.5, 1.0),
        PupilLenslets(centres, fourier_um=150e3, gap_um=60e3, focal_lengths_um=(60e3,), clear_um=pitch),
        Sensor((1200, 1200), 6.5, 16, 30e3, 1.5, black_level=100.0),
        wavelength_um=0.525,
        bandwidth_um=0.02,
    )


PRESETS: dict[str, Callable[[], Camera]] = {
    "r29": r29,
    "lfm_20x05": lfm_20x05,
    "lfm_60x12": lfm_60x12,
    "flfm_20x05": flfm_20x05,
    "bench": bench,
}
"""Functions that make the presets, by name."""


def preset(name: str) -> Camera:
    """Return a built-in camera: ``"r29"``, ``"lfm_20x05"``, ``"lfm_60x12"``, ``"flfm_20x05"`` or ``"bench"``.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> camera = preset("r29")
    >>> print(f"{camera.pitch_px:.1f} px, f/{camera.optics.working_f_number:g}", camera.sensor.shape)
    31.7 px, f/5 (4384, 6576)
    """
    if name not in PRESETS:
        raise InputError.expected("preset", any_of(PRESETS), repr(name), choose(name, PRESETS))
    return PRESETS[name]()
