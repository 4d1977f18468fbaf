"""Definition of a fault, how it is found, and its effect on patterns."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Registry
from lfcal.judge.evidence import Evidence

if TYPE_CHECKING:
    from lfcal.judge._patch import Patch

__all__ = ["FAULTS", "Fault", "FaultPicture", "FoundFault", "PutIn", "Repair", "adding"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

PutIn = Callable[["Patch"], F4]
"""Takes a patch of positions without a fault, and returns its patterns ``(n, nt, ns)`` with the fault."""

Repair = Callable[[NDArray[np.intp], F4], F4]
"""Takes positions ``(n, 3)`` as (z, y, x) and their patterns ``(n, nt, ns)``, and returns these without the fault."""


def adding(own: NDArray[np.intp], light: F4 | F8) -> Repair:
    """Return a function that adds ``light`` ``(n, nt, ns)`` to patterns at exactly the positions ``own`` ``(n, 3)``.

    It returns patterns at any other set of positions unchanged.
    """
    missing = np.asarray(light, np.float32)
    return lambda index, patterns: patterns + missing if np.array_equal(index, own) else patterns


@dataclass(frozen=True, eq=False)
class FaultPicture:
    """Data of a plot that shows a fault: a curve ``(n,)`` over ``across``, or a map ``(rows, columns)``.

    Attributes
    ----------
    values, unit
        Values to draw, ``(n,)`` or ``(rows, columns)``, and their unit.
    title
        Title of the plot or map.
    axes
        Labels of the axes: rows and columns of a map, or the abscissa of a curve.
    across
        Abscissa of a curve ``(n,)``. None: indices from 0.
    origin
        Coordinates (row, column) of the first row and column of a map.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.judge import FAULTS, FoundFault, FaultPicture
    >>> light = np.array([1.0, 1.0, 0.9, 0.8])
    >>> curve = FaultPicture(light, "", "light of the source over the scan", ("position",), across=np.arange(4.0))
    >>> found = FoundFault(FAULTS.get("lamp"), "light fell by 20 %", sigmas=9.0, share=0.1, picture=curve)
    >>> print(found.picture.title, found.picture.values.tolist())
    light of the source over the scan [1.0, 1.0, 0.9, 0.8]
    """

    values: F8
    unit: str
    title: str
    axes: tuple[str, ...]
    across: F8 | None = None
    origin: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class FoundFault:
    """Fault found in an H.

    Attributes
    ----------
    fault
        The kind of the fault.
    detail
        Details of the fault, with numbers and units.
    sigmas
        Significance of the fault, in standard deviations of the rest of H.
    share
        Fraction of the light of the patterns that the fault changes (relative L1); used if ``cost`` is not measured.
    positions
        Affected positions (z, y, x), ``(n, 3)``; empty: all.
    pixels
        Affected pixels (row, column) of the sensor, relative to the first cutout of H, ``(n, 2)``.
    picture
        Plot that shows the fault. None: there is none.
    repair
        Function that removes the fault from patterns (`Repair`). None: only a new recording helps.
    blinds
        Whether the values of ``pixels`` are invalid.
    masked
        Function that takes patterns ``(n, nt, ns)`` and returns a mask of their invalid values. None: no values are
        invalid.
    redo
        Whether the positions should be recorded again.
    put_in
        Function that adds the fault to patterns without it, to measure its cost (`PutIn`). None: the cost is not
        measured.
    extent
        Fraction of all positions that have the fault; None if it does not concern single frames.
    scatters
        Whether ``put_in`` also depends on part of the residuals, instead of only on the size of the fault.
    wider
        Factor by which the cutouts are enlarged so that ``put_in`` shows the cost.
    cost
        Error of a reconstruction with H due to the fault, in addition to noise (NRMSE); errors add in quadrature. None:
        not measured.

    Examples
    --------
    >>> from lfcal.judge import FAULTS, FoundFault
    >>> found = FoundFault(FAULTS.get("hot_line"), "column 40 has 60 counts more", sigmas=8.0, share=0.02)
    >>> print(f"{found.title}: {found.detail}; by chance in {1 - found.confidence:.0e}")
    hot line of the sensor: column 40 has 60 counts more; by chance in 1e-11
    """

    fault: Fault
    detail: str
    sigmas: float
    share: float
    positions: NDArray[np.intp] = field(default_factory=lambda: np.empty((0, 3), np.intp))
    pixels: NDArray[np.intp] = field(default_factory=lambda: np.empty((0, 2), np.intp))
    picture: FaultPicture | None = None
    repair: Repair | None = None
    blinds: bool = False
    masked: Callable[[F4], NDArray[np.bool_]] | None = None
    redo: bool = False
    put_in: PutIn | None = None
    extent: float | None = None
    scatters: bool = False
    wider: float = 1.0
    cost: float | None = None

    @property
    def name(self) -> str:
        """Name of the fault."""
        return self.fault.name

    @property
    def title(self) -> str:
        """Display name of the fault."""
        return self.fault.title

    @property
    def confidence(self) -> float:
        """Lower limit (0 to 1) of the probability that 10,000 tests of Gaussian noise find no such fault by chance."""
        return max(0.0, 1.0 - 1e4 * math.erfc(self.sigmas / math.sqrt(2)))


class Fault:
    """Base class for a kind of fault of a recording that is detected by comparison with a model of the camera.

    Attributes
    ----------
    name, title, advice
        Name used in JSON, display name, and remedy.
    subject
        Part of the recording that is faulty, one of `lfcal.base.SUBJECTS`.
    settles
        Keys of the model-free metrics that measure the same effect less reliably. If this fault is found, it is
        reported instead of them.
    explains
        Names of faults that are not searched for if this fault is found, because their effects are similar.
    needs_camera
        Whether detecting the fault requires a camera that explains the patterns.
    rank
        Sort key of the search. The effect of a fault that is found is removed from the patterns, or its pixels are
        ignored, before the next fault is searched for.
    strong_rank
        Earlier rank at which the fault is also searched for. It is reported if it explains most of the residual,
        because other faults would otherwise be reported instead. None: it is searched for only once.

    Examples
    --------
    >>> from lfcal.judge import FAULTS, Fault
    >>> fault: Fault = FAULTS.get("hot_line")
    >>> print(f"{fault.title}: {fault.advice.partition(',')[0]}")
    hot line of the sensor: Subtract a dark frame of the same exposure
    """

    name: ClassVar[str]
    title: ClassVar[str]
    subject: ClassVar[str] = "other"
    advice: ClassVar[str]
    settles: ClassVar[tuple[str, ...]] = ()
    explains: ClassVar[tuple[str, ...]] = ()
    needs_camera: ClassVar[bool] = True
    rank: ClassVar[int]
    strong_rank: ClassVar[int | None] = None

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield the faults of this kind that the patterns of ``evidence`` show."""
        raise NotImplementedError


FAULTS: Registry[Fault] = Registry(
    "fault", "lfcal.judge.faults", "FAULTS", "lfcal.faults", order=lambda one: (one.rank, one.name)
)
"""All faults that the inspection with a model can find."""
