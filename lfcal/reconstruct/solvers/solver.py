"""Definition of a solver: name, supported options, and the function that iterates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from inspect import signature
from typing import Any, Concatenate, ParamSpec, TypeVar

from numpy.typing import ArrayLike

from lfcal.base import InputError, any_of, in_place_of
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers.measurement import Measurement
from lfcal.reconstruct.solvers.records import SolverState, SolverWork

__all__ = ["COMMON", "EM", "OPTIONS", "Solver", "SolverRun", "SolverSettings", "with_settings"]

Q = ParamSpec("Q")
S = TypeVar("S")

Solving = Callable[[Projector, ArrayLike, S], SolverWork]
SolverFunction = Callable[Concatenate[Projector, ArrayLike, Q], SolverWork]

OPTIONS: dict[str, Any] = {
    "background": 0.0,
    "read_noise": 0.0,
    "saturation": None,
    "strength": None,
    "subsets": None,
    "tolerance": 0.0,
    "weights": None,
    "initial": None,
    "resume": None,
    "held_out": None,
}
"""Options that a solver may use, with their default values."""

COMMON = frozenset({"background", "saturation", "tolerance", "weights", "resume"})
"""Options that every solver of lfcal uses."""

EM = COMMON | {"read_noise", "initial", "held_out"}
"""Options of every variant of Richardson-Lucy."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SolverSettings:
    """Settings common to all solvers: treatment of the image, and start and end of a run.

    Attributes
    ----------
    background
        Expected value of a pixel without light (counts), a number or ``(Y, X)``.
    weights
        Weight of each pixel ``(Y, X)``, not negative. None: 1.
    saturation
        Pixels at or above this value are excluded (counts). None: no pixels are excluded.
    tolerance
        Stop when the relative change of the volume falls below this value.
    resume
        State of a stopped run to continue from. None: start a new run.
    """

    background: ArrayLike = 0.0
    weights: ArrayLike | None = None
    saturation: float | None = None
    tolerance: float = 0.0
    resume: SolverState | None = None

    def measurement(
        self,
        P: Projector,
        image: ArrayLike,
        *,
        read_noise: float = 0.0,
        held_out: ArrayLike | None = None,
        signed: bool = False,
    ) -> Measurement:
        """Return ``image`` ``(Y, X)`` with its weights and background, in the floating-point type of ``P``.

        The other arguments are as in `Measurement.of`.
        """
        return Measurement.of(
            image,
            dtype=P.dtype,
            weights=self.weights,
            saturation=self.saturation,
            background=self.background,
            read_noise=read_noise,
            held_out=held_out,
            signed=signed,
        )


def with_settings(settings: Callable[Q, S]) -> Callable[[Solving[S]], SolverFunction[Q]]:
    """Return a decorator for a solver whose third argument is an instance of the class ``settings``.

    The decorated solver accepts the fields of this class as arguments instead.
    """

    def taken(solver: Solving[S]) -> SolverFunction[Q]:
        def iterate(P: Projector, image: ArrayLike, *args: Q.args, **kwargs: Q.kwargs) -> SolverWork:
            return solver(P, image, settings(*args, **kwargs))

        own = signature(solver)
        first = list(own.parameters.values())[:2]
        whole = own.replace(parameters=[*first, *signature(settings).parameters.values()])
        made: SolverFunction[Q] = in_place_of(solver, iterate, whole)
        return made

    return taken


@dataclass(frozen=True, eq=False)
class SolverRun(SolverSettings):
    """Input of one run of a solver in addition to the image; options that are not set have the values of `OPTIONS`.

    Attributes
    ----------
    iterations
        Number of iterations, in addition to those of ``resume``.
    read_noise, strength, subsets
        As in `SolverChoice`.
    initial
        Initial volume ``(nz, Y, X)``. None: the solver's default.
    held_out
        Mask ``(Y, X)``, True at held-out pixels; `SolverProgress.held_out` measures their prediction. None: no held-out
        pixels.
    measured
        Result of `measure`, if it is already computed. None: compute it.
    noise
        Counts per photoelectron, and rms read noise (counts), of the image. None: unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Projector, SolverRun
    >>> P = Projector(np.full((1, 1, 1, 3, 3), 1 / 9), (4, 4))
    >>> frame = np.full((4, 4), 20.0)
    >>> frame[0, 0] = 4095
    >>> print(SolverRun(10, saturation=4095).measure(P, frame).notes[0])
    1 saturated pixel was left out
    """

    iterations: int
    _: KW_ONLY
    read_noise: float = 0.0
    strength: float | None = None
    subsets: int | None = None
    initial: ArrayLike | None = None
    held_out: ArrayLike | None = None
    measured: Measurement | None = field(default=None, repr=False, compare=False)
    noise: tuple[float, float] | None = None

    def measure(self, P: Projector, image: ArrayLike, *, signed: bool = False) -> Measurement:
        """Return ``image`` ``(Y, X)`` as a `Measurement` for the projector ``P``, with the settings of this run.

        With ``signed``, negative values are kept. Without it, `measured` is returned if it is set.
        """
        if self.measured is not None and not signed:
            return self.measured
        return self.measurement(P, image, read_noise=self.read_noise, held_out=self.held_out, signed=signed)


def _one(subsets: int | None) -> int:
    return 1


@dataclass(frozen=True, slots=True)
class Solver:
    """Description of a reconstruction method.

    Attributes
    ----------
    name
        Name used in commands and files. It must not change, because files contain it.
    title
        Short description, if possible with a reference to the literature.
    iterate
        Function that takes a projector, an image ``(Y, X)`` and a `SolverRun`, yields a `SolverProgress` for each
        iteration, and returns a `Reconstruction`.
    honours
        Names in `OPTIONS` that the solver uses. Values of the other options that are not the default raise an error.
    rank
        Sort key in lists; smaller numbers come first.
    volumes
        Largest numbers of arrays of the volume's size in memory: during a projection, including its result, and between
        projections.
    parts
        Function that takes ``subsets`` (None: the default), and returns the number of parts into which an image is
        divided. Each part after the first requires one more array of the volume's size.
    settles
        Whether the solver suppresses noise for any number of iterations, for example by a penalty. A run that stops
        automatically then ends only after its best estimate.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.base import drain
    >>> from lfcal.reconstruct import Projector, Solver, SolverRun, iter_richardson_lucy
    >>> def iterate(P, image, run):
    ...     return iter_richardson_lucy(P, image, run.iterations, acceleration="nesterov", background=run.background)
    >>> solver = Solver("rl-own", "Richardson-Lucy with our settings", iterate, honours=frozenset({"background"}))
    >>> P = Projector(np.full((1, 1, 1, 3, 3), 1 / 9), (16, 16))
    >>> result = drain(solver.iterate(P, np.full((16, 16), 12.0), SolverRun(5, background=2.0)))
    >>> print(f"{solver.name}: {result.volume[0, 8, 8]:.1f} counts above the background")
    rl-own: 10.0 counts above the background
    """

    name: str
    title: str
    iterate: Callable[[Projector, ArrayLike, SolverRun], SolverWork]
    honours: frozenset[str] = COMMON
    rank: int = 100
    volumes: tuple[int, int] = (6, 6)
    parts: Callable[[int | None], int] = _one
    settles: bool = False

    @property
    def in_parts(self) -> bool:
        """Whether the solver divides an image into parts by default; H is then prepared for each part."""
        return self.parts(None) > 1

    def __post_init__(self) -> None:
        """Check the options' names."""
        unknown = sorted(set(self.honours) - set(OPTIONS))
        if unknown:
            raise InputError.expected(
                f"options of solver {self.name}", ", ".join(OPTIONS), unknown[0], "choose one of these"
            )

    def check(self, option: str, given: Any, others: tuple[str, ...] = ()) -> None:
        """Raise `InputError` if the solver does not use ``option``, unless ``given`` is the default of the option.

        The message suggests ``others``, names of solvers that use the option.
        """
        idle = OPTIONS[option]
        if option in self.honours or given is idle or (idle is not None and given == idle):
            return
        got = f"{given}" if isinstance(given, int | float) else "one"
        wanted = f"none for solver {self.name}, which does not use it"
        remedy = f"leave it out, or choose {any_of(others)}" if others else "omit it"
        raise InputError.expected(option.replace("_", " "), wanted, got, remedy)
