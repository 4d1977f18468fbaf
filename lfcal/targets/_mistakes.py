"""Find deviations of a target from its description."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Finding
from lfcal.camera import Camera
from lfcal.targets._pose_fit import PoseFit
from lfcal.targets._spots import Spots
from lfcal.targets.images import HoleImages
from lfcal.targets.target import Target

__all__ = ["KINDS", "mistakes_of"]

Index = NDArray[np.intp]

KINDS = ("missing row", "missing column", "missing holes", "bright", "dim", "displaced", "pitch")

BRIGHT, DIM = 1.8, 0.5
"""Light, relative to the median hole, above which a hole is reported as bright, and below which as dim."""

SURE = 5.0
"""Number of standard deviations above which a deviation is reported."""

BESIDE_PX = 0.5
"""Smallest reported displacement of a hole, because the centroid of its light differs from the chief ray."""

PITCH = 0.01
"""Smallest reported relative error of a pitch, because magnifications are not known better."""


REMEDIES = {
    "missing row": "Check the target's description and its light.",
    "missing column": "Check the target's description and its light.",
    "missing holes": "Clean the target, or exclude these holes.",
    "bright": "Exclude these holes, or replace the target.",
    "dim": "Clean the target.",
    "displaced": "Clean the target, or exclude these holes.",
    "pitch": "Measure the pitch and describe the target again.",
}
"""Remedy for each kind of deviation."""


def _mistake(kind: str, detail: str, holes: tuple[tuple[int, int], ...] = ()) -> Finding:
    """Return a finding on the holes (row, column) of a target."""
    return Finding(
        kind=kind, what=kind, subject="target", detail=detail, positions=holes, remedy=REMEDIES[kind], merit="fair"
    )


def mistakes_of(
    target: Target, fit: PoseFit, images: HoleImages, found: Index, spots: Spots, seen: tuple[Camera, float, float]
) -> tuple[Finding, ...]:
    """Return findings on the deviations of a target from its description.

    Parameters
    ----------
    target
        The target as described, at its planned pose.
    fit, images
        The fitted pose of the target, and the images of all its holes.
    found
        Index ``(n,)`` in ``images`` of the hole of each spot.
    spots
        The detected points.
    seen
        The camera, the step of a pixel in object space (µm), and the half width of a pattern (pixels).
    """
    camera, step_um, radius = seen
    margin = radius + 1.5
    inside = (images.pixels >= margin) & (images.pixels <= np.array(camera.sensor.shape) - 1 - margin)
    there: NDArray[np.bool_] = np.array(inside.all(1))
    there[found] = True
    shown = np.zeros(len(images), np.bool_)
    shown[found] = True
    return (
        *_missing(images.holes, there, shown),
        *_uneven(images.holes[found], spots.light),
        *_displaced(images.holes[found], spots.pixels - images.pixels[found], fit),
        *_pitch(target, fit, camera, step_um),
    )


def _missing(holes: Index, there: NDArray[np.bool_], shown: NDArray[np.bool_]) -> list[Finding]:
    """Return findings on rows, columns and single holes that should be visible and are not."""
    gone = there & ~shown
    out = []
    for axis, name in enumerate(("row", "column")):
        for k in np.unique(holes[gone, axis]).tolist():
            own = there & (holes[:, axis] == k)
            if own.sum() > 1 and not (own & shown).any():
                lost = _tuples(holes[own])
                out.append(
                    _mistake(f"missing {name}", f"{name} {k} is missing: no light from its {len(lost)} holes", lost)
                )
                gone &= ~own
    if gone.any():
        lost = _tuples(holes[gone])
        out.append(_mistake("missing holes", f"no light of {_words(lost)}", lost))
    return out


def _uneven(holes: Index, light: NDArray[np.float64]) -> list[Finding]:
    """Return findings on holes much brighter or dimmer than others; bright neighbours are reported together."""
    share = light / np.median(light)
    out = []
    bright = np.flatnonzero(share > BRIGHT)
    left = set(bright.tolist())
    while left:
        group = [left.pop()]
        for k in group:
            near = [j for j in left if np.abs(holes[j] - holes[k]).max() <= 1]
            left -= set(near)
            group += near
        own = _tuples(holes[sorted(group)])
        most = float(share[group].max())
        what = "neighbours" if len(own) > 1 else "a hole"
        says = f"{_words(own)}, {what}, up to {most:.1f} times as bright as others, and with brighter tails"
        out.append(_mistake("bright", says, own))
    dim = np.flatnonzero(share < DIM)
    if len(dim):
        own = _tuples(holes[dim])
        least = float(share[dim].min())
        out.append(
            _mistake(
                "dim",
                f"{_words(own)} with only {100 * least:.0f} % of the light of others: dirty or partly closed",
                own,
            )
        )
    return out


def _displaced(holes: Index, away: NDArray[np.float64], fit: PoseFit) -> list[Finding]:
    off = np.linalg.norm(away, axis=1)
    far = np.flatnonzero(off > max(BESIDE_PX, SURE * fit.rms_px))
    if not len(far):
        return []
    own = _tuples(holes[far])
    return [
        _mistake(
            "displaced", f"{_words(own)} up to {off[far].max():.1f} px away from the lattice: doubled or dirty", own
        )
    ]


def _pitch(target: Target, fit: PoseFit, camera: Camera, step_um: float) -> list[Finding]:
    """Return the finding on a pitch that differs from its description, unless an error of the distance explains it."""
    del camera, step_um
    if target.kind == "point":
        return []
    wrong = []
    names = ("rows", "holes in a row")
    several = [n > 1 for n in target.shape]
    for name, scale, sigma, seen in zip(names, fit.scale, fit.scale_sigma, several, strict=True):
        if seen and abs(scale - 1) > max(PITCH, SURE * sigma):
            wrong.append((name, scale))
    if not wrong:
        return []
    words = " and ".join(
        f"{name} {100 * abs(s - 1):.1f} % {'farther apart' if s > 1 else 'closer'}" for name, s in wrong
    )
    remedy = ", or the target is nearer or farther away" if len(wrong) == sum(several) else ""
    return [_mistake("pitch", f"{words} than described: the pitch differs{remedy}")]


def _tuples(holes: Index) -> tuple[tuple[int, int], ...]:
    return tuple((int(r), int(c)) for r, c in holes.tolist())


def _words(holes: tuple[tuple[int, int], ...], most: int = 4) -> str:
    shown = ", ".join(f"({r}, {c})" for r, c in holes[:most])
    more = f" and {len(holes) - most} more" if len(holes) > most else ""
    return f"hole{'s' if len(holes) > 1 else ''} (row, column) {shown}{more}"
