"""Interface of all engines, their sampling, and the energy balance that they must keep."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import LfcalError, check_number
from lfcal.simulate._pupil_scene import AnyScene

__all__ = ["LEVELS", "Certificate", "Displaceable", "EnergyError", "PlaneEngine", "Sampling"]

LEVELS: tuple[str, ...] = ("geometric", "wave", "grid", "debye", "reference")
"""Levels: rays; waves lens by lens; all lenslets on one grid; the Debye path of a microscope; the reference."""


class EnergyError(LfcalError):
    """A response contains more energy than its input, because the sampling is too coarse."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """Sampling of an engine that computes responses; each engine uses only some of the fields.

    Attributes
    ----------
    samples_per_px
        Samples of the field per sensor pixel, along each axis, on the lenslet array. None: the smallest number that a
        window allows; 4 on a grid; 8 for the reference.
    nodes_per_px
        Number of quadrature nodes per sensor pixel along each axis.
    margin_px
        Margin of the window around the geometric spot, or of the grid around the iris's shadow (px).
    energy_floor
        Threshold for leaving out dim lenslets, as a fraction of the light of the brightest lenslet, or of a sixteenth
        of all light if that is less. Lenslets that transmit less are left out.
    coherent
        Whether the fields of different lenslets are added before squaring, so that they interfere. None: chosen for the
        plane.
    double
        Whether to compute in complex128 instead of complex64.
    """

    samples_per_px: float | None = None
    nodes_per_px: int = 4
    margin_px: int = 5
    energy_floor: float = 3e-3
    coherent: bool | None = None
    double: bool = False

    def __post_init__(self) -> None:
        """Check all values."""
        if self.samples_per_px is not None:
            check_number("samples per pixel", self.samples_per_px, above=0, at_most=64)
        check_number("nodes per pixel", self.nodes_per_px, at_least=1, at_most=32, integer=True)
        check_number("window margin (px)", self.margin_px, at_least=1, at_most=1000, integer=True)
        check_number("energy floor", self.energy_floor, at_least=0, below=0.1)


@dataclass(frozen=True, slots=True)
class Certificate:
    """Energy balance of the responses computed so far, in units of the light through the iris for one position.

    Attributes
    ----------
    responses
        Number of responses computed and checked.
    energy_in, energy_out
        Sums over the responses: light through the lenslets, and light in their windows on the sensor.
    worst
        Largest ratio of energy out to energy in among responses with any energy; at most 1, up to numerical errors.
    """

    responses: int = 0
    energy_in: float = 0.0
    energy_out: float = 0.0
    worst: float = 0.0


class Ledger:
    """Running sum of certificates, to which several threads may add."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sum = Certificate()

    def add(self, responses: int, energy_in: float, energy_out: float, worst: float) -> None:
        """Add one certificate; the arguments are as in `Certificate`."""
        with self._lock:
            s = self._sum
            self._sum = Certificate(
                s.responses + responses, s.energy_in + energy_in, s.energy_out + energy_out, max(s.worst, worst)
            )

    @property
    def certificate(self) -> Certificate:
        """Sum of all certificates so far."""
        with self._lock:
            return self._sum


@runtime_checkable
class PlaneEngine(Protocol):
    """Protocol for an engine, which computes the responses of one depth plane; safe to call from several threads.

    Values are fractions of the light that passes the iris towards the array. The sum over an infinite cutout is the
    light that the lenslets transmit (about the fill factor).
    """

    @property
    def scene(self) -> AnyScene:
        """The scene that is computed."""
        ...

    @property
    def level(self) -> str:
        """Level of accuracy, one of `LEVELS`."""
        ...

    @property
    def grid_side(self) -> int:
        """Number of samples along a side of the largest grid used for a position or a lenslet; 0 without a grid."""
        ...

    @property
    def certificate(self) -> Certificate:
        """Energy in and out of all responses so far."""
        ...

    def rows(
        self, ys: ArrayLike, xs: ArrayLike, out: NDArray[np.float32] | None = None, workers: int | None = None
    ) -> NDArray[np.float32]:
        """Return the cutouts ``(len(ys), len(xs), nt, ns)`` of the positions (y, x) in rows ``ys`` and columns ``xs``.

        Positions are integers, which may be outside the period; (nt, ns) is the shape of a cutout. The result is
        written to ``out``; None: to a new array. ``workers`` is the number of threads. None: one for each processor; 1:
        only the caller's thread.

        Raises
        ------
        EnergyError
            If the sampling is too coarse.
        """
        ...

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout ``(nt, ns)`` for a chief ray that meets the sensor at the point (``y_um``, ``x_um``).

        The point (µm) is relative to the sensor point of source position (0, 0). The cutout is centred on the nearest
        pixel, see `Scene.nearest_pixel`.
        """
        ...

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions, extrapolated from a short measurement."""
        ...


@runtime_checkable
class Displaceable(Protocol):
    """Protocol for an engine whose tables can also be used for displaced sources."""

    def displaced(self, offsets_um: NDArray[np.float64]) -> PlaneEngine:
        """Return an engine of the same plane for displaced sources.

        ``offsets_um`` contains the displacement (dy, dx) of each source position on the sensor (µm), ``(ny, nx, 2)``
        for a period of ``(ny, nx)`` positions.
        """
        ...


class Pilot:
    """Prediction of an engine's computing time from a short run, which takes place only once, at the first use.

    The time of positions in two rows of the period is measured in the caller's thread, after a first position that is
    not timed. There are at most ``columns`` positions in a row.
    """

    # without a reference to its engine: circular references would keep tables in memory long after their use
    def __init__(self, columns: int = 24) -> None:
        self._columns = columns
        self._each: float | None = None

    def seconds(self, engine: PlaneEngine, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions; ``engine`` is used only for the short run."""
        if self._each is None:
            ny, nx = engine.scene.period
            xs = np.unique(np.linspace(0, nx - 1, min(nx, self._columns)).astype(int))
            ys = np.unique([ny // 7, (3 * ny) // 5])
            engine.rows(ys[:1], xs[:1], workers=1)
            start = time.thread_time()
            engine.rows(ys, xs, workers=1)
            self._each = (time.thread_time() - start) / (len(xs) * len(ys))
        return self._each * n_positions
