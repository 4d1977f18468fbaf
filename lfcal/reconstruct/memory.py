"""Predict the memory of a reconstruction, including the arrays of its solver."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.base import InputError, format_bytes, free_memory, memory_in_use
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.solvers import SOLVERS, UPDATING, SolverChoice, plane_threads

__all__ = ["RunMemory", "room_for_projections", "run_memory"]

FREE_SHARE = 0.8
"""Default fraction of the free memory that a reconstruction uses."""

PROJECTING, FITTING = 2, 9
"""Number of images in memory besides the volume's arrays, for its projection and the comparison with the frame."""


@dataclass(frozen=True, slots=True)
class RunMemory:
    """Peak memory of a reconstruction (bytes), by use.

    Attributes
    ----------
    matrix
        Prepared planes of H that are stored for all projections.
    solver
        Volumes and images of the solver.
    projection
        Working memory of a projection.
    program
        Memory that this process already uses before the run.
    """

    matrix: int
    solver: int
    projection: int
    program: int

    @property
    def total(self) -> int:
        """Sum of all uses (bytes)."""
        return self.matrix + self.solver + self.projection + self.program

    def __str__(self) -> str:
        """Return the memory as a one-line text."""
        parts = {"H": self.matrix, "solver": self.solver, "projection": self.projection, "program": self.program}
        return f"{format_bytes(self.total)}: " + ", ".join(f"{name} {format_bytes(b)}" for name, b in parts.items())


def run_memory(P: Projector, choice: SolverChoice, *, warm: bool = False) -> RunMemory:
    """Return the predicted peak memory of a reconstruction with a projector and a solver.

    With ``warm``, the volume of one frame is stored as the start for the next.
    """
    cost = P.forecast().chosen
    projecting, between = _solver_bytes(P.volume_shape, choice, P.dtype.itemsize, warm)
    matrix, scratch = cost.operand_bytes, cost.scratch_bytes
    if not cost.resident:  # planes are prepared during projections
        matrix, scratch = 0, cost.memory_bytes
    if between >= projecting + scratch:
        return RunMemory(matrix, between, 0, memory_in_use())
    return RunMemory(matrix, projecting, scratch, memory_in_use())


def room_for_projections(
    shape: tuple[int, int, int],
    choice: SolverChoice,
    itemsize: int,
    *,
    memory: int | None = None,
    warm: bool = False,
    share: int = 1,
) -> int:
    """Return the memory (bytes) that the arrays of a solver leave for projections in each process.

    Use it as the ``memory_limit`` of a projector.

    Parameters
    ----------
    shape
        Shape of the volume, (nz, Y, X).
    choice
        Solver and its settings.
    itemsize
        Bytes per number: 4 in single precision, 8 in double precision.
    memory
        Memory that all processes may use together (bytes). None: most of the free memory.
    warm
        Whether the volume of one frame is stored as the start for the next.
    share
        Number of processes that share the memory, each with a separate H.

    Raises
    ------
    InputError
        If no memory is left.
    """
    most = (int(FREE_SHARE * free_memory()) if memory is None else memory) // share
    needed = max(_solver_bytes(shape, choice, itemsize, warm))
    if needed < most:
        return most - needed
    remedies = ["reconstruct a smaller image or fewer planes"]
    if share > 1:
        remedies.append(f"use fewer than {share} threads (--workers)")
    leanest = min(SOLVERS, key=lambda solver: (max(_held(SolverChoice(solver.name), warm)), solver.rank))
    if (least := max(_held(SolverChoice(leanest.name), warm))) < (own := max(_held(choice, warm))):
        remedies.append(f"choose {leanest.name}, which needs {least} volumes in memory instead of {own}")
    raise InputError.expected(
        "memory for the reconstruction",
        f"more than {format_bytes(needed)}, which the arrays of {choice.name} alone need",
        format_bytes(most),
        "; or ".join(remedies),
    )


def _solver_bytes(shape: tuple[int, int, int], choice: SolverChoice, itemsize: int, warm: bool) -> tuple[int, int]:
    """Return the peak memory of a solver's arrays during a projection, and between projections (bytes)."""
    nz, rows, columns = shape
    held, most = _held(choice, warm)
    # no projection result is in memory while model and frame are compared
    updating = UPDATING * plane_threads(nz, rows * columns * itemsize)
    images = held * nz + PROJECTING, max(most * nz + updating, (held - 1) * nz + FITTING)
    return images[0] * rows * columns * itemsize, images[1] * rows * columns * itemsize


def _held(choice: SolverChoice, warm: bool) -> tuple[int, int]:
    """Return the number of arrays of the volume's size during a projection, and the peak between projections."""
    # a run that stops automatically keeps its best volume and that of the previous iteration
    more = choice.solver.parts(choice.subsets) - 1 + int(warm) + 2 * int(choice.auto)
    held, most = choice.solver.volumes
    return held + more, most + more
