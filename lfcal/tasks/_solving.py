"""Solvers as tasks are given them: which fields each has, and what the library is asked for."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError
from lfcal.records import OWN_SOLVERS, SOLVER_ENDS, SolverFields, Variants, solver_kind

if TYPE_CHECKING:
    from lfcal.reconstruct import SolverChoice

__all__ = ["SOLVER_KINDS", "choice_of", "solver_settings"]


def _find(name: str) -> type[SolverFields]:
    """Return the record of a solver, of those of other distributions, too."""
    own = {SOLVER_KINDS.name_of(kind): kind for kind in OWN_SOLVERS}
    if name in own:
        return own[name]
    if name == "list":
        raise InputError.expected("--solver", "the name of a solver", "list", "lfcal solvers lists them")
    from lfcal.reconstruct import SOLVERS

    return solver_kind(name, SOLVERS.get(name).honours)


def _names() -> tuple[str, ...]:
    from lfcal.reconstruct import SOLVERS

    return SOLVERS.names()


SOLVER_KINDS = Variants(OWN_SOLVERS, "name", _find, _names)
"""The records of solvers."""


def solver_settings(name: str, **values: Any) -> SolverFields:
    """Return settings of a solver by its name, which may be one of another distribution.

    Parameters
    ----------
    name
        Of the solver.
    **values
        Fields of its record.

    Raises
    ------
    InputError
        If there is no such solver, or it does not use one of the values.

    Examples
    --------
    >>> from lfcal.tasks import solver_settings
    >>> print(solver_settings("rl-tv", strength=0.005).strength)
    0.005
    """
    kind = _find(name)
    known = [one.name for one in fields(kind) if one.name != "name"]
    for given in values:
        if given not in known:
            raise InputError.expected(f"solver {name}", f"settings {', '.join(known)}", given, "leave it out")
    return kind(**values)


def choice_of(settings: SolverFields, **found: Any) -> SolverChoice:
    """Return what the library is asked for; ``found`` are margin and noise of the frames."""
    from lfcal.reconstruct import SolverChoice
    from lfcal.reconstruct.solvers import MOST_ITERATIONS

    known = {one.name: getattr(settings, one.name) for one in fields(settings)}
    end = SOLVER_ENDS.get(str(settings.iterations))
    if end is not None:
        known |= {"iterations": MOST_ITERATIONS, "auto": True, "stop": end}
    return SolverChoice(**known, **found)
