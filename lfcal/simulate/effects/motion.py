"""Effects of the stage: the source is not at the planned position."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.simulate.effects.base import Estimate, MotionEffect
from lfcal.simulate.effects.outlook import Outlook, PupilOutlook

__all__ = ["Backlash", "DepthError", "Drift", "PositioningError"]

MEAN = math.sqrt(2.0 / math.pi)
"""Mean absolute value of a standard normal deviate."""


def _pixels(outlook: Outlook, length_um: float) -> float:
    return abs(length_um) / outlook.camera.step_um(outlook.z_um)


@dataclass(frozen=True, slots=True)
class PositioningError(MotionEffect):
    """Random, normally distributed error of the lateral stage position, independent at every stop.

    Attributes
    ----------
    rms_um
        Rms error of each lateral axis (µm in object space). None: 2 µm, or 0.05 µm for a microscope.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Outlook, PositioningError
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = PositioningError(rms_um=2.0).estimate(plane)
    >>> print(f"{found.size:.3f} {found.unit} rms moves {found.error:.1%} of the image")
    0.096 px rms moves 3.6% of the image
    """

    rms_um: float | None = None

    name: ClassVar[str] = "stage_error"
    titles: ClassVar[Mapping[str, str]] = {"rms_um": "rms of each lateral axis"}
    typical_sizes: ClassVar[Mapping[str, tuple[float, float]]] = {"rms_um": (2.0, 0.05)}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"rms_um": (0.0, math.inf)}
    title: ClassVar[str] = "stage error"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 10

    def rms(self, camera: Camera) -> float:
        """Return the rms error of each lateral axis (µm in object space)."""
        rms: float = self.magnitude("rms_um", camera)
        return rms

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the rms shift of the image along each of y and x (px), and the relative error.

        The error is due to the mean length of the shift, which is 1.25 times this value.
        """
        shift = _pixels(outlook, self.rms(outlook.camera))
        length = math.sqrt(math.pi / 2) * shift  # mean length of a two-dimensional normal deviate
        return Estimate(shift, "px", outlook.source_moved(length), "|M| e; spots by 1.25 |M| e/v, shadow by 1.25 |M| e")

    def displace(
        self, commanded_um: NDArray[np.float64], camera: Camera, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return displacements ``(n, 3)``, order (z, y, x), in µm: normally distributed in y and x, 0 in z."""
        out = np.zeros_like(commanded_um)
        out[:, 1:] = self.rms(camera) * rng.standard_normal((len(out), 2))
        return out


@dataclass(frozen=True, slots=True)
class Backlash(MotionEffect):
    """Play between the drive and carriage of a stage: after a reversal, the carriage rests until the play is taken up.

    Attributes
    ----------
    play_um
        Lost motion of each lateral axis at a reversal (µm in object space). None: 10 µm, or 0.2 µm for a microscope.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Backlash
    >>> there_and_back = np.array([[0.0, 0.0, x] for x in (0, 10, 20, 10, 0)])
    >>> lag = Backlash(play_um=2.0).displace(there_and_back, preset("r29"), np.random.default_rng(0))
    >>> lag[:, 2].tolist()  # µm in x
    [0.0, 0.0, 0.0, 2.0, 2.0]
    """

    play_um: float | None = None

    name: ClassVar[str] = "backlash"
    titles: ClassVar[Mapping[str, str]] = {"play_um": "lost at a reversal"}
    typical_sizes: ClassVar[Mapping[str, tuple[float, float]]] = {"play_um": (10.0, 0.2)}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"play_um": (0.0, math.inf)}
    title: ClassVar[str] = "backlash"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 20

    def play(self, camera: Camera) -> float:
        """Return the lost motion at a reversal (µm in object space)."""
        play: float = self.magnitude("play_um", camera)
        return play

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the shift of the image due to the lost motion (px), and an upper bound of the relative error."""
        shift = _pixels(outlook, self.play(outlook.camera))
        return Estimate(shift, "px", outlook.source_moved(shift), "||M| e, if every position lags", True)

    def displace(
        self, commanded_um: NDArray[np.float64], camera: Camera, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return the carriage position minus the drive position, shape ``(n, 3)``, order (z, y, x), in µm.

        ``commanded_um`` contains the drive positions in the same layout. At the first one, the play is already taken up
        for motion towards increasing coordinates. The difference in z is 0.
        """
        del rng
        out, play = np.zeros_like(commanded_um), self.play(camera)
        for axis in (1, 2):
            drive = commanded_um[:, axis]
            carriage = drive[0]
            for k, target in enumerate(drive):
                # the drive pushes the carriage in one direction and pulls it in the other, with the play between
                carriage = min(max(carriage, target), target + play)
                out[k, axis] = carriage - target
        return out


@dataclass(frozen=True, slots=True)
class Drift(MotionEffect):
    """A slow, uniform drift of the source over the session.

    Attributes
    ----------
    rows_um, columns_um
        Displacement along y and along x at the end of the session (µm in object space). None: 5 µm, or 0.2 µm for a
        microscope.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import Drift
    >>> stops = np.zeros((3, 3))
    >>> Drift(rows_um=4.0, columns_um=1.0).displace(stops, preset("r29"), np.random.default_rng(0)).tolist()  # z, y, x
    [[0.0, 0.0, 0.0], [0.0, 2.0, 0.5], [0.0, 4.0, 1.0]]
    """

    rows_um: float | None = None
    columns_um: float | None = None

    name: ClassVar[str] = "drift"
    titles: ClassVar[Mapping[str, str]] = {"rows_um": "down, at the end", "columns_um": "right, at the end"}
    typical_sizes: ClassVar[Mapping[str, tuple[float, float]]] = {"rows_um": (5.0, 0.2), "columns_um": (5.0, 0.2)}
    title: ClassVar[str] = "drift over the session"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 30

    def end(self, camera: Camera) -> tuple[float, float]:
        """Return the displacement ``(y, x)`` of the source at the end of the session (µm in object space)."""
        return self.magnitude("rows_um", camera), self.magnitude("columns_um", camera)

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the final shift of the image (px), and the relative error due to half of this shift, its mean."""
        shift = _pixels(outlook, math.hypot(*self.end(outlook.camera)))
        return Estimate(shift, "px", outlook.source_moved(0.5 * shift), "||M| e at the end, half of it on average")

    def displace(
        self, commanded_um: NDArray[np.float64], camera: Camera, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return displacements ``(n, 3)``, order (z, y, x), in µm: 0 in z, and in y and x from 0 to `end`.

        They grow linearly with the index of the position.
        """
        del rng
        out = np.zeros_like(commanded_um)
        share = np.arange(len(out)) / max(1, len(out) - 1)
        out[:, 1:] = share[:, None] * np.array(self.end(camera))
        return out


@dataclass(frozen=True, slots=True)
class DepthError(MotionEffect):
    """Random, normally distributed error of the depth of each plane, the same for all positions in the plane.

    Attributes
    ----------
    rms_um
        Rms error of the depth of a plane (µm). None: 10 µm, or 0.1 µm for a microscope.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.simulate.effects import DepthError, Outlook
    >>> camera = preset("r29")
    >>> plane = Outlook(camera, camera.depth_of(4.0), cutout=(127, 127), period=(55, 95))
    >>> found = DepthError(rms_um=100.0).estimate(plane)
    >>> print(f"{found.size:.4f} of {plane.virtual_depth:.1f} in {found.unit}: {found.error:.1%} of the image")
    0.0065 of 4.0 in virtual depth: 2.4% of the image
    """

    rms_um: float | None = None

    name: ClassVar[str] = "depth_error"
    titles: ClassVar[Mapping[str, str]] = {"rms_um": "rms of a plane's depth"}
    typical_sizes: ClassVar[Mapping[str, tuple[float, float]]] = {"rms_um": (10.0, 0.1)}
    limits: ClassVar[Mapping[str, tuple[float, float]]] = {"rms_um": (0.0, math.inf)}
    title: ClassVar[str] = "depth error"
    without_lattice: ClassVar[bool] = True
    rank: ClassVar[int] = 40

    def rms(self, camera: Camera) -> float:
        """Return the rms error of a plane's depth (µm)."""
        rms: float = self.magnitude("rms_um", camera)
        return rms

    def estimate(self, outlook: Outlook) -> Estimate:
        """Return the change of the virtual depth due to the mean absolute depth error, and the relative error.

        For a Fourier light-field microscope, the first value is the mean absolute depth error itself (µm). The relative
        error is that due to the resulting shift of the spots.
        """
        camera = outlook.camera
        if isinstance(outlook, PupilOutlook):
            step = MEAN * self.rms(camera)
            return Estimate(step, "µm", outlook.moved(outlook.spread_px(step)), "dz; spots by B dz M² c/(n f²)")
        # virtual depth is nonlinear in z: use a finite step of the mean size, not a derivative
        step = MEAN * self.rms(camera)
        dv = abs(camera.virtual_depth(outlook.z_um + step) - camera.virtual_depth(outlook.z_um))
        shift = dv * outlook.gap_um / (3 * outlook.f_number * abs(outlook.virtual_depth)) / outlook.pixel_um
        if camera.optics.telecentric:
            shift = min(shift, outlook.shadow_px)
        return Estimate(dv, "virtual depth", outlook.moved(shift), "M² dz/B; shift dv B/(3 Nw v)")

    def displace(
        self, commanded_um: NDArray[np.float64], camera: Camera, rng: np.random.Generator
    ) -> NDArray[np.float64]:
        """Return displacements ``(n, 3)``, order (z, y, x), in µm: 0 in y and x, normally distributed in z.

        Positions with the same commanded z have the same displacement.
        """
        out = np.zeros_like(commanded_um)
        planes, which = np.unique(commanded_um[:, 0], return_inverse=True)
        out[:, 0] = (self.rms(camera) * rng.standard_normal(len(planes)))[which]
        return out


EFFECTS = (PositioningError, Backlash, Drift, DepthError)
