"""Base of all effects: a frozen object with a name, an a-priori estimate, a cost, and its action on the simulation.

An ideal camera is simulated with the empty tuple of effects. Each effect changes one thing; see `ActsOn`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from enum import Enum
from numbers import Real
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import check_number
from lfcal.camera import Camera, has_value, value_at
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.scene import Scene

__all__ = [
    "WHITE_IMAGE",
    "ActsOn",
    "Effect",
    "EngineSeconds",
    "Estimate",
    "FrameEffect",
    "LightEffect",
    "LightSample",
    "MotionEffect",
    "PsfEffect",
    "SceneEffect",
    "SensorStrip",
]

WHITE_IMAGE = "white image"
"""Source of the size of an effect that `lfcal white` measures; see `Effect.measured_by`."""


class ActsOn(Enum):
    """Part of the simulation on which an effect acts; lists of effects are in the order of the members."""

    SCENE = "optics"
    """The `Scene` given to the engine; costs nothing, unless waves must be computed."""
    LIGHT = "light"
    """The light is a sum of point sources or wavelengths; the engine runs once for each sample."""
    RESPONSE = "response"
    """Each response is filtered over a few pixels."""
    MOTION = "stage"
    """The source is not at the planned position."""
    FRAME = "sensor frame"
    """Gain, noise and quantisation of the recorded frame."""

    @property
    def enters_h(self) -> bool:
        """Whether effects of this kind change the matrix H; otherwise, they change only the frames of a session."""
        return self not in (ActsOn.MOTION, ActsOn.FRAME)


@dataclass(frozen=True, slots=True)
class EngineSeconds:
    """CPU times for simulating one depth plane without the effect (s), from which the cost of the effect is derived.

    Attributes
    ----------
    rays
        Time of the geometric engine, which traces rays (s).
    waves
        Time of the wave engine, or of the Debye integral for a microscope (s). It includes the table of the main lens's
        field, with or without diffraction.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import EngineSeconds, LensletDiffraction, Outlook
    >>> plane = Outlook(preset("r29"), -52e3, cutout=(127, 127), period=(55, 95))
    >>> LensletDiffraction().seconds(plane, EngineSeconds(rays=1.0, waves=30.0))  # waves less rays
    29.0
    """

    rays: float
    waves: float


@dataclass(frozen=True, slots=True)
class Estimate:
    """Size of an effect and the error that leaving it out would cause, predicted from the camera's description.

    Attributes
    ----------
    size
        Magnitude of the effect, in ``unit``.
    unit
        Unit of ``size``, for example ``"px"``.
    error
        Relative L1 error of the simulated image if the effect is left out: sum(|without - with|) / sum(|with|) over the
        pixels, 0 to 2.
    formula
        Text that states how ``size`` and ``error`` were computed.
    upper_bound
        Whether ``error`` is an upper bound (within a factor of 4 of the true error) instead of an estimate (within a
        factor of 2).
    measured
        Whether ``error`` was measured by simulating with and without the effect, instead of computed by the formula.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Estimate, LensletDiffraction, Outlook
    >>> plane = Outlook(preset("r29"), -52e3, cutout=(127, 127), period=(55, 95))
    >>> found: Estimate = LensletDiffraction().estimate(plane)
    >>> print(f"{found.size:.2f} {found.unit}, {found.error:.0%} of the image: {found.formula}")
    0.62 px, 47% of the image: 1.22 lambda B/d; 0.65/(1 + N_F)^(1/3) per type
    """

    size: float
    unit: str
    error: float
    formula: str
    upper_bound: bool = False
    measured: bool = False


@dataclass(frozen=True, slots=True)
class LightSample:
    """One sample of the light: a point of the source at one wavelength.

    Attributes
    ----------
    rows, columns
        Displacement of the point's paraxial image at the lenslets from that of the nominal source point (px).
    wavelength_um
        Vacuum wavelength (µm).
    weight
        Fraction of the source's light; the weights of all samples sum to 1.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Bandwidth, LightSample, Outlook
    >>> camera = preset("bench")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(61, 61), period=(19, 33))
    >>> point = LightSample(rows=0.0, columns=0.0, wavelength_um=0.55, weight=1.0)
    >>> [(round(s.wavelength_um, 4), round(s.weight, 3)) for s in Bandwidth(0.02).spread((point,), plane)]
    [(0.5414, 0.174), (0.5466, 0.326), (0.5534, 0.326), (0.5586, 0.174)]
    """

    rows: float
    columns: float
    wavelength_um: float
    weight: float


@dataclass(frozen=True, slots=True)
class SensorStrip:
    """Position and context of a strip of sensor rows on which frame effects act.

    Attributes
    ----------
    camera
        Camera, whose sensor provides the default magnitudes.
    exposure_s
        Exposure time (s).
    row
        Index of the strip's first row on the sensor, from 0.
    total_e
        Total light of the frame (electrons).
    rng
        Random number generator for this effect, strip and frame.
    pattern
        Function that returns a random pattern of this strip that is the same in every frame. Called with the name of a
        pattern, it returns standard normal deviates in the shape of the strip.
    light_e
        Light of the complete frame, ``(rows, columns)``, before any effect (electrons), for effects that move light
        within the frame. Read-only.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import DarkCurrent, SensorStrip
    >>> camera, rng, dark = preset("bench"), np.random.default_rng(0), np.zeros((320, 320), np.float32)
    >>> view = SensorStrip(camera, 2.0, row=0, total_e=0.0, rng=rng, pattern=lambda name: dark[:128], light_e=dark)
    >>> print(DarkCurrent(3.0).on_frame(dark[:128].copy(), view).max())  # 2 s of 3 e-/s
    6.0
    """

    camera: Camera
    exposure_s: float
    row: int
    total_e: float
    rng: np.random.Generator
    pattern: Callable[[str], NDArray[np.float32]]
    light_e: NDArray[np.float32]


def typical(value: float | None, camera: Camera, lens: float, microscope: float) -> float:
    """Return ``value``; if it is None, ``microscope`` for a microscope, and ``lens`` for other cameras."""
    if value is not None:
        return value
    return microscope if camera.optics.telecentric else lens


def _frozen(value: Any) -> Any:
    return tuple(_frozen(one) for one in value) if isinstance(value, list | tuple) else value


class Effect(ABC):
    """Base class of effects: frozen dataclasses with magnitudes as fields; None means the camera's or a typical value.

    Every field has a default, because the catalogue creates each effect without arguments.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Effect, ReadNoise
    >>> noise: Effect = ReadNoise()
    >>> noise.magnitude("rms_e", preset("r29")), ReadNoise(2.5).magnitude("rms_e", preset("r29"))  # electrons
    (12.0, 2.5)
    """

    __slots__ = ()

    name: ClassVar[str]
    """Name in plans, files and commands; it must never change, because files contain it."""
    title: ClassVar[str]
    """Display name."""
    acts_on: ClassVar[ActsOn]
    rank: ClassVar[int] = 50
    """Sort key among the effects with the same `acts_on`; frame effects are applied in this order."""
    deviation: ClassVar[bool] = False
    """Whether it is an error of assembly or use whose size is not in the camera's description."""
    measured_by: ClassVar[str] = ""
    """What determines its size in a camera with a lattice: `WHITE_IMAGE`, or a group of unknowns of `lfcal.fit`.

    A group needs a few frames of a point source. Empty: neither.
    """
    needs_waves: ClassVar[bool] = False
    """Whether rays cannot show the effect, so that it switches lenslet diffraction on."""
    by_wavelength: ClassVar[bool] = False
    """Whether it depends on wavelength; wavelengths are then spread over the spectrum, even without `Bandwidth`."""
    without_lattice: ClassVar[bool] = False
    """Whether it also applies to cameras without a lenslet lattice (`lfcal.camera.Camera.has_lattice`)."""
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {}
    """Smallest and largest values of magnitudes that are limited."""
    units: ClassVar[Mapping[str, str]] = {}
    """Units of magnitudes whose names contain none (``_um``, ``_rad``, ``_s``): waves, pupil radii, a fraction."""
    titles: ClassVar[Mapping[str, str]] = {}
    """Display names of magnitudes, if they differ from the name of the field."""
    described: ClassVar[Mapping[str, str]] = {}
    """Place of the values in the camera's description, such as ``"sensor.prnu"``, for magnitudes that are None."""
    typical_sizes: ClassVar[Mapping[str, tuple[float, float]]] = {}
    """Typical sizes of magnitudes that are neither given nor described: with a main lens, and in a microscope."""

    def __post_init__(self) -> None:
        """Check that every magnitude is a finite number within its limits.

        None is replaced by the camera's value later.
        """
        for field in fields(self):  # type: ignore[arg-type]  # subclasses are dataclasses
            value = getattr(self, field.name)
            if isinstance(value, list):  # effects are values: equal ones compare equal and have the same hash
                object.__setattr__(self, field.name, _frozen(value))
            if isinstance(value, bool) or not isinstance(value, Real):
                continue  # letters of a colour filter, Zernike terms: checked where they are used
            bounds = self.limits.get(field.name, (-math.inf, math.inf))
            low, high = (bound if math.isfinite(bound) else None for bound in bounds)
            # refuses NaN and infinity, which may come from a file or a command line
            check_number(f"{self.title}: {field.name}", value, at_least=low, at_most=high)

    def spectrum_um(self) -> float | None:
        """Return the full width of the spectrum given to the effect (µm); None if it is not given or irrelevant."""
        return None

    def applies_to(self, camera: Camera) -> bool:
        """Return whether ``camera`` has the component on which the effect acts."""
        return self.without_lattice or camera.has_lattice

    def magnitude(self, field: str, camera: Camera) -> Any:
        """Return the value of the field ``field``; if it is None, return the camera's value, or else a typical one.

        The result is None if there is none of these.
        """
        value = getattr(self, field)
        if value is None and self.is_described(field, camera):
            value = value_at(camera, self.described[field])
        if value is None and field in self.typical_sizes:
            return typical(None, camera, *self.typical_sizes[field])
        return value

    @classmethod
    def is_described(cls, field: str, camera: Camera) -> bool:
        """Return whether the description of ``camera`` has a value for ``field``."""
        return has_value(camera, cls.described.get(field, ""))

    def settled_by(self, camera: Camera) -> str:
        """Return `measured_by`, which determines the size of the effect; empty if ``camera`` has no lattice."""
        return self.measured_by if camera.has_lattice else ""

    @abstractmethod
    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the size of the effect in the plane of ``outlook``, and the relative error if it is left out."""

    def holds(self, outlook: Outlook) -> bool:
        """Return whether the formula that `estimate` uses is valid in the plane of ``outlook``.

        If it is not, the error is measured by simulating a few positions with and without the effect.
        """
        return outlook.regular

    def wavelengths(self, outlook: Outlook) -> int:
        """Return the minimum number of wavelengths that the effect requires; 1 if it does not depend on wavelength."""
        del outlook
        return 1

    def runs(self, outlook: Outlook) -> int:
        """Return the number of engine runs per response that the effect requires; 1 unless overridden."""
        del outlook
        return 1

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return the CPU time (s) that the effect adds to simulating the plane of ``outlook``; 0 unless overridden."""
        del outlook, engine
        return 0.0


class SceneEffect(Effect):
    """An effect that changes the optics of the simulated scene.

    Examples
    --------
    >>> from lfcal.simulate.effects import SceneEffect, catalogue
    >>> scene_effects = [effect for effect in catalogue() if isinstance(effect, SceneEffect)]
    >>> print(*(effect.name for effect in scene_effects if effect.needs_waves))  # rays do not show these
    lenslet_diffraction lenslet_spherical lens_law vectorial spherical coma zernike field_aberrations
    """

    changes_work: ClassVar[bool] = False
    """Whether the effect changes how much an engine computes: by the symmetry of the array, the pupil or the fields."""

    __slots__ = ()
    acts_on: ClassVar[ActsOn] = ActsOn.SCENE

    @abstractmethod
    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return ``scene`` with the effect; the argument itself is not modified."""


class LightEffect(Effect):
    """An effect that replaces a monochromatic point source by several source points or wavelengths.

    Examples
    --------
    >>> from lfcal.simulate.effects import LightEffect, catalogue
    >>> print(*(effect.name for effect in catalogue() if isinstance(effect, LightEffect)))
    finite_source bandwidth
    """

    __slots__ = ()
    acts_on: ClassVar[ActsOn] = ActsOn.LIGHT

    @abstractmethod
    def spread(self, samples: tuple[LightSample, ...], outlook: Outlook) -> tuple[LightSample, ...]:
        """Return several points or wavelengths for each of ``samples``; the sum of the weights is unchanged."""

    def runs(self, outlook: Outlook) -> int:
        """Return the number of samples that replace one sample of the light."""
        return len(self.spread((LightSample(0.0, 0.0, outlook.wavelength_um, 1.0),), outlook))

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return the CPU time of the additional engine runs (s)."""
        return engine.waves * (self.runs(outlook) - 1)


class PsfEffect(Effect):
    """An effect that convolves each response, the image of one source position, with a small kernel.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Crosstalk, PsfEffect
    >>> effect: PsfEffect = Crosstalk(0.01)
    >>> print(f"{effect.kernel(preset('r29'))[1, 1]:.2f} of the light stays")  # (1 - 2 x)²
    0.96 of the light stays
    """

    __slots__ = ()
    acts_on: ClassVar[ActsOn] = ActsOn.RESPONSE

    @abstractmethod
    def kernel(self, camera: Camera) -> NDArray[np.float64]:
        """Return the kernel for ``camera``, with odd numbers of rows and columns.

        Its sum is the fraction of the light that is not lost.
        """

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return the CPU time of a 3 x 3 convolution (s), measured as 2 % of that of the wave engine."""
        del outlook
        return 0.02 * engine.waves


class MotionEffect(Effect):
    """An effect that displaces the source from its planned position.

    Examples
    --------
    >>> from lfcal.simulate.effects import MotionEffect, catalogue
    >>> print(*(effect.name for effect in catalogue() if isinstance(effect, MotionEffect)))
    stage_error backlash drift depth_error
    """

    __slots__ = ()
    acts_on: ClassVar[ActsOn] = ActsOn.MOTION
    deviation: ClassVar[bool] = True

    @abstractmethod
    def displace(
        self, commanded_um: NDArray[np.float64], camera: Camera, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return the actual minus the commanded source positions, shape ``(n, 3)``, order (z, y, x), in µm.

        ``commanded_um`` contains the commanded positions in the same layout, in the order of recording. Magnitudes that
        are None are taken from ``camera``; random errors are drawn from ``rng``.
        """


class FrameEffect(Effect):
    """An effect that changes the pixels of a simulated sensor frame.

    Examples
    --------
    >>> from lfcal.simulate.effects import FrameEffect, catalogue
    >>> print(*(effect.name for effect in catalogue() if isinstance(effect, FrameEffect)))
    cos4 ghost stray_light colour_filter fixed_pattern dark_current shot_noise saturation nonlinearity read_noise
    quantisation
    """

    __slots__ = ()
    acts_on: ClassVar[ActsOn] = ActsOn.FRAME
    stream: ClassVar[int | None] = None
    """Key of the effect's random numbers; None derives it from the name, which is unique."""
    pixel_ns: ClassVar[float] = 1.0
    """Computing time per pixel of a frame (ns, measured)."""
    whole_numbers: ClassVar[bool] = False
    """Whether the effect rounds frames to whole numbers, which are then stored as integers.

    Such an effect is selected for frames unless it is switched off.
    """

    @abstractmethod
    def on_frame(self, strip: NDArray[np.float32], view: SensorStrip) -> NDArray[np.float32]:
        """Apply the effect to ``strip``, shape ``(rows, columns)``, possibly in place, and return the result.

        Pixel values are in electrons for effects with a `rank` below 80, and in counts for the others. ``view``
        contains the position of the strip and properties of the frame.
        """

    def seconds(self, outlook: Outlook, engine: EngineSeconds) -> float:
        """Return the CPU time for applying the effect to all frames of the plane (s)."""
        del engine
        rows, columns = outlook.camera.sensor.shape
        return outlook.period[0] * outlook.period[1] * rows * columns * self.pixel_ns * 1e-9
