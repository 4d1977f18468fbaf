"""A pupil that is partly dark, and a lens type that is out of focus."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.judge._modelled import cut, plane_of
from lfcal.judge._patch import Patch
from lfcal.judge.evidence import Evidence
from lfcal.judge.expected import Behind
from lfcal.judge.fault import Fault, FaultPicture, FoundFault, PutIn, adding
from lfcal.judge.faults._series import SURE
from lfcal.simulate.engines import EnergyError

__all__ = ["FAULTS", "Pupil", "TypeFocus"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

TOLD = 2.5
"""Rms deviation of parts, in units of their errors, above which they are fitted."""

BLOCKS = (11, 11, 21, 41, 83)
"""Number of parts of a cutout along each axis whose light is fitted, in successive iterations. Coarse parts can be
distinguished from displacements, fine ones follow the edge of a shadow."""

LIT = 0.02
"""Fraction of the light of the brightest part above which a part counts."""

UNEVEN = 0.03
"""Scatter of the parts' light above which it is reported."""

DARKEST = 0.02
"""Smallest fraction of the light of a part that can be determined."""

FOLLOWS = 6.0
"""Multiple of the camera's error by which parts may scatter, because displacements compensate for some of it."""

EXPLAINS = 0.3
"""Fraction of the residual of patterns that a dark part of the pupil or a change of the focal length must explain."""

LEFT = 0.02
"""Misfit above which lens types are tried; a smaller one rules out a type that is out of focus."""

STEP = 0.01
"""Relative change of a focal length from which the derivative with respect to it is computed."""

ROUNDS, NEAR = 6, 0.001
"""Largest number of iterations for the change of a focal length, and the step above which another one is needed."""

BLUR = 0.005
"""Change of a focal length above which it is reported."""


class Pupil(Fault):
    """Light is missing in the same part of all patterns of a plane, because the pupil is dark there."""

    name = "pupil"
    title = "partly darkened pupil"
    subject = "optics"
    strong_rank = 8
    rank = 45
    advice = (
        "Look at the depth-plane sums. Free the blades of the iris, remove the obstacle, or centre the "
        "lens. Then record again, or state the vignetting in the camera."
    )
    settles: ClassVar[tuple[str, ...]] = ("centring", "leak", "stage_gain", "pitch")
    explains: ClassVar[tuple[str, ...]] = ("ghost",)

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault, with the direction of the missing light, if the light is uneven over the cutouts."""
        here = now = evidence
        lit = np.ones((evidence.plan.shape[0], *evidence.plan.cutout))
        reported, before = 0.0, _excess(evidence)
        for turn, blocks in enumerate(BLOCKS):
            gains, sigmas = _parts(now, blocks)
            if turn == 0:
                reported = float(np.sqrt(np.square(gains / sigmas).mean()))
                if reported < TOLD:
                    return
            # minus the contribution of chance: small parts have few samples
            sure = np.clip(1 - np.square(sigmas) / np.maximum(np.square(gains), 1e-12), 0, 1)
            lit = np.clip(lit * np.clip(1 + sure * gains, 0.2, 5.0), DARKEST, 2.0)
            now = _seen(here, lit)
            nearer = here.followed(now.values) if turn == 1 else here
            if nearer is not here:  # light missing on one side looked like a displacement
                here, now = nearer, _seen(nearer, lit)
        weight = np.stack([evidence.light[evidence.index[:, 0] == z].sum(0) for z in range(len(lit))]).clip(0)
        scatter = float(np.sqrt((weight * np.square(lit - 1)).sum() / max(float(weight.sum()), 1e-300)))
        # the missing light is part of the camera's error
        if scatter < UNEVEN or scatter > FOLLOWS * math.sqrt(before) or _excess(now) > (1 - EXPLAINS) * before:
            return
        z = int(np.argmax((weight * np.square(lit - 1)).sum((1, 2))))
        image = np.where(weight[z] > LIT * weight[z].max(), lit[z], 1.0)
        y, x = np.indices(image.shape)
        lost = weight[z] * np.clip(1 - image, 0, None)
        if not lost.any():
            return
        light = weight[z] * (image > 0)
        # from the middle of the light to that of the missing light
        down, across = ((lost * k).sum() / lost.sum() - (light * k).sum() / light.sum() for k in (y, x))
        side = np.degrees(np.arctan2(down, across))
        yield FoundFault(
            self,
            f"the light falls to {100 * float(image.min()):.0f} % at an angle of {side:.0f}° in the pattern "
            f"(clockwise from the right); it varies by {100 * scatter:.0f} % (rms)",
            reported,
            scatter / 2,
            picture=FaultPicture(
                100 * lit[z], "%", f"light relative to that of the camera, plane {z}", ("row (px)", "column (px)")
            ),
            repair=adding(evidence.index, now.left - replace(here, values=now.values).left),
            put_in=_shaded(lit),
        )


def _seen(evidence: Evidence, lit: F8) -> Evidence:
    """Return the evidence with models multiplied by the relative brightness ``lit`` ``(nz, nt, ns)``."""
    own = lit[evidence.index[:, 0]].astype(np.float32)
    shaded = replace(evidence, model=evidence.model * own, columns=evidence.columns * own[:, None])
    return shaded.with_data(evidence.data, evidence.valid)


def _shaded(lit: F8) -> PutIn:
    def put_in(patch: Patch) -> F4:
        (t, s), (nt, ns) = patch.inset.tolist(), patch.light.shape[1:]
        own = lit[:, t : t + nt, s : s + ns].astype(np.float32)
        found: F4 = patch.light * own[patch.index[:, 0]]
        return found

    return put_in


def _excess(evidence: Evidence) -> float:
    """Return the power of the residual beyond noise, relative to the power of the light."""
    return evidence.misfit**2


def _parts(evidence: Evidence, blocks: int) -> tuple[F8, F8]:
    """Return the relative deviation of the light of each part of the cutouts ``(nz, nt, ns)``, and its error."""
    shape = (evidence.plan.shape[0], *evidence.plan.cutout)
    gains, sigmas = np.zeros(shape), np.full(shape, np.inf)
    rows, columns = (np.minimum(np.arange(n) * min(blocks, n) // n, blocks - 1) for n in shape[1:])
    where = rows[:, None] * blocks + columns
    for z in np.unique(evidence.index[:, 0]).tolist():
        own = evidence.index[:, 0] == z
        w, v, r = (part[own].astype(np.float64) for part in (evidence.weight, evidence.light, evidence.left))
        by, power, light = (
            np.bincount(where.ravel(), part.sum(0).ravel(), blocks**2) for part in (w * r * v, w * v * v, v)
        )
        good = light > LIT * light.max()
        gain = np.where(good, by / np.maximum(power, 1e-300), 0.0)
        sigma = np.where(good, 1 / np.sqrt(np.maximum(power, 1e-300)), np.inf)
        gains[z], sigmas[z] = gain[where], sigma[where]
    return gains, sigmas


class TypeFocus(Fault):
    """Lenslets of one type whose focal length differs from the stated one."""

    name = "type_focus"
    title = "lens type out of focus"
    subject = "optics"
    strong_rank = 8
    rank = 57
    advice = (
        "Fit the focal lengths (lfcal fit --unknowns focal_lengths), and use the fitted camera. No new "
        "recording is needed."
    )
    settles: ClassVar[tuple[str, ...]] = ("depth",)

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if another focal length of one lens type reduces the residual by the fraction `EXPLAINS`."""
        types = len(evidence.plan.camera.lattice.types)
        if evidence.misfit < LEFT or types < 2:
            return
        try:
            tried = [_change(evidence, kind) for kind in range(types)]
            kind = int(np.argmax([abs(value) / sigma for value, sigma in tried]))
            change, sigma = tried[kind]
            if abs(change) < max(BLUR, SURE * sigma):
                return
            settled = _settled(evidence, kind, change)
        except (InputError, EnergyError):
            return
        if settled is None or settled[2].misfit > (1 - EXPLAINS) * evidence.misfit:
            return
        change, other, _ = settled
        share = float(np.abs(other - evidence.light).sum() / max(float(evidence.light.sum()), 1e-300))
        focal = evidence.plan.camera.lattice.types[kind].focal_length_um
        reported = np.array([100 * value for value, _ in tried])

        def put_in(patch: Patch) -> F4:
            return replace(patch, known=_with_focal(patch.known, kind, change)).moved()

        yield FoundFault(
            self,
            f"type {kind}: focal length {focal * (1 + change):.1f} µm instead of {focal:.1f} µm",
            abs(tried[kind][0]) / sigma,
            share,
            picture=FaultPicture(reported, "%", "focal length relative to that stated", ("lens type",)),
            repair=adding(evidence.index, evidence.light - other),
            put_in=put_in,
        )


def _settled(evidence: Evidence, kind: int, change: float) -> tuple[float, F4, Evidence] | None:
    """Return the change of a type's focal length from a first guess, the light with it, and the corrected evidence.

    The result is None if the first guess explains hardly anything, because the fault is then another one.
    """
    for turn in range(ROUNDS):
        other = _light(evidence, _with_focal(evidence.camera, kind, change))
        moved = evidence.with_data(evidence.data + evidence.light - other, evidence.valid)
        if turn == 0 and moved.misfit > (1 - EXPLAINS / 3) * evidence.misfit:
            return None
        more = _change(moved, kind)[0] if turn + 1 < ROUNDS else 0.0
        if abs(more) < NEAR:
            break
        change += more
    return change, other, moved


def _with_focal(known: Behind, kind: int, change: float) -> Behind:
    camera = known.setup.camera
    types = list(camera.lattice.types)
    types[kind] = replace(types[kind], focal_length_um=types[kind].focal_length_um * (1 + change))
    lattice = replace(camera.periodic, types=tuple(types))
    return replace(known, setup=replace(known.setup, camera=replace(camera, lattice=lattice)))


def _light(evidence: Evidence, known: Behind) -> F4:
    """Return the light ``(n, nt, ns)`` of another camera at the gains and positions of the patterns."""
    out = np.empty_like(evidence.light)
    starts = evidence.starts
    for z in np.unique(evidence.index[:, 0]).tolist():
        own = np.flatnonzero(evidence.index[:, 0] == z)
        plane = plane_of(known, z, float(starts.depth[z]))
        out[own] = cut(plane.patterns(evidence.index[own, 1:], starts.source[own]), starts.window[own])
    return out * evidence.values[:, 0, None, None].astype(np.float32)


def _change(evidence: Evidence, kind: int) -> tuple[float, float]:
    """Return the relative error of the focal length of a type, to first order, and its standard deviation."""
    column = (_light(evidence, _with_focal(evidence.camera, kind, STEP)) - evidence.light) / np.float32(STEP)
    values, sigmas = evidence.beyond(column)
    good = np.isfinite(sigmas)
    if not good.any():
        return 0.0, np.inf
    weight = 1 / np.square(sigmas[good])
    mean = float((weight * values[good]).sum() / weight.sum())
    scatter = 1.4826 * float(np.median(np.abs(values[good] - mean))) / np.sqrt(good.sum())
    return mean, max(scatter, float(1 / np.sqrt(weight.sum())))


FAULTS = (Pupil(), TypeFocus())
