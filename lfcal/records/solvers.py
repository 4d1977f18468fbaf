"""Settings of the solvers; each solver has only the fields that it uses.

`solver_kind` returns the record class for a solver of another package, from the options that the solver uses.

Examples
--------
>>> from lfcal.reconstruct import IsraSolver, OsemSolver, PhaseSpaceSolver, RlSolver, SieveSolver
>>> from lfcal.reconstruct import RlBiggsSolver, RlNesterovSolver, RlTikhonovSolver, RlTvSolver
>>> print(SieveSolver(iterations="auto").goal, RlTvSolver(strength=0.005).strength, OsemSolver(subsets=8).subsets)
view 0.005 8
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any

from lfcal.base import InputError
from lfcal.records.option import check_record, opt, record
from lfcal.records.reading import check_count, read_count

__all__ = [
    "OWN_SOLVERS",
    "SOLVER_ENDS",
    "IsraSolver",
    "OsemSolver",
    "PhaseSpaceSolver",
    "RlBiggsSolver",
    "RlNesterovSolver",
    "RlSolver",
    "RlTikhonovSolver",
    "RlTvSolver",
    "SieveSolver",
    "SolverFields",
    "solver_kind",
]

SOLVER_ENDS = {"auto": "left-out", "auto:discrepancy": "discrepancy"}
"""Values that are accepted instead of a number of iterations, with the stopping rule of each."""


def _named(name: str) -> str:
    words = (
        "Solver. The command lfcal solvers lists all solvers. With error bars, beads or lines, the default is "
        "rl-nesterov with 60 iterations."
    )
    return opt(name, words, label="Solver", flag="--solver")


@record
class SolverFields:
    """Settings that every solver has."""

    name: str = _named("")
    iterations: int | str = opt(
        15,
        "Number of iterations. auto: stop when the prediction of held-out pixels no longer improves. auto:discrepancy: "
        "stop when the volume agrees with the frame to within the noise expected from gain and read noise.",
        short="-n",
        read=partial(read_count, at_least=1, words=tuple(SOLVER_ENDS)),
        examples=tuple(SOLVER_ENDS),
    )
    goal: str = opt(
        "view",
        "Purpose of the volume, which determines when automatic iterations stop. view: images to look at. "
        "measure: sums over regions, which need more iterations.",
        choices=("view", "measure"),
        needs=("iterations", "auto"),
        more=True,
    )
    gain: float | None = opt(
        None,
        "Counts per photoelectron; used for chi² per pixel and for iterations auto:discrepancy.",
        unit="counts/e⁻",
        above=0,
        empty="from the noise model stored in H; 1 for auto:discrepancy",
        more=True,
    )

    def __post_init__(self) -> None:
        """Check every value."""
        check_record(self)
        check_count("iterations", self.iterations, 1, *SOLVER_ENDS)
        own = type(self).__dataclass_fields__["name"].default
        if self.name != own:
            raise InputError.expected("name", repr(own), repr(self.name), "use the record of that solver")


@record
class _Background:
    background: float = opt(
        0.0, "Expected value of a pixel that receives no light from the volume.", unit="counts", at_least=0
    )


@record
class _Saturation:
    saturation: float | None = opt(
        None,
        "Sample value at which pixels saturate; pixels at or above this value are left out.",
        unit="counts",
        above=0,
        empty="no pixel is left out",
    )


@record
class _Tolerance:
    tolerance: float = opt(
        0.0, "Stop when the relative change of the volume falls below this value.", at_least=0, more=True
    )


@record
class _ReadNoise:
    read_noise: float = opt(0.0, "Rms read noise of a pixel.", unit="counts", at_least=0)


@record
class _Strength:
    strength: float | None = opt(
        None,
        "Weight of the regularisation term.",
        at_least=0,
        empty="0.002 for rl-tv, 0.02 for rl-tikhonov",
    )


@record
class _Subsets:
    subsets: int | None = opt(
        None,
        "Number of subsets of pixels (osem), or blocks of views along each axis (phase-space, sieve).",
        at_least=1,
        empty="4 for osem, 3 for phase-space, 1 for sieve",
        more=True,
    )


FIELDS: dict[str, type] = {
    "background": _Background,
    "read_noise": _ReadNoise,
    "saturation": _Saturation,
    "strength": _Strength,
    "subsets": _Subsets,
    "tolerance": _Tolerance,
}
"""Records with a single field each, by the option of a solver."""


@record
class _Common(_Tolerance, _Saturation, _Background, SolverFields):
    """Fields of every built-in solver."""


@record
class _Em(_ReadNoise, _Common):
    """Fields of every variant of Richardson-Lucy."""


@record
class SieveSolver(_Subsets, _Em):
    """Settings of accelerated Richardson-Lucy with a sieve, which reduces lenslet artefacts and avoids rings."""

    name: str = _named("sieve")


@record
class RlSolver(_Em):
    """Settings of Richardson-Lucy without acceleration or regularisation."""

    name: str = _named("rl")


@record
class RlTvSolver(_Strength, _Em):
    """Settings of Richardson-Lucy with total variation, which reduces noise and preserves edges."""

    name: str = _named("rl-tv")


@record
class RlTikhonovSolver(_Strength, _Em):
    """Settings of Richardson-Lucy with Tikhonov-Miller regularisation, which reduces noise and softens edges."""

    name: str = _named("rl-tikhonov")


@record
class RlBiggsSolver(_Em):
    """Settings of Richardson-Lucy with Biggs acceleration, which extrapolates from the last two updates."""

    name: str = _named("rl-biggs")


@record
class RlNesterovSolver(_Em):
    """Settings of Richardson-Lucy with Nesterov acceleration, whose step depends on the iteration number."""

    name: str = _named("rl-nesterov")


@record
class OsemSolver(_Subsets, _Em):
    """Settings of the solver with ordered subsets of pixels, which needs fewer iterations."""

    name: str = _named("osem")


@record
class PhaseSpaceSolver(_Subsets, _Em):
    """Settings of the solver that updates the volume with one block of views after another, the brightest first."""

    name: str = _named("phase-space")


@record
class IsraSolver(_Common):
    """Settings of the solver for non-negative least squares (ISRA)."""

    name: str = _named("isra")


OWN_SOLVERS: tuple[type[SolverFields], ...] = (
    SieveSolver,
    RlSolver,
    RlTvSolver,
    RlTikhonovSolver,
    RlBiggsSolver,
    RlNesterovSolver,
    OsemSolver,
    PhaseSpaceSolver,
    IsraSolver,
)
"""Records of lfcal's solvers, the default first."""


@cache
def solver_kind(name: str, options: frozenset[str]) -> type[SolverFields]:
    """Return the record class for the solver ``name``, which uses ``options``.

    It has the fields of `SolverFields`, and a field for each option that is in `FIELDS`.
    """
    bases = tuple(one for option, one in reversed(FIELDS.items()) if option in options)
    own: dict[str, Any] = {"__annotations__": {"name": "str"}, "name": _named(name), "__module__": __name__}
    own["__doc__"] = f"Settings of solver {name}."
    return record(type(f"{name}Solver", (*bases, SolverFields), own))
