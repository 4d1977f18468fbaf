"""Physical effects as objects: an ideal camera is the empty tuple.

An effect is one class in one module, which names it in its ``EFFECTS``; other distributions bring theirs through the
entry point group ``lfcal.effects`` (``docs/adding_an_effect.md``).

- ``base``: what every effect is
- ``outlook``: the a-priori numbers all estimates are built from
- ``optics``: lens types, diffraction, the iris's shape, non-paraxial terms
- ``aberrations``: spherical aberration, coma, any Zernike terms; how they change over the field
- ``array_errors``: telecentricity; gap, rotation, pitch and tilt of the lenslet array
- ``field``: cos^4 and mechanical vignetting
- ``colour``: longitudinal colour, the lenslets' dispersion
- ``faults``: ghost images, the sensor's nonlinearity
- ``glass``: the sensor's cover glass
- ``image``: field curvature, distortion
- ``lenslets``: their spherical aberration, defective ones
- ``kernel``: a free filter of the pixels
- ``light``: finite source, bandwidth
- ``microscope``: light as a vector field, specimens of another refractive index
- ``pixels``: fill factor, response to angles, crosstalk
- ``motion``: positioning error, backlash, drift, depth error
- ``sensor``: stray light, colour filter, noise, quantisation, saturation; ``poisson``: its deviates
- ``magnitudes``: the magnitudes of an effect one by one, with units and sources
- ``described``: effects in words and in files
"""

from __future__ import annotations

import inspect
import math
from dataclasses import is_dataclass

from lfcal.camera import preset
from lfcal.registry import Registry
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
    LensletDiffraction,
    LensTypeDefocus,
)
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.effects.pixels import AngularResponse, Crosstalk, PixelFill
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


GROUP = "lfcal.effects"
"""Entry point group of effects of other distributions."""


def check_effect(kind: type[Effect]) -> None:
    """Raise `TypeError`, or what its own code raises, unless ``kind`` can be listed, planned and kept in a file."""
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise TypeError("it is not a class derived from Effect")
    if inspect.isabstract(kind):
        raise TypeError(f"it lacks {', '.join(sorted(kind.__abstractmethods__))}")
    # The fields are the magnitudes that provenance keeps; two equal effects must compare equal.
    if not is_dataclass(kind) or not kind.__dataclass_params__.frozen:
        raise TypeError("it is not a frozen dataclass")
    if not isinstance(getattr(kind, "title", None), str) or not isinstance(getattr(kind, "acts_on", None), ActsOn):
        raise TypeError("it does not say its title or what it acts on")
    # Tried here, because one estimate that fails later would stop every plan, whether it wants the effect or not.
    camera = preset("bench")
    outlook = Outlook(camera, camera.depth_of(4.0), (61, 61), (33, 19))
    found = kind().estimate(outlook)
    if not isinstance(found, Estimate) or not math.isfinite(found.error):
        raise TypeError("it has no estimate")
    kind().seconds(outlook, EngineSeconds(1.0, 1.0, 1.0))


def find_effects() -> Registry[type[Effect]]:
    """Return every kind of effect by name, in the order of the light's way; those of other distributions included.

    Examples
    --------
    >>> from lfcal.simulate.effects import find_effects
    >>> kinds = find_effects()
    >>> Coma = kinds.get("coma")
    >>> print(Coma.title, Coma(waves=0.5), sep=": ")
    coma: Coma(waves=0.5, angle_rad=0.0)
    """
    places = list(ActsOn)
    return Registry(
        "effect",
        "lfcal.simulate.effects",
        "EFFECTS",
        GROUP,
        order=lambda kind: (places.index(kind.acts_on), kind.rank, kind.name),
        check=check_effect,
    )


CATALOGUE = find_effects()
"""Every kind of effect."""


def catalogue() -> tuple[Effect, ...]:
    """Return one of every effect: known ones as the camera describes them, deviations at a typical size.

    Examples
    --------
    >>> from lfcal.simulate.effects import catalogue
    >>> effects = {effect.name: effect for effect in catalogue()}
    >>> effects["lenslet_gap"], effects["read_noise"]  # a typical error; what the camera says
    (LensletGap(error_um=5.0), ReadNoise(rms_e=None))
    """
    return tuple(kind() for kind in CATALOGUE)
