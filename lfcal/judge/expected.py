"""Prediction of the pattern of a source between positions of H: by the camera if it explains H, else by neighbours."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import NoLatticeError, ScanPlan
from lfcal.fit import Fineness, PlaneModel, Setup, described_effects, predict, read_fit
from lfcal.psf import PSFMatrix
from lfcal.simulate.effects import effect_from
from lfcal.simulate.engines import EnergyError

__all__ = ["Behind", "ExpectedPattern", "behind", "fitted_setup", "plan_of"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

EXPLAINS = 0.25
"""Fraction of the light of H (relative L2) that a camera may leave unexplained and still predict changes of H."""

EDGE = 2
"""Number of pixels at each border of a cutout that neighbours up to two positions away do not contain."""


@dataclass(frozen=True, eq=False)
class Behind:
    """The camera of an H, with the fraction of the light of H that it does not explain.

    Attributes
    ----------
    setup, plan
        Camera with effects and depths, and the plan of the scan of H.
    misfit
        Fraction of the light of H that the camera leaves unexplained (relative L2).
    """

    setup: Setup
    plan: ScanPlan
    misfit: float

    @property
    def explains(self) -> bool:
        """Whether ``misfit`` is so small that the camera can predict changes of H."""
        return self.misfit < EXPLAINS


def plan_of(matrix: PSFMatrix) -> ScanPlan | None:
    """Return the plan of the scan of an H; None if H states no camera."""
    if matrix.camera is None:
        return None
    depths = tuple(float(z) for z in matrix.depths)
    return ScanPlan(matrix.camera, matrix.period, matrix.cutout, depths, matrix.anchor)


def fitted_setup(folder: Path, matrix: PSFMatrix) -> Setup:
    """Read the setup that was fitted to H (``matrix``) from ``folder``, the folder of the fit.

    Raises
    ------
    InputError
        If the fit belongs to another scan, or H has no camera with a lattice.
    """
    plan = plan_of(matrix)
    if plan is None:
        raise InputError.expected(
            "H to predict", "an H with its camera", "an H without one", "assemble H with its camera"
        )
    if not plan.camera.has_lattice:
        raise NoLatticeError.of("comparison of H with a fitted camera")
    stored = read_fit(folder)
    stored.check(plan)
    return stored.setup


def behind(matrix: PSFMatrix, index: NDArray[np.intp]) -> Behind | None:
    """Return the camera of an H, compared with its patterns at ``index`` ``(n, 3)``.

    None if H states no camera with a lattice, or if the patterns of that camera cannot be computed.
    """
    try:
        plan = plan_of(matrix)
        # metrics that compare H with its camera know only lattices
        if plan is None or not plan.camera.has_lattice:
            return None
        errors, aside = _depth_errors(matrix.provenance, matrix.shape[0]), _aside(matrix.provenance)
        setup = Setup(plan.camera, _effects(matrix), errors, aside_px=aside)
        light = predict(setup, plan, index, np.zeros((len(index), 2)), Fineness.coarse)
    except (InputError, EnergyError):  # a description that no engine can compute says nothing about H
        return None
    left = power = 0.0
    for (z, y, x), one in zip(index.tolist(), light, strict=True):
        values = np.asarray(matrix[z, y, x], np.float64)
        good = matrix.valid(z, y, x)
        gain = float((values * one)[good].sum() / max(1e-300, float(np.square(one[good], dtype=np.float64).sum())))
        noise = _noise_of(matrix, z, y, x, values) if matrix.facts.noise is not None else 0.0
        left += float((np.square(values - gain * one) - noise)[good].sum())
        power += float(np.square(gain * one, dtype=np.float64)[good].sum())
    return Behind(setup, plan, math.sqrt(max(0.0, left) / power) if power > 0 else math.inf)


def _noise_of(matrix: PSFMatrix, z: int, y: int, x: int, values: F8) -> F8:
    """Return the variance of the samples of a pattern of H; 0 if unknown."""
    known = matrix.facts.noise
    if known is None or not np.isfinite(known[z, y, x]).all():
        return np.zeros_like(values)
    found: F8 = known[z, y, x, 0] + known[z, y, x, 1] * np.maximum(values, 0.0)
    return np.maximum(found, 0.0)


def _effects(matrix: PSFMatrix) -> tuple[Any, ...]:
    """Return the effects with which H was simulated or fitted, or else the effects in its camera's description."""
    assert matrix.camera is not None
    simulated = matrix.provenance.get("simulated")
    said = matrix.provenance.get("effects", simulated.get("effects") if isinstance(simulated, Mapping) else None)
    if not isinstance(said, list) or not said:
        return described_effects(matrix.camera)
    if not all(isinstance(one, Mapping) and isinstance(one.get("name"), str) for one in said):
        raise InputError.expected("effects of H", "a list of named effects", repr(said)[:60], "run lfcal fit again")
    return tuple(effect_from(one["name"], {k: v for k, v in one.items() if k != "name"}) for one in said)


def _depth_errors(provenance: Mapping[str, Any], planes: int) -> tuple[float, ...]:
    fit = provenance.get("fit")
    said = fit.get("depth_errors_um") if isinstance(fit, Mapping) else None
    good = isinstance(said, list) and len(said) == planes and all(isinstance(v, int | float) for v in said)
    return tuple(float(v) for v in said) if good and said is not None else (0.0,) * planes


def _aside(provenance: Mapping[str, Any]) -> tuple[float, float]:
    """Return the common displacement of all sources on the sensor, as stated by a fit of several regions."""
    fit = provenance.get("fit")
    said = fit.get("aside_px") if isinstance(fit, Mapping) else None
    good = isinstance(said, list) and len(said) == 2 and all(isinstance(v, int | float) and abs(v) < 1e3 for v in said)
    return (float(said[0]), float(said[1])) if good and said is not None else (0.0, 0.0)


class ExpectedPattern:
    """The pattern that H predicts for a source near one of its positions.

    Parameters
    ----------
    matrix, z, y, x
        H, and the position in it.
    camera
        The camera of H. If it is None or does not explain H, neighbouring positions of H are interpolated.
    """

    def __init__(self, matrix: PSFMatrix, z: int, y: int, x: int, camera: Behind | None) -> None:
        self.values = np.asarray(matrix[z, y, x], np.float64)
        self.valid = matrix.valid(z, y, x) & np.isfinite(self.values)
        self.noise = _noise_of(matrix, z, y, x, self.values)
        self._model: PlaneModel | None = None
        self._place = np.array([[y, x]], np.intp)
        self._near: dict[tuple[int, int], F8] = {}
        self._unlike = 0.0
        if camera is not None and camera.explains:
            self._misfit = camera.misfit
            self._model = PlaneModel(camera.setup, camera.plan, z, Fineness.fine)
            self._start = self._model.patterns(self._place, np.zeros((1, 2)))[0].astype(np.float64)
            power = float(np.square(self._start[self.valid]).sum())
            self._gain = float((self.values * self._start)[self.valid].sum()) / power
        else:
            self._near = _neighbours(matrix, z, y, x)
            self._unlike = max(self._left_out(axis) for axis in (0, 1))
            self.valid[:EDGE], self.valid[-EDGE:], self.valid[:, :EDGE], self.valid[:, -EDGE:] = (False,) * 4
        self.reach = (0.75, 0.75) if self._model is not None else self._free()

    def _free(self) -> tuple[float, float]:
        """Return the largest displacement of a source along each axis that can be predicted (pixels)."""
        rows, columns = (0.75 if len(self._nodes(axis, 1)) == 3 else 0.0 for axis in (0, 1))
        return rows, columns

    def at(self, offset: F8) -> F8:
        """Return the pattern ``(nt, ns)`` of a source displaced from the position by ``offset`` (dy, dx) pixels."""
        return self._both(offset)[0]

    def doubt(self, offset: F8) -> float:
        """Return the uncertainty of the pattern predicted at ``offset``, as a fraction of the light (relative L2)."""
        return self._both(offset)[1]

    def _both(self, offset: F8) -> tuple[F8, float]:
        size = math.sqrt(float(np.square(self.values[self.valid]).sum()))
        if self._model is not None:
            moved = self._model.patterns(self._place, offset[None, :])[0] - self._start
            change = self._gain * moved
            return self.values + change, self._misfit * _norm(change, self.valid) / size
        away = np.minimum(np.abs(offset), 1.0)
        return self._interpolated(offset), 1.2 * self._unlike * float(np.hypot(*(away * (1.0 - away))))

    def _nodes(self, axis: int, order: int) -> list[int]:
        """Return the relative positions along an axis that were recorded without a gap."""
        found = [0]
        for sign in (-1, 1):
            for k in range(1, order + 1):
                if ((sign * k, 0) if axis == 0 else (0, sign * k)) not in self._near:
                    break
                found.append(sign * k)
        return sorted(found)

    def _left_out(self, axis: int) -> float:
        """Return the relative difference between a pattern and its prediction from its neighbours along an axis.

        Spots are as sharp as pixels, so that a step of one position is too long for an exact interpolation.
        """
        nodes = [k for k in self._nodes(axis, EDGE) if k]
        if not nodes:
            return 0.0
        weights = _lagrange(nodes, 0.0)
        off = self.values - sum(w * self._near[(k, 0) if axis == 0 else (0, k)] for k, w in weights.items())
        noise = float(((1.0 + sum(w * w for w in weights.values())) * self.noise)[self.valid].sum())
        squares = float(np.square(off[self.valid]).sum()) - noise
        return math.sqrt(max(0.0, squares)) / max(1e-300, _norm(self.values, self.valid))

    def _interpolated(self, offset: F8) -> F8:
        nodes = [self._nodes(axis, EDGE) for axis in (0, 1)]
        rows, columns = (_lagrange(nodes[axis], float(offset[axis])) for axis in (0, 1))
        out = np.zeros_like(self.values)
        total = 0.0
        for a, p in rows.items():
            for b, q in columns.items():
                near = self.values if (a, b) == (0, 0) else self._near.get((a, b))
                if near is not None:
                    out += p * q * near
                    total += p * q
        return out / total if total > 0 else self.values


def _norm(values: F8, valid: NDArray[np.bool_]) -> float:
    return math.sqrt(float(np.square(values[valid]).sum()))


def _neighbours(matrix: PSFMatrix, z: int, y: int, x: int) -> dict[tuple[int, int], F8]:
    """Return the recorded patterns of positions up to two away, each in the cutout of this position."""
    ny, nx = matrix.period
    found = {}
    for a in range(-EDGE, EDGE + 1):
        for b in range(-EDGE, EDGE + 1):
            at = (y + a) % ny, (x + b) % nx
            if (a, b) == (0, 0) or matrix.recorded[z, *at] == 0:
                continue
            # its cutout is (a, b) farther; pixels that enter at the border are not used
            found[a, b] = np.roll(np.asarray(matrix[z, *at], np.float64), (a, b), (0, 1))
    return found


def _lagrange(nodes: list[int], at: float) -> dict[int, float]:
    return {k: math.prod((at - j) / (k - j) for j in nodes if j != k) for k in nodes}
