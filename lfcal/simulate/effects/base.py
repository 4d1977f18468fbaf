"""What every effect is: a frozen object with a name, an a-priori estimate, a cost class and a place where it acts.

An ideal camera is simulated with the empty tuple of effects. Each effect changes one thing, at one of five stages:

=========  ==========================================================================================
``scene``  the optics handed to the engine (`Scene`): costs nothing, unless waves must be followed
``light``  the light is a sum of point sources or wavelengths: the engine runs once per sample
``psf``    a small filter over the pixels of each response
``motion`` the source is not where the plan says
``frame``  the sensor frame: gain, noise, quantisation
=========  ==========================================================================================
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, MainLens
from lfcal.simulate.effects.outlook import Outlook

if TYPE_CHECKING:
    from lfcal.simulate.scene import Scene

__all__ = [
    "Effect",
    "Estimate",
    "FrameEffect",
    "FrameView",
    "LightEffect",
    "LightSample",
    "MotionEffect",
    "PsfEffect",
    "SceneEffect",
    "Stage",
]

Stage = Literal["scene", "light", "psf", "motion", "frame"]


@dataclass(frozen=True, slots=True)
class Estimate:
    """What an effect changes, foretold from the description alone.

    Attributes
    ----------
    size
        The physical size of the effect.
    unit
        Its unit.
    error
        Relative L1 error of the image if the effect is left out, sum(|without - with|) / sum(|with|).
    formula
        How both were computed, as text.
    upper_bound
        Whether ``error`` is an upper bound (within a factor of 4) and not an estimate (within 2).
    """

    size: float
    unit: str
    error: float
    formula: str
    upper_bound: bool = False


@dataclass(frozen=True, slots=True)
class LightSample:
    """One sample of the light: a point of the source at one wavelength.

    Attributes
    ----------
    rows, columns
        Displacement of the point's paraxial image from the nominal one (pixels).
    wavelength_um
        Vacuum wavelength (µm).
    weight
        Share of the light; the weights of an effect sum to 1.
    """

    rows: float
    columns: float
    wavelength_um: float
    weight: float


@dataclass(frozen=True, slots=True)
class FrameView:
    """The strip of a sensor frame on which frame effects act.

    Attributes
    ----------
    camera
        The camera; its sensor gives default magnitudes.
    exposure_s
        Exposure time (s).
    row
        Sensor row of the strip's first row.
    total_e
        Light of the whole frame (electrons).
    rng
        Random numbers of this effect on this strip of this frame.
    pattern
        Random numbers of this strip of the sensor, the same in every frame: called with the name of a pattern,
        returns standard normal deviates of the strip's shape.
    """

    camera: Camera
    exposure_s: float
    row: int
    total_e: float
    rng: np.random.Generator
    pattern: Callable[[str], NDArray[np.float32]]


def typical(value: float | None, camera: Camera, lens: float, microscope: float) -> float:
    """Return ``value``, or where it is None what is typical of the kind of optics."""
    if value is not None:
        return value
    return lens if isinstance(camera.optics, MainLens) else microscope


class Effect(ABC):
    """An effect; subclasses are frozen dataclasses whose fields are magnitudes (None: from the camera)."""

    __slots__ = ()

    name: ClassVar[str]
    title: ClassVar[str]
    stage: ClassVar[Stage]
    cost: ClassVar[str] = "free"
    deviation: ClassVar[bool] = False
    """Whether the effect is an error of build or use whose size the camera's description does not hold."""

    @abstractmethod
    def estimate(self, outlook: Outlook) -> Estimate:
        """Return what leaving the effect out would cost for the plane of ``outlook``."""

    def runs(self, outlook: Outlook) -> int:
        """Return how many times the engine must run for each response because of this effect."""
        del outlook
        return 1


class SceneEffect(Effect):
    """An effect that only describes the optics more fully."""

    __slots__ = ()
    stage: ClassVar[Stage] = "scene"

    @abstractmethod
    def on_scene(self, scene: Scene, outlook: Outlook) -> Scene:
        """Return the scene with the effect in it."""


class LightEffect(Effect):
    """An effect that spreads the light over source points or wavelengths."""

    __slots__ = ()
    stage: ClassVar[Stage] = "light"
    cost: ClassVar[str] = "engine run per sample"

    @abstractmethod
    def spread(self, samples: tuple[LightSample, ...], outlook: Outlook) -> tuple[LightSample, ...]:
        """Return ``samples`` spread out; the sum of weights stays the same."""

    def runs(self, outlook: Outlook) -> int:
        """Return the number of samples one point becomes."""
        return len(self.spread((LightSample(0.0, 0.0, outlook.wavelength_um, 1.0),), outlook))


class PsfEffect(Effect):
    """An effect that filters the pixels of each response."""

    __slots__ = ()
    stage: ClassVar[Stage] = "psf"
    cost: ClassVar[str] = "3 x 3 filter"

    @abstractmethod
    def kernel(self, camera: Camera) -> NDArray[np.float64]:
        """Return the filter ``(rows, columns)``, odd in both directions, that sums to the light kept."""


class MotionEffect(Effect):
    """An effect that displaces the source from where the plan says it is."""

    __slots__ = ()
    stage: ClassVar[Stage] = "motion"
    deviation: ClassVar[bool] = True

    @abstractmethod
    def displace(
        self, commanded_um: NDArray[np.float64], camera: Camera, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return true minus commanded positions ``(n, 3)`` as (z, y, x) in µm.

        ``commanded_um`` ``(n, 3)`` are the commanded positions in the order in which they are visited.
        """


class FrameEffect(Effect):
    """An effect on the sensor frame."""

    __slots__ = ()
    stage: ClassVar[Stage] = "frame"
    cost: ClassVar[str] = "per pixel"
    rank: ClassVar[int]
    """Order in which frame effects act, that of the light's way: optics, filter, photons, electrons, samples."""

    @abstractmethod
    def on_frame(self, strip: NDArray[np.float32], view: FrameView) -> NDArray[np.float32]:
        """Return the strip ``(rows, columns)`` after the effect; it may be changed in place.

        Electrons up to rank 80, sample values (counts) from there.
        """
