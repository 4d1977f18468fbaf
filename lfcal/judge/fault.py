"""What a fault is, how it is found, and what it does to patterns."""

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
    """Return what adds light ``(n, nt, ns)`` to the patterns of the positions ``own`` that were compared."""
    missing = np.asarray(light, np.float32)
    return lambda index, patterns: patterns + missing if np.array_equal(index, own) else patterns


@dataclass(frozen=True, eq=False)
class FaultPicture:
    """What shows a fault: a curve ``(n,)`` over ``across``, or a map ``(rows, columns)``.

    Attributes
    ----------
    values, unit
        What is drawn, and its unit.
    title
        What it is, in words.
    axes
        What the axes are: of a map the rows and the columns, of a curve its abscissa.
    across
        Abscissa of a curve; None: numbers from 0.
    origin
        Of a map, the numbers of its first row and column.

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
    """A fault that was found.

    Attributes
    ----------
    fault
        Which one.
    detail
        What was found, with numbers and units.
    sigmas
        By how many standard deviations it stands out of what the rest of H does.
    share
        Share of the patterns' light that it changes (relative L1): what it may cost at all.
    positions
        Positions (z, y, x) concerned ``(n, 3)``; empty: all of them.
    pixels
        Pixels of the sensor (row, column) concerned ``(n, 2)``, counted from H's first cutout.
    picture
        What shows it.
    repair
        Takes it out of patterns; None: only a new recording does.
    blinds
        Whether ``pixels`` carry no measurement.
    masked
        Tells which values of patterns carry no measurement.
    redo
        Whether the positions should be recorded again.
    put_in
        Puts it into patterns that have none, for what it costs.
    extent
        Share of all positions that have it, where ``positions`` are single frames; None: it is no fault of such.
    scatters
        Whether ``put_in`` follows the size alone, or a part of what patterns showed.
    wider
        Times as large cutouts on which ``put_in`` shows what it costs.
    cost
        Error of a reconstruction with this H that it makes beyond noise (NRMSE); errors add in squares. None: not
        measured.

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
        """The fault in words."""
        return self.fault.title

    @property
    def confidence(self) -> float:
        """Share of such findings that are none of chance, 0 to 1, by Gauss's law and the many places looked at."""
        return max(0.0, 1.0 - 1e4 * math.erfc(self.sigmas / math.sqrt(2)))


class Fault:
    """A way in which a recording goes wrong, and how it is found beside the camera's model.

    Attributes
    ----------
    name, title, advice
        Name in JSON; for people; what to do about it.
    subject
        What it concerns, one of `lfcal.base.SUBJECTS`.
    settles
        Keys of model-free metrics that measure the same less surely: what this finds stands for them.
    explains
        Names of faults that are not looked for where this one is found: its traces look like theirs.
    needs_camera
        Whether it is told by the difference from a camera that explains the patterns.
    rank
        Order in which faults are looked for: what is found is taken out before the next.
    strong_rank
        Where in that order it is looked for besides, to count if it explains most of what the camera does not: others
        would be named for it. None: nowhere.

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
        """Yield what is found of it."""
        raise NotImplementedError


FAULTS: Registry[Fault] = Registry(
    "fault", "lfcal.judge.faults", "FAULTS", "lfcal.faults", order=lambda one: (one.rank, one.name)
)
"""Every fault that inspection by model knows."""
