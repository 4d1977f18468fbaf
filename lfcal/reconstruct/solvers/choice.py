"""Choose a solver by name, from lfcal or another package, with its settings."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import MAX_SAMPLE, InputError, Registry, any_of, check_choice, check_number, drained
from lfcal.reconstruct.margin import cropped, widened, widened_start
from lfcal.reconstruct.projectors import Projector
from lfcal.reconstruct.resample import drift_note
from lfcal.reconstruct.solvers.measurement import check_counts, held_out_fit
from lfcal.reconstruct.solvers.records import Reconstruction, SolverProgress, SolverState, SolverWork
from lfcal.reconstruct.solvers.solver import Solver, SolverRun
from lfcal.reconstruct.solvers.stopping import (
    GOALS,
    MOST_ITERATIONS,
    STOPS,
    held_out_pixels,
    iter_until_best,
    iter_until_noise,
    misfit,
)
from lfcal.records import SOLVER_ENDS, SolverFields

__all__ = ["SOLVERS", "SolverChoice", "find_solvers", "iter_reconstruct", "iter_solve", "reconstruct"]

GROUP = "lfcal.solvers"
"""Entry point group of solvers of other packages."""

CHOSEN = ("background", "read_noise", "saturation", "strength", "subsets", "tolerance")
"""Options contained in a `SolverChoice`; the others are arrays and states."""


def check_solver(solver: Solver) -> None:
    """Raise `TypeError` unless ``solver`` is a `Solver` whose ``iterate`` is a function."""
    if not isinstance(solver, Solver) or not callable(solver.iterate):
        raise TypeError(f"expected a Solver with a function, got {type(solver).__name__}")


def find_solvers() -> Registry[Solver]:
    """Return the registry of all solvers, including those of other packages."""
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
    """Choice of a solver, and its settings.

    Attributes
    ----------
    name
        Name of a solver in `SOLVERS`.
    iterations
        Number of iterations; with ``auto``, the largest number.
    background
        Expected value of a pixel without light (counts).
    read_noise
        Rms read noise of a pixel (counts); only for Richardson-Lucy variants.
    saturation
        Sample value at which pixels saturate; pixels at or above it are excluded (counts). None: no pixels are
        excluded.
    strength
        Weight of the penalty of ``rl-tv`` and ``rl-tikhonov``. None: the solver's default.
    subsets
        Number of subsets for ``osem`` (None: 4), or number of blocks of views along each axis for ``phase-space``
        (None: 3) and ``sieve`` (None: 1).
    tolerance
        Relative change of the volume in an iteration below which the run stops.
    auto
        Whether to stop automatically, according to ``stop``.
    stop
        Rule for stopping. ``"left-out"``: stop when the prediction of held-out pixels (one in 25) no longer improves
        by more than its noise. ``"discrepancy"``: stop when the image of the volume agrees with the frame to within the
        noise.
    goal
        Purpose of a run that stops by held-out pixels. ``"view"``: the result is the volume with the best prediction.
        ``"measure"``: for sums and means over regions of the volume. These need more iterations, after which single
        voxels are noisier.
    gain
        Counts per photoelectron. None: unknown (``"discrepancy"`` then assumes 1). If the gain is known, the result
        states chi-square per pixel.
    noise
        ``(constant, slope)``: measured variance of a pixel without light (counts²), and its increase per count of light
        (counts). Used for chi-square if ``gain`` is None. None: unknown.
    margin
        Width by which the volume extends beyond each edge of the frame (px). The shape of the projector must include
        this margin.
    denoise
        Whether to reduce the noise of a recorded H (`Projector.denoised`). It has no effect if the noise is not stored
        with H.

    Raises
    ------
    InputError
        If the solver is unknown or does not use a given setting, or if a setting is invalid.

    Examples
    --------
    >>> from lfcal.reconstruct import SolverChoice
    >>> choice = SolverChoice("rl-tv", iterations=30, strength=0.005)
    >>> print(choice.solver.title)
    Richardson-Lucy with total variation: less noise, sharp edges
    >>> print(SolverChoice(auto=True).name)
    sieve
    """

    name: str = "sieve"
    iterations: int = 15
    background: float = 0.0
    read_noise: float = 0.0
    saturation: float | None = None
    strength: float | None = None
    subsets: int | None = None
    tolerance: float = 0.0
    auto: bool = False
    margin: int = 0
    stop: str = "left-out"
    gain: float | None = None
    noise: tuple[float, float] | None = None
    goal: str = "view"
    denoise: bool = True

    def __post_init__(self) -> None:
        """Check name and settings, before anything is prepared for them."""
        for option in CHOSEN:
            check_option(self.solver, option, getattr(self, option))
        if self.margin < 0:
            raise InputError.expected("margin (pixels)", "0 or more", self.margin, "set it to 0 for no margin")
        check_choice("stop", self.stop, STOPS)
        check_choice("goal", self.goal, GOALS)
        if self.goal != GOALS[0] and not (self.auto and self.stop == "left-out"):
            wanted = f"{GOALS[0]} for a run that does not stop by held-out pixels"
            raise InputError.expected("goal", wanted, self.goal, "choose automatic stopping, or leave the goal out")
        check_counts(self.read_noise, self.saturation)
        check_number("background (counts)", self.background, at_least=0, at_most=MAX_SAMPLE)
        check_number("tolerance", self.tolerance, at_least=0)
        if self.strength is not None:
            check_number("strength", self.strength, at_least=0, at_most=MAX_SAMPLE)
        if self.subsets is not None:
            check_number("subsets", self.subsets, at_least=1, integer=True)
        if self.gain is not None:
            check_number("gain (counts per photoelectron)", self.gain, above=0, at_most=MAX_SAMPLE)
        if self.noise is not None:
            check_number("noise without light (counts²)", self.noise[0], at_least=0, at_most=MAX_SAMPLE)
            check_number("noise per count (counts)", self.noise[1], above=0, at_most=MAX_SAMPLE)
        if "weights" not in self.solver.honours:
            self._check_without_weights()

    def _check_without_weights(self) -> None:
        """Raise `InputError` if a setting needs pixels of weight 0, which the solver does not support."""
        known = any_of(other.name for other in SOLVERS if "weights" in other.honours)
        if self.auto and self.stop == "left-out":
            raise InputError.expected(
                f"iterations of solver {self.name}",
                "a number, because this solver cannot hold out the pixels that auto needs",
                "auto",
                f"give a number, stop by the discrepancy, or choose {known}",
            )
        if self.margin:
            raise InputError.expected(
                f"margin of solver {self.name}",
                "0, because this solver cannot ignore pixels outside the frame",
                self.margin,
                f"set it to 0, or choose {known}",
            )

    @classmethod
    def of(cls, settings: SolverFields, margin: int = 0) -> SolverChoice:
        """Return the choice described by ``settings``, such as a `SieveSolver`, with a ``margin`` (px).

        Automatic iterations are limited to `MOST_ITERATIONS`.
        """
        known = {one.name: getattr(settings, one.name) for one in fields(settings)}
        end = SOLVER_ENDS.get(str(settings.iterations))
        if end is not None:
            known |= {"iterations": MOST_ITERATIONS, "auto": True, "stop": end}
        return cls(**known, margin=margin)

    @property
    def solver(self) -> Solver:
        """The chosen solver."""
        return SOLVERS.get(self.name)

    @property
    def known_noise(self) -> tuple[float, float] | None:
        """Counts per photoelectron, and rms read noise (counts), for chi-square. None: unknown.

        They are `gain` and `read_noise`; if `gain` is None, they are computed from `noise`.
        """
        if self.gain is not None:
            return self.gain, self.read_noise
        return None if self.noise is None else (self.noise[1], math.sqrt(self.noise[0]))


def check_option(solver: Solver, option: str, given: object) -> None:
    """Raise `InputError` if ``solver`` does not use ``option``, unless ``given`` is the default of the option.

    The message lists the solvers that use the option.
    """
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
    """Reconstruct a volume from ``image`` with the solver of ``choice``, and return a `Reconstruction`.

    Parameters
    ----------
    P
        Projector of H for the shape of the image, extended by the margin of ``choice`` on each side.
    image
        Image ``(Y, X)`` in counts.
    choice
        Solver and its settings. None: the defaults of `SolverChoice`.
    weights
        Weight of each pixel, ``(Y, X)``, not negative. None: 1.
    initial
        Initial volume ``(nz, Y, X)``, with or without the margin. None: the solver's default.
    resume
        State of a stopped run to continue from. None: start a new run.

    Yields
    ------
    SolverProgress
        After each iteration.

    Raises
    ------
    InputError
        If the image does not fit the projector, or the solver would ignore an argument.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import Projector, SolverChoice, iter_reconstruct
    >>> P = Projector(np.array([1, 2, 1]).reshape(1, 1, 1, 1, 3) / 4, (1, 7))
    >>> for record in iter_reconstruct(P, [[0, 0, 2, 4, 2, 0, 0]], SolverChoice("rl", iterations=3)):
    ...     print(record.stage, record.count, f"residual {record.residual:.2f}")
    richardson-lucy 1 of 3 residual 0.75
    richardson-lucy 2 of 3 residual 0.38
    richardson-lucy 3 of 3 residual 0.27
    """
    work = iter_solve(P, image, choice, weights=weights, initial=initial, resume=resume)
    rows, columns = np.shape(image)
    note = drift_note(P.camera, P.period, (rows, columns))
    return _iter_noted(work, note) if note else work


reconstruct = drained(
    iter_reconstruct,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import open_psf
    >>> from lfcal.reconstruct import Projector, SolverChoice, reconstruct
    >>> with open_psf("H.h5") as H:
    ...     P = Projector(H, (48, 48), method="direct")
    ...     bead = np.zeros(P.volume_shape)
    ...     bead[1, 20, 25] = 1.0
    ...     result = reconstruct(P, P.forward(bead), SolverChoice("rl-biggs", iterations=8))
    >>> plane, row, column = np.unravel_index(result.volume.argmax(), result.volume.shape)
    >>> print(f"{len(result.history)} iterations, brightest voxel in plane {plane} at {row}, {column}")
    8 iterations, brightest voxel in plane 1 at 20, 25
    """,
)


def iter_solve(
    P: Projector,
    image: ArrayLike,
    choice: SolverChoice | None = None,
    *,
    weights: ArrayLike | None = None,
    initial: ArrayLike | None = None,
    resume: SolverState | None = None,
    background: ArrayLike | None = None,
) -> SolverWork:
    """Reconstruct ``image`` like `iter_reconstruct`, but without a note if it should be resampled to H's period.

    ``background`` is the expected image ``(Y, X)`` without light of the volume (counts). None: that of ``choice``.
    """
    c = SolverChoice() if choice is None else choice
    for option, given in (("weights", weights), ("initial", initial), ("resume", resume)):
        check_option(c.solver, option, given)
    run = SolverRun(
        c.iterations,
        weights=weights,
        initial=initial if initial is None or c.margin == 0 else widened_start(initial, c.margin, P.volume_shape),
        resume=resume,
        background=c.background if background is None else background,
        read_noise=c.read_noise,
        saturation=c.saturation,
        strength=c.strength,
        subsets=c.subsets,
        tolerance=c.tolerance,
        noise=c.known_noise,
    )
    noisy = c.denoise and P.noise is not None
    P = P.denoised() if noisy else P
    if c.margin:
        trust = np.ones(np.shape(image), P.dtype) if weights is None else weights
        run = replace(run, weights=widened(np.broadcast_to(trust, np.shape(image)), c.margin))
        image = widened(image, c.margin)
    if not c.auto:
        work = c.solver.iterate(P, image, run)
    elif c.stop == "discrepancy":
        work = _iter_to_noise(P, image, run, c)
    else:
        work = _iter_auto(P, image, run, c.solver, c.goal)
    if c.known_noise is not None:
        work = _iter_judged(work, P, image, run, c.known_noise)
    if noisy:
        work = _iter_noted(work, "the patterns of H are denoised with the noise stated in H")
    return _iter_cropped(work, c.margin) if c.margin else work


def _iter_auto(P: Projector, image: ArrayLike, run: SolverRun, solver: Solver, goal: str) -> SolverWork:
    """Return a run that stops according to the prediction of held-out pixels."""
    held_out = replace(run, held_out=held_out_pixels(P.image_shape))
    if "held_out" in solver.honours:
        found = held_out.measure(P, image)
        work = solver.iterate(P, image, replace(held_out, measured=found))
        return iter_until_best(work, found.notes, settles=solver.settles, goal=goal)
    # a solver that cannot use held-out pixels is assessed by its projected volumes
    data = held_out.measure(P, image, signed=True)
    held = np.zeros(P.image_shape) if data.held is None else data.held

    def score(state: SolverState) -> tuple[float, float]:
        return held_out_fit(
            np.square(P.forward(state.volume) + data.background - data.image, dtype=np.float64) / 2, held
        )

    work = solver.iterate(P, image, replace(run, weights=data.ones()))
    return iter_until_best(work, data.notes, score, settles=solver.settles, goal=goal)


def _iter_to_noise(P: Projector, image: ArrayLike, run: SolverRun, choice: SolverChoice) -> SolverWork:
    """Return a run that stops according to the noise of the sensor; this needs one more projection per iteration."""
    data = run.measure(P, image, signed=True)

    def misfit_of(volume: NDArray[Any]) -> float:
        return misfit(P.forward(volume) + data.background, data, run.read_noise, choice.gain or 1.0)

    return iter_until_noise(choice.solver.iterate(P, image, run), data.notes, misfit_of)


def _iter_judged(
    work: SolverWork, P: Projector, image: ArrayLike, run: SolverRun, noise: tuple[float, float]
) -> SolverWork:
    """Run ``work`` and add chi-square per pixel to its result; this needs one more projection."""
    result = yield from work
    gain, read_noise = noise
    data = replace(run, read_noise=read_noise).measure(P, image, signed=True)
    return replace(result, chi2=misfit(P.forward(result.volume) + data.background, data, read_noise, gain))


def _iter_noted(work: SolverWork, note: str) -> SolverWork:
    """Run ``work`` and add a note to its result."""
    result = yield from work
    return replace(result, notes=(*result.notes, note))


def _iter_cropped(work: SolverWork, margin: int) -> Generator[SolverProgress, None, Reconstruction]:
    """Run ``work`` and return its volume without margin; states keep the margin, so that a run can continue."""
    result = yield from work
    return replace(result, volume=cropped(result.volume, margin))
