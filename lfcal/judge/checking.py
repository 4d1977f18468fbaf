"""Check an old H with new frames."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Work, check_number, drained, format_share, plain
from lfcal.fit import (
    DARK,
    ChiSquare,
    Compared,
    LocatedPattern,
    ModelError,
    NewFrame,
    compared_with,
    find_source,
    noises_of,
    spread_out,
)
from lfcal.judge._camera_changes import FrameResiduals, Suspect, changes_of, explained_by, refined
from lfcal.judge.expected import Behind, ExpectedPattern, behind
from lfcal.judge.source import judgement_of
from lfcal.psf import PSFMatrix

__all__ = ["Check", "check", "iter_check"]

F8 = NDArray[np.float64]

LIMIT = 0.02
"""Error of H (relative L2) up to which H is valid."""

CLEAR = 3.0
"""Standard deviations by which an error must exceed the limit."""

VAGUE = 3.0
"""Multiple of the limit below which an upper limit of the error is good enough to decide."""

ASKED = 8
"""Largest number of frames used to find suspects; more would take longer without benefit."""

SURE, MORE = 0.7, 0.2
"""Correlation below which a source is searched for away from its stated position, and the improvement that is
required."""

SAME = 0.3
"""Chi² below which a frame does not differ from the frames of H."""

BESIDE = 0.1
"""Mean displacement of the sources above which it is reported (pixels)."""


@dataclass(frozen=True, eq=False)
class Check:
    """Result of checking an old H with new frames.

    Attributes
    ----------
    frames
        Comparison of each frame with H.
    error, chi_square
        Relative error (L2) of H in predicting the frames, and chi-square, over all frames.
    limit
        Largest error of a valid H (relative L2).
    stated
        Largest error that the file of H states for the planes of the frames (relative L2). 0: it states none.
    doubt
        Largest uncertainty of the predicted patterns, because the sources are between positions of H (relative L2).
    suspects
        Possible changes of the camera since H was made, the best explanation first.
    model_misfit
        Error of the best prediction of H by its camera (relative L2). None: H has no camera.
    noise_from
        Text that states how the noise of the frames was determined.
    notes
        Remarks in addition to the verdict.
    """

    data: ClassVar[str] = "H"

    frames: tuple[Compared, ...]
    error: ModelError
    chi_square: ChiSquare
    limit: float
    stated: float
    doubt: float
    suspects: tuple[Suspect, ...]
    model_misfit: float | None
    noise_from: str
    notes: tuple[str, ...]

    @property
    def holds(self) -> bool | None:
        """Whether H is still valid. None: the frames are not sufficient to decide."""
        sure = CLEAR * self.error.squared_sigma
        own = math.hypot(self.stated, self.doubt)
        off = self.error.squared - sure > self.limit**2 + own**2
        if any(one.strange for one in self.frames) or (off and self.noise_from != DARK):
            return False
        if any(one.shows and one.error - CLEAR * one.sigma > max(self.limit, own) for one in self.suspects):
            return False
        # near the limit, for example because the comparison is not accurate enough
        if off or (self.error.known and self.error.squared > self.limit**2 + self.stated**2):
            return None
        bound = math.sqrt(max(0.0, self.error.squared - self.stated**2) + 2 * self.error.squared_sigma)
        return None if max(bound, self.doubt) > VAGUE * self.limit else True

    @property
    def explanations(self) -> tuple[Suspect, ...]:
        """Significant changes that explain the frames and cause an error above half of `limit`, the best first."""
        return tuple(one for one in self.suspects if one.shows and one.error > 0.5 * self.limit)

    @property
    def answer(self) -> str:
        """Whether H is valid, as text: "holds", "does not hold" or "undecided"."""
        return {True: "holds", False: "does not hold", None: "undecided"}[self.holds]

    @property
    def figures(self) -> str:
        """Text with the error of H, its limit, and chi-square."""
        return f"error {self.error} beyond noise, limit {format_share(self.limit)}; chi² {self.chi_square.lit:.2f}"

    @property
    def remedy(self) -> str:
        """Sentence on what to do if H is not valid, or if the frames are not sufficient to decide."""
        if self.holds is not None:
            return "Record H again, or fit the camera again."
        if self.noise_from == DARK:
            return "Part of the error may be photon noise, which is unknown: state the noise (--noise)."
        return "Record more frames, or record with more light."

    @property
    def known(self) -> str:
        """Text that confirms H in a verdict; empty unless the frames show that H is valid."""
        return f"confirmed by the frames: {self.figures}" if self.holds else ""

    def to_dict(self) -> dict[str, Any]:
        """Return all values, the verdict and its findings as plain JSON types."""
        found: dict[str, Any] = plain(
            {
                "format": "lfcal-check",
                "version": 1,
                "answer": self.answer,
                "limit": self.limit,
                "error": self.error.to_dict(),
                "stated_error": self.stated,
                "doubt": self.doubt,
                "chi2": self.chi_square.to_dict(),
                "noise_from": self.noise_from,
                "model_misfit": self.model_misfit,
                "notes": self.notes,
                "frames": [_frame_dict(one) for one in self.frames],
                "suspects": [_suspect_dict(one) for one in self.suspects],
                **judgement_of(self).to_dict(),
            }
        )
        return found


def _frame_dict(one: Compared) -> dict[str, Any]:
    at, error = one.found, one.error
    return {
        "label": one.label,
        "position": [at.z, at.y, at.x],
        "pixel": [at.row, at.column],
        "correlation": at.correlation,
        "displacement_px": one.displacement_px,
        "displacement_sigma_px": one.displacement_sigma,
        "beside_px": one.beside_px,
        "light": one.gain,
        "background": one.background,
        "error": {"known": error.known, "value": error.value, "limit": error.limit},
        "chi2": one.chi_square.lit,
    }


def _suspect_dict(one: Suspect) -> dict[str, Any]:
    found = {key: getattr(one, key) for key in ("name", "shows", "error", "sigma", "left")}
    names = ("name", "change", "sigma", "unit")
    return {**found, "values": [dict(zip(names, value, strict=True)) for value in one.values]}


def iter_check(
    matrix: PSFMatrix,
    frames: ArrayLike | NewFrame | Sequence[NewFrame],
    *,
    noise: tuple[float, float] | None = None,
    limit: float = LIMIT,
    suspects: bool = True,
) -> Work[Check]:
    """Check whether H is still valid, with new frames of point sources.

    If the position of a source is not known, it is searched for. The gain, the background and the displacement of each
    source from the nearest position of H are fitted.

    Parameters
    ----------
    matrix
        The old H.
    frames
        A frame ``(rows, columns)`` of the whole sensor with the dark level subtracted (counts), or one or more
        `NewFrame`.
    noise
        ``(constant, slope)``: the variance of a sample of value v is ``constant + slope * max(v, 0)`` (counts²). None:
        as stated by the frames or by H, or else measured on the dark pixels of the frames.
    limit
        Largest error of a valid H (relative L2), such as 0.02 for 2 %.
    suspects
        Whether to search for changes of the camera that explain the frames.

    Yields
    ------
    Progress
        Counted in frames.

    Raises
    ------
    InputError
        If H is transposed, resampled or without recorded patterns, ``limit`` is not between 0 and 1, or a frame shows
        no light where H has a pattern.
    """
    check_number("largest error of a valid H", limit, above=0, below=1)
    _check_matrix(matrix)
    given = _as_frames(frames)
    clock = Clock("compare", 2 * len(given) + 1)
    yield clock.at(0)
    found = []
    for k, frame in enumerate(given):
        found.append(_placed(matrix, frame))
        yield clock.at(k + 1)
    index = np.array([(one.z, one.y, one.x) for one in found], np.intp)
    camera = behind(matrix, index[spread_out(index, min(ASKED, len(index)), matrix.period)])
    variances, source = noises_of(matrix, given, noise)
    compared = []
    for k, (frame, at) in enumerate(zip(given, found, strict=True)):
        expected = ExpectedPattern(matrix, at.z, at.y, at.x, camera)
        compared.append(compared_with(expected, frame, at, variances[k]))
        yield clock.at(len(given) + k + 1)
    searched = suspects and camera is not None and camera.explains and not any(one.strange for one in compared)
    reported = _suspects(compared, camera) if searched and camera is not None else ()
    yield clock.at(2 * len(given) + 1)
    return _judged(matrix, tuple(compared), reported, camera, limit, source)


check = drained(
    iter_check,
    """
    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan
    >>> from lfcal.judge import Check, check
    >>> from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    >>> from lfcal.psf import open_psf
    >>> plan = ScanPlan.from_json(Path("session/plan.json").read_text())
    >>> with open_frames("session/frames", plan=plan) as frames, open_psf("H.h5") as H:
    ...     recipe = CorrectionRecipe(dark="session/dark", white="session/white")
    ...     frame = corrected_view(frames, recipe, plan).read(200)
    ...     found: Check = check(H, frame, suspects=False)
    >>> print("H holds:", found.holds)
    H holds: True
    """,
)


def _as_frames(frames: ArrayLike | NewFrame | Sequence[NewFrame]) -> list[NewFrame]:
    if isinstance(frames, NewFrame):
        return [frames]
    given = list(frames) if isinstance(frames, Sequence) else []
    if isinstance(frames, Sequence) and not given:
        raise InputError.expected("new frames", "at least one", "none", "give a frame that was recorded after H")
    known = [one for one in given if isinstance(one, NewFrame)]
    if known and len(known) == len(given):
        return known
    values = np.asarray(frames)
    if values.ndim != 2 or values.dtype.kind not in "iuf":
        got = f"{values.dtype} of shape {values.shape}"
        raise InputError.expected("frame", "numbers with axes (row, column)", got, "give one frame")
    return [NewFrame(values.astype(np.float32))]


def _placed(matrix: PSFMatrix, frame: NewFrame) -> LocatedPattern:
    """Return the position of the source of a frame, which is the stated one unless another fits much better."""
    if frame.place is None:
        return find_source(matrix, frame)
    free = replace(frame, place=None, plane=None)
    try:
        found = find_source(matrix, frame)
    except InputError:  # its position is outside the frame, or H has no pattern there
        return find_source(matrix, free)
    if found.correlation > SURE:
        return found
    anywhere = find_source(matrix, free)
    return anywhere if anywhere.correlation > found.correlation + MORE else found


def _check_matrix(matrix: PSFMatrix) -> None:
    if matrix.is_transposed:
        raise InputError.expected("H", "an H", "HT", "give H")
    if matrix.pixel_scale != (1.0, 1.0):
        raise InputError.expected(
            "H to check",
            "an H with the sensor's own pixels",
            "a resampled H",
            "give an H that was assembled without resampling",
        )
    if not (matrix.recorded > 0).any():
        raise InputError.expected("H", "recorded positions", "none", "give an H with recorded patterns")


def _suspects(compared: Sequence[Compared], camera: Behind) -> tuple[Suspect, ...]:
    """Return the possible changes of the camera of H."""
    index = np.array([(one.found.z, one.found.y, one.found.x) for one in compared], np.intp)
    period = np.ptp(index[:, 1:], axis=0) + 1
    chosen = spread_out(index, min(ASKED, len(index)), (int(period[0]), int(period[1])))
    some, n = [compared[int(k)] for k in chosen], len(chosen)
    light = np.stack([one.light for one in some])
    offsets = np.array([one.displacement_px for one in some])
    changes = changes_of(camera, index[chosen], offsets).in_units_of(light)
    flat = light.reshape(n, 1, -1)
    moved = np.stack([one.moved.reshape(2, -1) for one in some])
    values, weight, noise = (
        np.stack([getattr(one, name) for one in some]).reshape(n, -1) for name in ("values", "weight", "noise")
    )
    nuisance = np.concatenate([flat, np.ones_like(flat), moved], axis=1)
    left = FrameResiduals(values - flat[:, 0], flat[:, 0], noise, weight, nuisance)
    return refined(explained_by(changes, left), camera, index[chosen], offsets, changes, left)


def _judged(
    matrix: PSFMatrix,
    compared: tuple[Compared, ...],
    suspects: tuple[Suspect, ...],
    camera: Behind | None,
    limit: float,
    noise_from: str,
) -> Check:
    """Return the result of checking all frames together."""
    powers = np.array([float(np.square(one.light[one.weight > 0]).sum()) for one in compared])
    share = powers / powers.sum() if powers.sum() > 0 else np.full(len(powers), 1 / len(powers))
    squared = float(share @ [one.error.squared for one in compared])
    sigma = math.sqrt(float(share**2 @ [one.error.squared_sigma**2 for one in compared]))
    counts = np.array([one.chi_square.sigma**-2 for one in compared])
    lit, every = (
        float(counts @ [getattr(one.chi_square, name) for one in compared] / counts.sum())
        for name in ("lit", "all_pixels")
    )
    doubt = max(one.doubt for one in compared)
    stated = _stated(matrix, [one.found.z for one in compared])
    notes = _notes(compared, camera, doubt, stated, limit) if not any(one.strange for one in compared) else []
    return Check(
        compared,
        ModelError(squared, sigma, 0.0, len(compared)),
        ChiSquare(every, lit, float(counts.sum()) ** -0.5),
        limit,
        stated,
        doubt,
        suspects,
        None if camera is None else camera.misfit,
        noise_from,
        tuple(notes),
    )


def _notes(compared: Sequence[Compared], camera: Behind | None, doubt: float, stated: float, limit: float) -> list[str]:
    """Return the remarks in addition to the verdict."""
    notes = []
    if doubt > 0.5 * limit:
        notes.append(
            f"the sources are between the positions of H, where its prediction has an error of {format_share(doubt)}"
        )
    if stated > limit:
        notes.append(f"the file of H states an error of {format_share(stated)}")
    if camera is not None and not camera.explains:
        left = format_share(camera.misfit)
        notes.append(
            f"the camera of H leaves {left} of H unexplained, so the cause of the change is unknown; fit this "
            "H first (lfcal fit)"
        )
    if camera is None:
        notes.append("the camera of H is unknown, and so is the cause of the change")
    beside = np.array([one.beside_px for one in compared if one.beside_px is not None]).reshape(-1, 2)
    if len(beside) and math.hypot(*beside.mean(0)) > BESIDE:
        rows, columns = beside.mean(0)
        notes.append(f"the sources are displaced by ({rows:.2f}, {columns:.2f}) px: the stage or the array has moved")
    if min(one.chi_square.lit for one in compared) < SAME:
        notes.append(
            "the frames differ from H by less than their noise: H was made from them, or the stated noise is too large"
        )
    gains = [one.gain for one in compared]
    spread = float(np.std(gains) / abs(np.mean(gains))) if len(gains) > 1 and np.mean(gains) else 0.0
    if spread > 0.05:
        notes.append(f"the lamp is unsteady: its light varies by {format_share(spread)} between the frames")
    return notes


def _stated(matrix: PSFMatrix, planes: Sequence[int]) -> float:
    """Return the largest error that H states for the planes; 0 if it states none."""
    known = matrix.facts.error
    found = [] if known is None else [float(known[z]) for z in planes if math.isfinite(known[z])]
    fit = matrix.provenance.get("fit")
    said = fit.get("error") if isinstance(fit, Mapping) else None
    if isinstance(said, int | float) and math.isfinite(said):
        found.append(float(said))
    return max(0.0, *found) if found else 0.0
