"""Physical effects as objects: an ideal camera is the empty tuple.

- ``base``: what every effect is
- ``outlook``: the a-priori numbers all estimates are built from
- ``optics``: lens types, diffraction, the iris's shape, non-paraxial terms
- ``aberrations``: spherical aberration, coma, any Zernike terms
- ``array_errors``: telecentricity; gap, rotation and pitch of the lenslet array
- ``field``: cos^4 and mechanical vignetting
- ``light``: finite source, bandwidth
- ``pixels``: fill factor, crosstalk
- ``motion``: stage error, backlash, drift, depth error
- ``sensor``: stray light, colour filter, noise, quantisation, saturation
"""

from __future__ import annotations

from lfcal.simulate.effects.aberrations import Coma, Spherical, Zernike
from lfcal.simulate.effects.array_errors import ArrayRotation, LensletGap, PitchError, Telecentricity
from lfcal.simulate.effects.base import (
    Effect,
    Estimate,
    FrameEffect,
    FrameView,
    LightEffect,
    LightSample,
    MotionEffect,
    PsfEffect,
    SceneEffect,
)
from lfcal.simulate.effects.field import CosFourth, Vignetting
from lfcal.simulate.effects.light import Bandwidth, FiniteSource
from lfcal.simulate.effects.motion import Backlash, DepthError, Drift, StageError
from lfcal.simulate.effects.optics import (
    ExactAngles,
    IrisDiffraction,
    IrisShape,
    LensletDiffraction,
    LensTypes,
)
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.effects.pixels import Crosstalk, PixelFill
from lfcal.simulate.effects.sensor import (
    ColourFilter,
    DarkCurrent,
    FixedPattern,
    Quantisation,
    ReadNoise,
    Saturation,
    ShotNoise,
    StrayLight,
)

__all__ = [
    "CATALOGUE",
    "ArrayRotation",
    "Backlash",
    "Bandwidth",
    "ColourFilter",
    "Coma",
    "CosFourth",
    "Crosstalk",
    "DarkCurrent",
    "DepthError",
    "Drift",
    "Effect",
    "Estimate",
    "ExactAngles",
    "FiniteSource",
    "FixedPattern",
    "FrameEffect",
    "FrameView",
    "IrisDiffraction",
    "IrisShape",
    "LensTypes",
    "LensletDiffraction",
    "LensletGap",
    "LightEffect",
    "LightSample",
    "MotionEffect",
    "Outlook",
    "PitchError",
    "PixelFill",
    "PsfEffect",
    "Quantisation",
    "ReadNoise",
    "Saturation",
    "SceneEffect",
    "ShotNoise",
    "Spherical",
    "StageError",
    "StrayLight",
    "Telecentricity",
    "Vignetting",
    "Zernike",
    "catalogue",
]

CATALOGUE: tuple[type[Effect], ...] = (
    LensTypes,
    LensletDiffraction,
    IrisDiffraction,
    IrisShape,
    Telecentricity,
    ExactAngles,
    CosFourth,
    Vignetting,
    Spherical,
    Coma,
    Zernike,
    LensletGap,
    ArrayRotation,
    PitchError,
    FiniteSource,
    Bandwidth,
    PixelFill,
    Crosstalk,
    StageError,
    Backlash,
    Drift,
    DepthError,
    StrayLight,
    ColourFilter,
    FixedPattern,
    DarkCurrent,
    ShotNoise,
    Saturation,
    ReadNoise,
    Quantisation,
)
"""Every kind of effect, in the order of the light's way."""


def catalogue() -> tuple[Effect, ...]:
    """Return one of every effect: known ones as the camera describes them, deviations at a typical size."""
    return tuple(kind() for kind in CATALOGUE)
