"""Find changes that explain patterns better than the camera description: orientation, positions, array, gap or iris."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import uniform_filter

from lfcal.base import Clock, InputError, Work, format_share
from lfcal.camera import Camera, MainLens
from lfcal.judge._modelled import best_alike, plane_of
from lfcal.judge._turned import OrientationMatch, few_positions, iter_matches
from lfcal.judge.evidence import Evidence, iter_fitted, patterns_of
from lfcal.judge.expected import Behind
from lfcal.psf import AS_IS, ORIENTATIONS, PSFMatrix, origin_of
from lfcal.psf.aperture import Iris
from lfcal.simulate.engines import EnergyError

__all__ = ["BETTER", "EXPLAINED", "Disagreement", "Explanation", "iter_explained", "iter_rearranged"]

T = TypeVar("T")

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]
Index = NDArray[np.intp]

EXPLAINED = 0.06
"""Largest error of a camera (fraction of the light) at which it explains patterns."""

BETTER = 0.5
"""Ratio to the description's residual up to which an alternative is reported instead."""

AS_WELL = 1.25
"""Ratio to the best residual up to which other orientations explain patterns equally well, as for symmetric arrays."""

NEAR_PX, MOST_OF = 1, 0.75
"""Distance from a common rule (pixels) up to which positions follow it, and the fraction that must follow it."""

MATCHING = 0.7
"""Smallest correlation of H's patterns with the camera's in the right orientation."""

NONE = 1e6
"""Residual of a description above which it has no relation to the patterns."""

GAPS = (0.92, 0.94, 0.96, 0.97, 0.98, 0.985, 0.99, 1.01, 1.015, 1.02, 1.03, 1.04, 1.06, 1.08)
"""Gaps that are tried, relative to the stated one."""

PUPILS = (0.75, 0.85, 0.9, 0.95, 1.05, 1.1, 1.2, 1.35)
"""Diameters of the iris that are tried, relative to the stated one."""

FINER = (0.5, 0.25)
"""Steps around the best gap or diameter, relative to the spacing of those that are tried."""

BLADES = (0, 4, 5, 6, 7, 8, 9)
"""Numbers of iris blades that are tried."""

TURNS = 3
"""Number of rotations of an iris that are tried within one blade."""

OF_PUPIL, OF_BLADES = 0.8, 0.4
"""Residuals up to which another diameter, or other blades, may be the explanation."""

ROWS = (-2, -1, 1, 2)
"""Displacements of every other row or column that are tried (pixels)."""

OVERLAP = 0.2
"""Fraction of the camera's light that cutouts must contain for another position on the sensor to be searched for."""

DARK, LIT = 0.5, 0.05
"""Fraction of the expected light below which a part of the pupil is blocked, and fraction of the largest expected light
above which a part is examined."""

BLOCKED = (0.03, 0.6)
"""Fractions of the pupil that may be blocked."""

ADVICE_FRAMES = (
    "Assemble again with the frames turned upright (--orientation), or correct the camera's description; no new "
    "recording is needed."
)
ADVICE_CAMERA = (
    "Correct the camera's description, or fit the camera and choose the folder of the fit (lfcal fit, then --fit)."
)


_STAGE = "searching for an explanation of the patterns"


@dataclass(frozen=True)
class Explanation:
    """Change of the camera description, or error of the recording, with which the camera explains H much better.

    Attributes
    ----------
    kind
        Kind of the change: ``"orientation"``, ``"rows"``, ``"part"``, ``"pupil"``, ``"types"``, ``"gap"``,
        ``"diameter"`` or ``"blades"``.
    words
        Description of the change.
    advice
        Remedy, as a sentence.
    before, after
        Unexplained fraction of the light (relative L2) with the description, and with this explanation.

    Examples
    --------
    >>> from lfcal.judge import Explanation
    >>> print(Explanation("gap", "the gap is about 1.5 % larger", "Correct the gap.", 0.22, 0.02).sentence)
    the gap is about 1.5 % larger (unexplained light: 22 % as described, 2 % with this change)
    """

    kind: str
    words: str
    advice: str
    before: float
    after: float

    @property
    def of_recording(self) -> bool:
        """Whether the recording is wrong, so that H must not be used; otherwise, the description may be wrong."""
        return self.kind in ("orientation", "rows", "part", "pupil")

    @property
    def sentence(self) -> str:
        """Sentence with the description of the change, and the unexplained light before and after it."""
        before, after = format_share(min(self.before, 1.0)), format_share(self.after)
        return f"{self.words} (unexplained light: {before} as described, {after} with this change)"


CHECK = (
    "No tested orientation, order of lens types, gap or iris explains the patterns. Check that this is "
    "the right camera, and check its pitch, gap, pixels, depths and iris"
)


@dataclass(frozen=True)
class Disagreement:
    """Disagreement between the patterns of H and the predictions of its stated camera.

    Attributes
    ----------
    reason
        Description of the disagreement, as text.
    misfit, correlation
        Fraction of the light that the camera does not explain (relative L2), and median correlation of the patterns
        with the predictions of the camera. None: not measured.
    explanation
        A change of the description that explains the patterns much better. None: none was found.
    fitted
        Whether the camera comes from a fit.

    Examples
    --------
    >>> from lfcal.judge import Disagreement
    >>> other = Disagreement("patterns have little in common with those of the camera (correlation 0.11)", None, 0.11)
    >>> print(other.certain, other.sentence)
    True patterns have little in common with those of the camera (correlation 0.11).
    """

    reason: str
    misfit: float | None = None
    correlation: float | None = None
    explanation: Explanation | None = None
    fitted: bool = False

    @property
    def certain(self) -> bool:
        """Whether it is certain that H must not be used; otherwise, the description of the camera may be wrong."""
        if self.explanation is not None:
            return self.explanation.of_recording
        return self.correlation is not None

    @property
    def sentence(self) -> str:
        """Sentence that states the disagreement."""
        return f"{self.reason if self.explanation is None else self.explanation.sentence}."

    @property
    def advice(self) -> str:
        """Sentence that states the remedy."""
        if self.explanation is not None:
            return self.explanation.advice
        if self.misfit is None and self.correlation is None:  # nothing was computed
            return "Nothing was computed. Correct the description or the recording, and inspect H again."
        return (
            f"{CHECK}."
            if self.fitted
            else f"{CHECK}, or fit the camera and choose the folder of the fit (lfcal fit, then --fit)."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the attributes, `certain` and `advice` as plain JSON types."""
        return asdict(self) | {"certain": self.certain, "advice": self.advice}


@dataclass(frozen=True, eq=False)
class _Few:
    """A few patterns of H, and the residual that the camera as described leaves in them."""

    matrix: PSFMatrix
    known: Behind
    index: Index
    data: F4
    valid: NDArray[np.bool_]
    before: float

    @property
    def last(self) -> NDArray[np.bool_]:
        """Mask ``(n,)`` of the patterns of the last plane, which suffice for a first choice; all are compared later."""
        found: NDArray[np.bool_] = self.index[:, 0] == self.index[-1, 0]
        return found

    def misfit(self, known: Behind, index: Index, data: F4, valid: NDArray[np.bool_]) -> Work[float]:
        """Return the fraction of the light that a camera leaves unexplained; infinite if it cannot be computed."""
        try:
            found = yield from iter_fitted(self.matrix, known, index, data, valid, Clock(_STAGE, 100), elsewhere=False)
        except (InputError, EnergyError):
            return math.inf
        return found.misfit if float(np.median(found.values[:, 0])) > 0 else math.inf

    def enough(self, after: float) -> bool:
        """Return whether the residual ``after`` of an alternative is much smaller than that of the description."""
        return after <= BETTER * min(self.before, 1.0)


def _iter_few(matrix: PSFMatrix, known: Behind, misfit: float | None) -> Work[_Few]:
    """Return a few patterns with their residual, limited to ``misfit`` if that is known from others."""
    recorded = np.argwhere(matrix.recorded > 0)
    index = few_positions(matrix, recorded)
    data, valid = patterns_of(matrix, index)
    few = _Few(matrix, known, index, data, valid, math.inf)
    before = yield from few.misfit(known, index, data, valid)
    return replace(few, before=min(before, NONE if misfit is None else misfit))


# -- orientation -------------------------------------------------------------------------------------------
def iter_rearranged(matrix: PSFMatrix, known: Behind, misfit: float | None = None) -> Work[Explanation | None]:
    """Return the error in the arrangement of the pixels that explains why patterns do not match the camera, or None.

    Orientations, displacements of every other row or column, and positions of the cutouts on the sensor are tried.

    Parameters
    ----------
    matrix, known
        H, and its camera.
    misfit
        Fraction of the light of other patterns that the description leaves unexplained. None: unknown.
    """
    few = yield from _iter_few(matrix, known, misfit)
    for look in (_orientation, _rows, _part):
        found = yield from look(few)
        if found is not None and few.enough(found.after):
            return found
    return None


def _orientation(few: _Few) -> Work[Explanation | None]:
    """Explain patterns by another orientation, if they match the patterns of the camera in that orientation.

    Patterns of a few positions are compared with all of H in all eight orientations, so that an orientation is found
    whatever happened to the positions.
    """
    matrix, known = few.matrix, few.known
    matches = yield from iter_matches(matrix, known, few.index)
    if matches[0].alike < MATCHING:
        return None
    by_name = {match.name: match for match in matches}
    # orientations with similar correlations are distinguished by their residuals
    tried = [match for match in matches if 1 - match.alike**2 <= _far(matches[0]) and match.name != AS_IS]
    left = {}
    for match in (by_name[AS_IS], *tried):
        data, valid = _upright(few, match)
        left[match.name] = yield from few.misfit(known, match.index, data, valid)
    name = min(left, key=lambda name: (left[name], name != AS_IS))
    after = left[name]
    if not few.enough(after):
        return None
    period = matrix.period
    alike = [by_name[other] for other in left if left[other] <= AS_WELL * after]
    ruled = [(match, rule) for match in alike if (rule := _rule(match, period))]
    if BETTER * left[AS_IS] <= after:
        own = _rule(by_name[AS_IS], period)
        if own in ("", AS_IS):  # upright patterns of other positions are covered by the faults of the scan
            return None
        words = f"the positions are {ORIENTATIONS[own].words} relative to the camera, or the patterns are"
        return Explanation("orientation", words, ADVICE_FRAMES, few.before, after)
    # if several explain the same, prefer one whose positions follow the patterns or stayed as planned
    plain = [(match, rule) for match, rule in ruled if rule in (match.name, AS_IS)]
    best, rule = next(iter((*plain, *ruled, (by_name[name], ""))))
    words = f"the patterns are {ORIENTATIONS[best.name].words} relative to the camera"
    also = [ORIENTATIONS[match.name].words for match, _ in plain if match is not best]
    if also:
        words = (
            f"the patterns are {' or '.join((ORIENTATIONS[best.name].words, *also))} (both explain them equally well)"
        )
    if rule == best.name:
        words += ", and so are their positions"
    turned = Explanation("orientation", words, ADVICE_FRAMES, few.before, after)
    # three types in another order look like a mirrored array; only the iris distinguishes the two
    types = yield from _types(few)
    if types is None or types.after > AS_WELL * after:
        return turned
    if after > AS_WELL * types.after:
        return types
    return replace(turned, words=f"{words}, or {types.words}")


def _far(best: OrientationMatch) -> float:
    """Return the dissimilarity (1 - correlation²) up to which an orientation may be the best one."""
    return 4 * (1 - best.alike**2) + 0.02


def _upright(few: _Few, match: OrientationMatch) -> tuple[F4, NDArray[np.bool_]]:
    """Return the upright patterns of a match; of oblong cutouts turned by 90°, only the middle."""
    turn = ORIENTATIONS[match.name]
    data, valid = patterns_of(few.matrix, match.found)
    if not turn.transposed or data.shape[1] == data.shape[2]:
        return _turned(turn.apply, data), _turned(turn.apply, valid)
    side = min(data.shape[1:])
    t, s = ((n - side) // 2 for n in data.shape[1:])
    inner = (slice(None), slice(t, t + side), slice(s, s + side))
    out, seen = np.zeros_like(data), np.zeros_like(valid)
    out[inner], seen[inner] = _turned(turn.apply, data[inner]), _turned(turn.apply, valid[inner])
    return out, seen


def _turned(apply: Callable[[NDArray[np.generic]], NDArray[np.generic]], patterns: NDArray) -> NDArray:  # type: ignore[type-arg]
    return np.stack([apply(pattern) for pattern in patterns])


def _rule(match: OrientationMatch, period: tuple[int, int]) -> str:
    """Return the orientation that maps the positions of the camera to those of H, except for a displacement.

    The text is empty if there is none. Positions are compared modulo the period.
    """
    size = np.array(period)
    for name in (AS_IS, match.name, *ORIENTATIONS):
        # the operation that makes frames upright moves their positions back
        moved = match.index[:, 1:] @ ORIENTATIONS[name].inverse.moves().T
        if _most_agree(match.found[:, 1:] - moved, size):
            return name
    return ""


def _most_agree(shifts: F8, size: Index) -> bool:
    for one in shifts:
        away = np.abs((shifts - one + size / 2) % size - size / 2).max(1)
        if (away <= NEAR_PX).mean() >= MOST_OF:
            return True
    return False


# -- camera and sensor -------------------------------------------------------------------------------------
def iter_explained(
    matrix: PSFMatrix, known: Behind, *, iris: Iris | None = None, evidence: Evidence | None = None
) -> Work[Explanation | None]:
    """Return the change of the camera, or of its pupil, that explains the patterns much better; None if there is none.

    Parameters
    ----------
    matrix, known
        H, and its camera.
    iris
        The iris visible in the sums of the depth planes. None: not visible.
    evidence
        Patterns that were compared with the camera. None: a partly blocked pupil is not considered.
    """
    few = yield from _iter_few(matrix, known, None if evidence is None else evidence.misfit)
    found: list[Explanation] = []
    clock = Clock(_STAGE, 6)
    looks: list[Callable[[_Few], Work[Explanation | None]]]
    looks = [partial(_blocked, evidence=evidence), _types, _gap, _diameter, partial(_blades, iris=iris)]
    for done, look in enumerate(looks):
        yield clock.at(done)
        one = yield from look(few)
        if one is not None and one.after <= BETTER * one.before:
            found.append(one)
            if one.after <= EXPLAINED:
                break
    return min(found, key=lambda one: one.after / one.before, default=None)


def _rows(few: _Few) -> Work[Explanation | None]:
    """Explain patterns by a displacement of every other row or column relative to the others."""
    yield Clock(_STAGE, 0).at(0)
    model = _models(few, few.known)
    if model is None:
        return None
    tried = [(axis, shift, even) for axis in (1, 2) for shift in ROWS for even in (False, True)]
    best = max(tried, key=lambda one: best_alike(_every_other(few, few.data, *one)[few.last], model))
    data, valid = (_every_other(few, array, *best) for array in (few.data, few.valid))
    after = yield from few.misfit(few.known, few.index, data, valid)
    axis, shift, _ = best
    line, way = ("row", "along the rows") if axis == 1 else ("column", "along the columns")
    words = f"every other {line} is displaced by {abs(shift)} px {way} relative to the others (interlaced)"
    advice = "Read the camera without interlacing, or move these lines back in the frames; then assemble again."
    return Explanation("rows", words, advice, few.before, after)


def _every_other(few: _Few, values: NDArray, axis: int, shift: int, of_sensor: bool) -> NDArray:  # type: ignore[type-arg]
    """Return patterns with every other line, of the sensor or of the cutouts, displaced back."""
    out = values.copy()
    for k, place in enumerate(few.index[:, axis].tolist()):
        first = (1 + place) % 2 if of_sensor else 1
        lines = (slice(first, None, 2), slice(None)) if axis == 1 else (slice(None), slice(first, None, 2))
        out[k][lines] = np.roll(values[k][lines], -shift, 1 if axis == 1 else 0)
    return out


def _part(few: _Few) -> Work[Explanation | None]:
    """Explain patterns by another position of the cutouts on the sensor, as when frames show a part of the sensor."""
    yield Clock(_STAGE, 0).at(0)
    model = _models(few, few.known)
    if model is None:
        return None
    data = few.data - np.median(few.data, axis=(1, 2), keepdims=True)
    by = _elsewhere(data[few.last], model)
    if by == (0, 0):
        return None
    data, valid = (_moved_back(array, by) for array in (few.data, few.valid))
    after = yield from few.misfit(few.known, few.index, data, valid)
    given = origin_of(few.matrix.provenance) or (0, 0)
    row, column = (a + b for a, b in zip(given, by, strict=True))
    ways = zip(by, (("up", "down"), ("left", "right")), strict=True)
    away = " and ".join(f"{abs(n)} px {names[n > 0]}" for n, names in ways if n)
    words = f"all cutouts are {away} of their planned positions"
    if row < 0 or column < 0:
        return Explanation("part", words, "Correct the anchor of the plan and assemble again.", few.before, after)
    words += f", as if the frames were a part of the sensor that begins at row {row}, column {column}"
    advice = (
        f"Assemble again with the first sensor pixel of the frames (--origin {row},{column}), or correct the anchor."
    )
    return Explanation("part", words, advice, few.before, after)


def _elsewhere(data: F4, model: F4) -> tuple[int, int]:
    """Return the displacement (rows, columns) of cutouts ``(n, nt, ns)`` with the best correlation."""
    rows, columns = data.shape[1:]
    shape = tuple(next_fast_len(2 * n - 1, real=True) for n in (rows, columns))
    energy = np.square(model)
    both = irfft2(rfft2(model, shape) * np.conj(rfft2(data, shape)), shape)
    there = irfft2(rfft2(energy, shape) * np.conj(rfft2(np.ones_like(data), shape)), shape)
    total = energy.sum((1, 2), keepdims=True)
    norm = np.sqrt(np.maximum(there, OVERLAP * total) * np.square(data).sum((1, 2), keepdims=True))
    score = np.where(there > OVERLAP * total, both / np.maximum(norm, 1e-30), 0.0).mean(0)
    top = np.unravel_index(int(np.argmax(score)), score.shape)
    row, column = (int(k) - size if k >= size // 2 else int(k) for k, size in zip(top, shape, strict=True))
    return row, column


def _moved_back(patterns: NDArray, by: tuple[int, int]) -> NDArray:  # type: ignore[type-arg]
    """Return patterns ``(n, nt, ns)`` as cutouts at their planned positions would show them, padded with zeros."""
    out = np.zeros_like(patterns)
    sizes = tuple(zip(by, patterns.shape[1:], strict=True))
    to = [slice(max(0, k), n + min(0, k)) for k, n in sizes]
    of = [slice(max(0, -k), n - max(0, k)) for k, n in sizes]
    out[:, *to] = patterns[:, *of]
    return out


def _types(few: _Few) -> Work[Explanation | None]:
    """Explain patterns by another order of the lens types in the description."""
    camera = few.known.setup.camera
    count = len(camera.lattice.types)
    orders = [order for order in itertools.permutations(range(count)) if order != tuple(range(count))]
    if not orders:
        return None

    def ordered(order: tuple[int, ...]) -> Camera:
        types = tuple(camera.lattice.types[k] for k in order)
        return replace(camera, lattice=replace(camera.periodic, types=types))

    order = yield from _best(few, orders, ordered)
    after = yield from _after(few, None if order is None else ordered(order))
    words = f"the lens types are in another order: {', '.join(map(str, order or ()))} in the numbers of the description"
    advice = "State the lens types in this order, or turn the frames upright if the array is mirrored."
    return Explanation("types", words, advice, few.before, after)


def _gap(few: _Few) -> Work[Explanation | None]:
    """Explain patterns by an error of the gap between lenslets and sensor."""
    camera = few.known.setup.camera

    def scaled(factor: float) -> Camera:
        return replace(camera, lattice=replace(camera.lattice, gap_um=camera.lattice.gap_um * factor))

    factor, after = yield from _nearest(few, GAPS, scaled)
    words = f"the gap between lenslets and sensor differs from the description by about {100 * (factor - 1):+.1f} %"
    return Explanation("gap", words, ADVICE_CAMERA, few.before, after)


def _diameter(few: _Few) -> Work[Explanation | None]:
    """Explain patterns by an error of the diameter of the iris."""
    camera = few.known.setup.camera
    optics = camera.optics
    if few.before > OF_PUPIL:
        return None

    def scaled(factor: float) -> Camera:
        if isinstance(optics, MainLens):
            return replace(camera, optics=replace(optics, f_number=optics.f_number / factor))
        return replace(camera, optics=replace(optics, numerical_aperture=optics.numerical_aperture * factor))

    factor, after = yield from _nearest(few, PUPILS, scaled)
    words = f"the diameter of the iris differs from the description by about {100 * (factor - 1):+.0f} %"
    return Explanation("diameter", words, ADVICE_CAMERA, few.before, after)


def _blades(few: _Few, iris: Iris | None) -> Work[Explanation | None]:
    """Explain patterns by another number of iris blades: the number in the sums, or else the best of the usual ones."""
    camera = few.known.setup.camera
    optics = camera.optics
    if not isinstance(optics, MainLens) or few.before > OF_BLADES:
        return None
    if iris is not None and iris.confident and iris.blades != optics.blades:
        half = math.pi / max(1, iris.blades)
        tried = [(iris.blades, iris.rotation_rad + k * half, iris.curvature) for k in (0, 1)]
    else:
        turns = {n: TURNS if n else 1 for n in BLADES if n != optics.blades}
        tried = [(n, 2 * math.pi * k / (many * max(1, n)), 0.0) for n, many in turns.items() for k in range(many)]

    def bladed(one: tuple[int, float, float]) -> Camera:
        blades, turn, curvature = one
        return replace(
            camera, optics=replace(optics, blades=blades, blade_rotation_rad=turn, blade_curvature=curvature)
        )

    best = yield from _best(few, tried, bladed)
    after = yield from _after(few, None if best is None else bladed(best))
    many = best[0] if best is not None else 0
    words = f"the iris has {many} blades" if many else "the iris is round"
    words += f", but {optics.blades} in the description" if optics.blades else ", but it is round in the description"
    return Explanation("blades", words, ADVICE_CAMERA, few.before, after)


def _nearest(few: _Few, factors: Sequence[float], scaled: Callable[[float], Camera]) -> Work[tuple[float, float]]:
    """Return the refined factor that explains most, and the remaining residual."""
    best = yield from _best(few, factors, scaled)
    if best is None:
        return 1.0, math.inf
    step = min(abs(best - one) for one in (*factors, 1.0) if one != best)
    for share in FINER:
        near = [best - share * step, best, best + share * step]
        best = (yield from _best(few, near, scaled)) or best
    after = yield from _after(few, scaled(best))
    return best, after


def _best(few: _Few, tried: Sequence[T], camera: Callable[[T], Camera]) -> Work[T | None]:
    """Return the variant whose patterns are most similar to those of H; None if none can be computed."""
    best: T | None = None
    top = -math.inf
    for done, one in enumerate(tried):
        yield Clock(_STAGE, len(tried)).at(done)
        try:
            model = _models(few, _with(few.known, camera(one)))
        except InputError:
            continue
        alike = -math.inf if model is None else best_alike(few.data[few.last], model)
        if alike > top:
            best, top = one, alike
    return best


def _after(few: _Few, camera: Camera | None) -> Work[float]:
    if camera is None:
        return math.inf
    return (yield from few.misfit(_with(few.known, camera), few.index, few.data, few.valid))


def _with(known: Behind, camera: Camera) -> Behind:
    """Return ``known`` with another camera at the same positions."""
    return replace(known, setup=replace(known.setup, camera=camera))


def _models(few: _Few, known: Behind) -> F4 | None:
    """Return the patterns of the last plane predicted by a camera; None if they cannot be computed."""
    own = few.last
    try:
        plane = plane_of(known, int(few.index[own, 0][0]), 0.0)
        return plane.patterns(few.index[own, 1:], np.zeros((int(own.sum()), 2)))
    except (InputError, EnergyError):
        return None


# -- a blocked pupil ---------------------------------------------------------------------------------------
def _blocked(few: _Few, evidence: Evidence | None) -> Work[Explanation | None]:
    """Explain patterns by a blocked part of the pupil, which is dark in all patterns of a plane."""
    del few
    yield Clock(_STAGE, 0).at(0)
    if evidence is None:
        return None
    lens = evidence.camera.setup.camera.lattice
    side = 2 * round(lens.pitch_um / evidence.camera.setup.camera.sensor.pixel_um / 2) + 1
    seen = np.ones((evidence.plan.shape[0], *evidence.plan.cutout), np.float32)
    lost = light = 0.0
    for z, dark, expected in _dark_parts(evidence, side):
        seen[z][dark] = 0.0
        lost += float(expected[dark].sum())
        light += float(expected.sum())
    share = lost / light if light > 0 else 0.0
    if not BLOCKED[0] <= share <= BLOCKED[1]:
        return None
    own = seen[evidence.index[:, 0]]
    changed = replace(evidence, model=evidence.model * own, columns=evidence.columns * own[:, None])
    after = changed.with_data(evidence.data, evidence.valid).misfit
    words = f"about {100 * share:.0f} % of the pupil is blocked"
    advice = (
        "Look at the depth-plane sums. Free the iris or remove the obstacle, and record again; or state "
        "the vignetting in the camera."
    )
    return Explanation("pupil", words, advice, evidence.misfit, after)


def _dark_parts(evidence: Evidence, side: int) -> Iterator[tuple[int, NDArray[np.bool_], F8]]:
    """Yield each plane, a mask ``(nt, ns)`` of where its patterns are too dark, and the expected light ``(nt, ns)``."""
    use = evidence.valid & ~evidence.unlike[:, None, None]
    for z in np.unique(evidence.index[:, 0]).tolist():
        own = evidence.index[:, 0] == z
        there = use[own]
        # averaging over a lenslet removes the structure of the lenslets
        found, expected = (
            uniform_filter(np.where(there, light[own], 0).sum(0, dtype=np.float64), side, mode="constant")
            for light in (evidence.data - evidence.values[:, 1, None, None].astype(np.float32), evidence.model)
        )
        lit = expected > LIT * expected.max()
        ratio = np.divide(found, expected, out=np.ones_like(found), where=lit)
        # most of the pupil is not blocked, and its light sets the scale
        order = np.argsort(ratio[lit])
        weight = np.cumsum(expected[lit][order])
        usual = float(ratio[lit][order][np.searchsorted(weight, 0.7 * weight[-1])]) if lit.any() else 1.0
        yield z, lit & (ratio < DARK * usual), np.where(lit, expected, 0.0)
