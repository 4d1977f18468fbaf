"""Displacements of sources (step, rotation, shear, play, drift, jitter) and of cutouts from their planned positions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.judge._modelled import REACH_PX
from lfcal.judge._patch import Patch
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FoundFault, PutIn
from lfcal.judge.faults._series import BETTER, SURE, SeriesJump, robust, scan_order, sharpest_step, usual
from lfcal.judge.faults.places import late, only_recorded, place_map, share_of

__all__ = ["FAULTS", "BacklashFault", "FrameShift", "Jitter", "StageAxesFault", "Strangers"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

FLOOR_PX = 0.004
"""Error of the model, which is the smallest error of displacements (pixels)."""

WORTH_PX = 0.05
"""Displacement of sources at the edge of the period above which it is reported (pixels)."""

ANCHOR_PX = 0.25
"""Displacement of all cutouts above which it is reported; the camera's offset is usually not more accurate (pixels)."""

FAR_PX = 0.4
"""Displacement of a single source above which its frame is not the planned one (pixels)."""

UNLIKE = 0.3
"""Amount by which the correlation of a pattern that does not belong to its position is below the median."""

FEW = 0.1
"""Fraction of positions with displaced cutouts up to which they count as foreign patterns."""

MANY = 0.45
"""Largest fraction of foreign patterns: more of them mean a scan in another order."""

DARK = 0.25
"""Gain, relative to other patterns, below which a pattern is dark, which is a fault of exposure."""


class Moved(NamedTuple):
    """Robust fit of a displacement along one axis.

    ``terms`` contains (value, standard deviation) of ``by_row`` and ``by_column`` (px per position), and of
    ``by_direction`` (px), the difference between odd and even rows. ``left`` are the residuals ``(n,)`` (px).
    """

    terms: dict[str, tuple[float, float]]
    left: F8


def _fitted(evidence: Evidence, name: str) -> Moved:
    """Return a robust fit of the displacement ``name``: coefficients with sigmas, and the residual of each pattern."""
    values, sigmas = evidence.column(name)
    z, y, x = evidence.index.T.astype(np.float64)
    ny, nx = evidence.plan.period
    rows = [np.where(z == plane, 1.0, 0.0) for plane in np.unique(z)]
    design = np.stack([*rows, (y - (ny - 1) / 2), (x - (nx - 1) / 2), np.where(evidence.index[:, 1] % 2, 0.5, -0.5)], 1)
    # suspect patterns must not influence what is typical
    even = np.where(evidence.asked, np.inf, np.hypot(sigmas, FLOOR_PX))
    found, errors, left = robust(design, values, even)
    names = ("by_row", "by_column", "by_direction")
    return Moved(dict(zip(names, zip(found[-3:], errors[-3:], strict=True), strict=True)), left)


class StageAxesFault(Fault):
    """Stage steps that are too long or too short, axes that are rotated or sheared, or a drift during the scan."""

    name = "stage_axes"
    title = "wrong steps or axes of the stage"
    subject = "stage"
    rank = 30
    advice = (
        "Measure the scale and the angle of the stage (Adjust the rig in the window), correct the plan, "
        "and record again."
    )
    settles: ClassVar[tuple[str, ...]] = ("stage_gain", "drift")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if the displacements of the sources change linearly along the rows or columns of the scan."""
        down, across = (_fitted(evidence, name) for name in ("source_y", "source_x"))
        ny, nx = evidence.plan.period
        size = {"by_row": ny / 2, "by_column": nx / 2}
        reported = {
            (axis, term): part.terms[term]
            for axis, part in (("y", down), ("x", across))
            for term in ("by_row", "by_column")
        }
        seen = {
            key: value
            for key, (value, sigma) in reported.items()
            if abs(value) > SURE * sigma and abs(value) * size[key[1]] > WORTH_PX
        }
        if not seen:
            return
        worst = max(abs(v) * size[key[1]] for key, v in seen.items())
        sigmas = max(abs(reported[key][0]) / reported[key][1] for key in seen)
        values, _ = evidence.column("source_x" if any(a == "x" for a, _ in seen) else "source_y")
        yield FoundFault(
            self,
            f"{_words(seen)}: sources up to {worst:.2f} px from their planned positions",
            float(sigmas),
            share_of(evidence, worst / 2, ("source_y", "source_x")),
            picture=place_map(evidence, values, "px", "displacement of the source"),
            redo=True,
            put_in=_stretched(seen),
        )


def _stretched(seen: dict[tuple[str, str], float]) -> PutIn:
    def put_in(patch: Patch) -> F4:
        ny, nx = patch.evidence.plan.period
        beside = {"by_row": patch.index[:, 1] - (ny - 1) / 2, "by_column": patch.index[:, 2] - (nx - 1) / 2}
        moved = np.zeros((len(patch.index), 2))
        for (axis, term), value in seen.items():
            moved[:, "yx".index(axis)] += value * beside[term]
        return patch.moved(np.clip(moved, -REACH_PX, REACH_PX))

    return put_in


def _words(seen: dict[tuple[str, str], float]) -> str:
    """Return the name of a linear change of the scan."""
    yy, yx, xy, xx = (
        seen.get(k, 0.0) for k in (("y", "by_row"), ("y", "by_column"), ("x", "by_row"), ("x", "by_column"))
    )
    if yx and xy and yx * xy < 0 and BETTER < abs(yx / xy) < 1 / BETTER:
        turn = f"stage rotated by {np.degrees((yx - xy) / 2):.2f}°"
        return turn if not (yy or xx) else f"{turn}, with wrong steps"
    if (xx or yy) and not (yx or xy):
        if xx and yy and BETTER < yy / xx < 1 / BETTER:
            return f"stage step {100 * (xx + yy) / 2:+.1f} %"
        parts = [f"{100 * v:+.1f} % along {name}" for v, name in ((yy, "rows (down)"), (xx, "columns")) if v]
        return "stage step " + ", ".join(parts) + ("" if xx else " (or a drift during the scan)")
    if xy and not (yx or xx):
        return "drift during the scan, or axes that are not square"
    return "axes of the stage differ from those of the sensor"


class BacklashFault(Fault):
    """Backlash: sources are displaced in rows that are scanned backwards."""

    name = "backlash"
    title = "backlash of the stage"
    subject = "stage"
    rank = 31
    advice = (
        "Scan every row from the same side (order raster), or approach each position from one side "
        "(lfcal acquire --overshoot)."
    )
    settles: ClassVar[tuple[str, ...]] = ("backlash",)

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault for each direction, along or across the rows, in which every other row is displaced."""
        for name, along in (("source_x", "the rows"), ("source_y", "the columns")):
            value, sigma = _fitted(evidence, name).terms["by_direction"]
            if abs(value) > SURE * sigma and abs(value) > WORTH_PX:
                values, _ = evidence.column(name)
                yield FoundFault(
                    self,
                    f"every other row is displaced by {value:+.2f} ± {sigma:.3f} px along {along}",
                    abs(value) / sigma,
                    share_of(evidence, abs(value) / 2, (name,)),
                    picture=place_map(evidence, values, "px", "displacement of the source"),
                    redo=True,
                    put_in=_played("yx".index(name[-1]), value),
                )


def _played(axis: int, value: float) -> PutIn:
    def put_in(patch: Patch) -> F4:
        moved = np.zeros((len(patch.index), 2))
        moved[:, axis] = np.where(patch.index[:, 1] % 2, value / 2, -value / 2)
        return patch.moved(moved)

    return put_in


class Jitter(Fault):
    """Random displacement of the sources."""

    name = "jitter"
    title = "jitter of the stage"
    subject = "stage"
    rank = 33
    advice = "Let the stage settle longer, and check its repeatability. Then record the positions again."
    settles: ClassVar[tuple[str, ...]] = ("jitter", "misplaced")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if the sources scatter about their positions by more than the measurement errors explain."""
        spread = []
        for name in ("source_y", "source_x"):
            left, (_, sigmas) = _fitted(evidence, name).left, evidence.column(name)
            known = np.isfinite(sigmas)
            # by the median, because single distant patterns are a separate fault
            scatter = 1.4826 * float(np.median(np.abs(left[known])))
            chance = float(np.sqrt(np.median(np.square(sigmas[known])) + FLOOR_PX**2))
            spread.append(
                (np.sqrt(max(0.0, scatter**2 - chance**2)), (scatter / chance - 1) * np.sqrt(2 * known.sum()) / 1.5)
            )
        rms, sigmas_out = float(np.hypot(*(s for s, _ in spread))), max(t for _, t in spread)
        if sigmas_out > SURE and rms > WORTH_PX:
            yield FoundFault(
                self,
                f"sources scatter by {rms:.2f} px (rms) about their positions",
                float(sigmas_out),
                share_of(evidence, rms, ("source_y", "source_x")),
                picture=place_map(evidence, _fitted(evidence, "source_x").left, "px", "displacement of the source"),
                redo=True,
                put_in=_jittered([float(rms) for rms, _ in spread]),
                scatters=True,
            )


def _jittered(rms: Sequence[float]) -> PutIn:
    def put_in(patch: Patch) -> F4:
        moved = np.random.default_rng(0).standard_normal((len(patch.index), 2)) * np.array(rms)
        return patch.moved(np.clip(moved, -REACH_PX, REACH_PX))

    return put_in


class FrameShift(Fault):
    """The cutouts are displaced, not the sources: the region of the sensor moved, or the anchor is wrong."""

    name = "frame_shift"
    title = "frames displaced relative to the plan"
    subject = "stage"
    rank = 28
    advice = (
        "Check which region of the sensor was read. Assemble H again, and state the first pixel of this region "
        "(--origin)."
    )
    settles: ClassVar[tuple[str, ...]] = ("seam", "centring", "stage_gain", "pitch", "truncation")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault for each direction, down or across the sensor, in which the cutouts are displaced.

        It describes the sharpest jump of the displacement in scan order or, if no jump is significant, the median.
        """
        for name, along in (("window_y", "down"), ("window_x", "across")):
            values, sigmas = evidence.column(name)
            step: SeriesJump | None = sharpest_step(scan_order(evidence.index), values, np.hypot(sigmas, FLOOR_PX))
            if step is None or abs(step.size) < 2 * WORTH_PX or step.sigmas < SURE:
                yield from self._all(evidence, name, along)
                continue
            after = evidence.index[step.after]
            yield FoundFault(
                self,
                f"{abs(step.size):.2f} px {along}, from {tuple(int(v) for v in after[0])} onwards",
                step.sigmas,
                share_of(evidence, abs(step.size) / 2, (name,)),
                positions=after,
                picture=place_map(evidence, values, "px", "displacement of the cutout"),
                put_in=_shifted("yx".index(name[-1]), step.size, after[0]),
            )

    def _all(self, evidence: Evidence, name: str, along: str) -> Iterable[FoundFault]:
        """Yield a fault if all cutouts have the same displacement."""
        values, sigmas = evidence.column(name)
        most = usual(values, np.hypot(sigmas, FLOOR_PX))
        if most is None:
            return
        middle, error = most.middle, most.error
        if abs(middle) < max(ANCHOR_PX, SURE * error):
            return
        yield FoundFault(
            self,
            f"{abs(middle):.2f} px {along} in all frames: the anchor is wrong, or frames show a part of the sensor",
            abs(middle) / error,
            share_of(evidence, abs(middle), (name,)),
            picture=place_map(evidence, values, "px", "displacement of the cutout"),
            put_in=_shifted("yx".index(name[-1]), middle, np.zeros(3, np.intp)),
        )


def _shifted(axis: int, size: float, first: NDArray[np.intp]) -> PutIn:
    def put_in(patch: Patch) -> F4:
        window = np.zeros((len(patch.index), 2))
        window[:, axis] = np.where(late(patch.evidence.plan, patch.index, first), size, 0.0)
        return patch.moved(window=window)

    return put_in


class Strangers(Fault):
    """Single patterns that belong to other positions."""

    name = "strangers"
    title = "patterns of other positions"
    subject = "stage"
    rank = 26
    advice = "Check the order of these frames, and record the positions again."
    settles: ClassVar[tuple[str, ...]] = ("misplaced",)

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault with the patterns that are far from their positions, or unlike those of the camera.

        A pattern is far from its position if its source or its cutout is. Nothing is yielded if there are too many such
        patterns.
        """
        alike, gains = evidence.alike, evidence.values[:, 0]
        lit = gains > DARK * float(np.median(gains[np.isfinite(evidence.sigmas[:, 0])]))
        far = np.stack([_fitted(evidence, name).left for name in ("source_y", "source_x")], 1)
        unlike = evidence.unlike & (alike < np.median(alike) - UNLIKE)
        windows = np.stack([_fitted(evidence, name).left for name in ("window_y", "window_x")], 1)
        aside = (np.abs(windows) > FAR_PX).any(1)
        # if many cutouts are displaced, the region of the sensor moved
        aside &= evidence.extent(np.flatnonzero(aside)) < FEW
        bad = np.flatnonzero((unlike | aside | (np.abs(far) > FAR_PX).any(1)) & lit)
        if not bad.size or evidence.extent(bad) > MANY:
            return
        scatter = max(1e-2, 1.4826 * float(np.median(np.abs(far))))
        reported = max(float(np.abs(far[bad]).max()) / scatter, float(np.median(alike) - alike[bad].min()) / 0.02)
        some = "; ".join(_whose(evidence, int(k), far[k], unlike=bool(unlike[k])) for k in bad[:3])
        many = "1 pattern" if bad.size == 1 else f"{bad.size} patterns"
        yield FoundFault(
            self,
            f"{many} of {len(evidence)} compared: {some}{' and more' if bad.size > 3 else ''}",
            reported,
            evidence.extent(bad),
            positions=evidence.index[bad],
            picture=place_map(evidence, alike, "correlation", "correlation with the camera's pattern"),
            redo=True,
            put_in=only_recorded(evidence.index[bad]),
            extent=evidence.likely_extent(bad),
        )


def _whose(evidence: Evidence, k: int, far: F8, *, unlike: bool) -> str:
    """Return a description of a foreign pattern."""
    place = tuple(int(v) for v in evidence.index[k])
    if unlike:
        return f"{place} does not match its position"
    window = np.array([evidence.column(name)[0][k] for name in ("window_y", "window_x")])
    step = np.rint(far)
    # in a frame of another position, source and cutout belong to that position
    if step.any() and np.abs(far - step).max() < 0.2 and np.abs(window - step).max() < 0.2:
        own = (np.array(place[1:]) + step.astype(int)) % np.array(evidence.plan.period)
        return f"{place} contains the pattern of ({place[0]}, {int(own[0])}, {int(own[1])})"
    if np.hypot(*window) > np.hypot(*far):
        return (
            f"{place} belongs to another position: its light is displaced by {np.hypot(*window):.1f} px in its cutout"
        )
    return f"the source of {place} is {np.hypot(*far):.2f} px away from its position"


FAULTS = (StageAxesFault(), BacklashFault(), Jitter(), FrameShift(), Strangers())
