"""Solvers by name: those of lfcal and of other distributions, with the settings that users choose."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import ArrayLike

from lfcal.progress import drain
from lfcal.reconstruct.projectors.projector import Projector
from lfcal.reconstruct.solvers.records import Reconstruction, SolverState, SolverWork
from lfcal.reconstruct.solvers.solver import Solver, SolverRun
from lfcal.registry import Registry

__all__ = ["SOLVERS", "SolverChoice", "find_solvers", "iter_reconstruct", "reconstruct"]

GROUP = "lfcal.solvers"
"""Entry point group of solvers of other distributions."""

CHOSEN = ("background", "read_noise", "saturation", "strength", "subsets", "tolerance")
"""Options that a `SolverChoice` holds; the others are arrays and states."""


def check_solver(solver: Solver) -> None:
    """Raise `TypeError` unless ``solver`` is one."""
    if not isinstance(solver, Solver) or not callable(solver.iterate):
        raise TypeError("it is not a Solver with a function")


def find_solvers() -> Registry[Solver]:
    """Return every solver by name, those of other distributions last."""
    return Registry(
        "solver",
        "lfcal.reconstruct.solvers",
        "SOLVER",
        GROUP,
        order=lambda solver: (solver.rank, solver.name),
        check=check_solver,
    )


SOLVERS = find_solvers()
"""Every solver."""


@dataclass(frozen=True, slots=True)
class SolverChoice:
    """A solver and its settings.

    Attributes
    ----------
    name
        One of `SOLVERS`.
    iterations
        How many.
    background
        Expected value of a pixel without any source (counts).
    read_noise
        Rms read noise (counts); Richardson-Lucy variants alone.
    saturation
        Pixels at or above are left out; None: none.
    strength
        Weight of the penalty of ``rl-tv`` and ``rl-tikhonov``, damping of ``cg``; None: the default of each.
    subsets
        Number of subsets for ``osem``, blocks of views along each axis for ``phase-space``; None: 4 and 3.
    tolerance
        Stop when the relative change falls below.

    Raises
    ------
    InputError
        If the solver is unknown, or would ignore a setting that is given.
    """

    name: str = "rl"
    iterations: int = 20
    background: float = 0.0
    read_noise: float = 0.0
    saturation: float | None = None
    strength: float | None = None
    subsets: int | None = None
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        """Check name and settings; the solvers check the values."""
        for option in CHOSEN:
            check_option(self.solver, option, getattr(self, option))

    @property
    def solver(self) -> Solver:
        """The solver itself."""
        return SOLVERS.get(self.name)


def check_option(solver: Solver, option: str, given: object) -> None:
    """Raise `InputError` where ``given`` would be ignored, naming the solvers that use it."""
    solver.check(option, given, tuple(other.name for other in SOLVERS if option in other.honours))


def iter_reconstruct(
    P: Projector,
    image: ArrayLike,
    choice: SolverChoice | None = None,
    *,
    weights: ArrayLike | None = None,
    initial: ArrayLike | None = None,
    resume: SolverState | None = None,
) -> SolverWork:
    """Reconstruct ``image`` as `reconstruct`, one `SolverProgress` per iteration."""
    c = SolverChoice() if choice is None else choice
    for option, given in (("weights", weights), ("initial", initial), ("resume", resume)):
        check_option(c.solver, option, given)
    run = SolverRun(
        c.iterations,
        weights=weights,
        initial=initial,
        resume=resume,
        background=c.background,
        read_noise=c.read_noise,
        saturation=c.saturation,
        strength=c.strength,
        subsets=c.subsets,
        tolerance=c.tolerance,
    )
    return c.solver.iterate(P, image, run)


def reconstruct(
    P: Projector,
    image: ArrayLike,
    choice: SolverChoice | None = None,
    *,
    weights: ArrayLike | None = None,
    initial: ArrayLike | None = None,
    resume: SolverState | None = None,
) -> Reconstruction:
    """Reconstruct ``image`` by the solver of ``choice``.

    Parameters
    ----------
    P
        Projector pair.
    image
        ``(Y, X)`` in counts.
    choice
        Solver and settings; None: Richardson-Lucy.
    weights
        Weight of each pixel ``(Y, X)``, not negative.
    initial
        Start ``(nz, Y, X)``.
    resume
        State to go on from.

    Raises
    ------
    InputError
        If the image does not fit the projector, or the solver would ignore an argument.
    """
    return drain(iter_reconstruct(P, image, choice, weights=weights, initial=initial, resume=resume))
