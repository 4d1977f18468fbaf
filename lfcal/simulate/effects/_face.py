"""The public names of `lfcal.simulate.effects`, each loaded on first use."""

from __future__ import annotations

from lfcal.simulate.effects.aberrations import Coma, FieldAberrations, Spherical, Zernike
from lfcal.simulate.effects.array_errors import ArrayRotation, ArrayTilt, LensletGap, PitchError, Telecentricity
from lfcal.simulate.effects.base import (
    ActsOn,
    Effect,
    EngineSeconds,
    Estimate,
    FrameEffect,
    LightEffect,
    LightSample,
    MotionEffect,
    PsfEffect,
    SceneEffect,
    SensorStrip,
)
from lfcal.simulate.effects.colour import ChromaticFocus, LensletDispersion
from lfcal.simulate.effects.faults import Ghost, SensorNonlinearity
from lfcal.simulate.effects.field import CosFourth, MechanicalVignetting
from lfcal.simulate.effects.glass import CoverGlass
from lfcal.simulate.effects.image import Distortion, FieldCurvature
from lfcal.simulate.effects.kernel import PixelKernel
from lfcal.simulate.effects.lenslets import LensletSpherical, MissingLenslets
from lfcal.simulate.effects.light import Bandwidth, FiniteSource
from lfcal.simulate.effects.microscope import IndexMismatch, VectorialPupil
from lfcal.simulate.effects.motion import Backlash, DepthError, Drift, PositioningError
from lfcal.simulate.effects.optics import (
    ExactAngles,
    IrisDiffraction,
    IrisShape,
    LensLaw,
    LensletDiffraction,
    LensTypeDefocus,
)
from lfcal.simulate.effects.outlook import Outlook, PupilOutlook
from lfcal.simulate.effects.pixels import AngularResponse, Crosstalk, PixelFill
from lfcal.simulate.effects.registered import CATALOGUE, catalogue, find_effects
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
    "ActsOn",
    "AngularResponse",
    "ArrayRotation",
    "ArrayTilt",
    "Backlash",
    "Bandwidth",
    "ChromaticFocus",
    "ColourFilter",
    "Coma",
    "CosFourth",
    "CoverGlass",
    "Crosstalk",
    "DarkCurrent",
    "DepthError",
    "Distortion",
    "Drift",
    "Effect",
    "EngineSeconds",
    "Estimate",
    "ExactAngles",
    "FieldAberrations",
    "FieldCurvature",
    "FiniteSource",
    "FixedPattern",
    "FrameEffect",
    "Ghost",
    "IndexMismatch",
    "IrisDiffraction",
    "IrisShape",
    "LensLaw",
    "LensTypeDefocus",
    "LensletDiffraction",
    "LensletDispersion",
    "LensletGap",
    "LensletSpherical",
    "LightEffect",
    "LightSample",
    "MechanicalVignetting",
    "MissingLenslets",
    "MotionEffect",
    "Outlook",
    "PitchError",
    "PixelFill",
    "PixelKernel",
    "PositioningError",
    "PsfEffect",
    "PupilOutlook",
    "Quantisation",
    "ReadNoise",
    "Saturation",
    "SceneEffect",
    "SensorNonlinearity",
    "SensorStrip",
    "ShotNoise",
    "Spherical",
    "StrayLight",
    "Telecentricity",
    "VectorialPupil",
    "Zernike",
    "catalogue",
    "find_effects",
]
