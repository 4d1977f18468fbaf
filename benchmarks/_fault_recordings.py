"""Recordings of simulated cameras without a fault, and operations from which faults are made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, LensType, ScanPlan, preset
from lfcal.fit.model import Fineness, PlaneModel
from lfcal.fit.setup import Setup, described_effects
from lfcal.psf import PSFMatrix
from lfcal.simulate import simulate_psf

__all__ = ["CAMERAS", "PEAK", "READ", "PutIn", "Recording"]

PEAK, READ, PHOTONS, LAMP = 3000.0, 3.0, 0.2, 0.005
"""Counts of the brightest sample, read noise in counts, variance of photons per count, and flicker of the lamp."""

DEPTH_STEPS = 6
"""Number of depths that represent a plane with focus drift."""

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]


def _r29_like() -> Camera:
    """Return the optics of an R29 with lenslets of less than half the pitch: 26 x 45 positions."""
    camera, pitch = preset("r29"), 15.0 * 5.5
    gap = 5.0 * pitch
    types = tuple(LensType.focused_at(v, gap) for v in (2.0, 3.0, 5.0))
    small = replace(camera.periodic, pitch_um=pitch, gap_um=gap, types=types, clear_um=0.98 * pitch)
    return replace(camera, name="r29-like", lattice=small, sensor=replace(camera.sensor, shape=(400, 400)))


def _plans() -> dict[str, Callable[[], ScanPlan]]:
    return {
        "bench": lambda: ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0, 4.0), cutout=41),
        "r29-like": lambda: ScanPlan.for_camera(_r29_like(), virtual_depths=(3.0, 4.0), cutout=57),
        "lfm_20x05": lambda: ScanPlan.for_camera(preset("lfm_20x05"), depths_um=(-30.0, -15.0)),
        "lfm_60x12": lambda: ScanPlan.for_camera(preset("lfm_60x12"), depths_um=(-4.0, -3.0), cutout=131),
    }


CAMERAS: dict[str, Callable[[], ScanPlan]] = _plans()
"""Scans of two planes by name."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A scan with a camera that agrees with its description."""

    plan: ScanPlan

    @cached_property
    def _light(self) -> F4:
        values = np.asarray(simulate_psf(self.plan, workers=1)[:], np.float32)
        return values * np.float32(PEAK / values.max())

    def light(self) -> F4:
        """Return a copy of the light before noise, in counts."""
        return self._light.copy()

    def noisy(self, light: F4 | F8, seed: int = 0) -> F4:
        """Return the light with the noise of lamp (0.5 %), photons and readout."""
        rng = np.random.default_rng(seed)
        lit = light * (1 + LAMP * rng.standard_normal(light.shape[:3]))[..., None, None]
        spread = np.sqrt(READ**2 + PHOTONS * np.maximum(lit, 0))
        found: F4 = (lit + spread * rng.standard_normal(light.shape)).astype(np.float32)
        return found

    def clean(self) -> F4:
        """Return a new copy of the recording without a fault."""
        return self.noisy(self._light)

    def matrix(self, values: F4) -> PSFMatrix:
        """Return H of values."""
        return PSFMatrix(values, depths=self.plan.depths_um, camera=self.plan.camera, anchor=self.plan.anchor)

    def sensor(self, value: float) -> F4:
        """Return an image of the scanned part of the sensor."""
        _, ny, nx, nt, ns = self.plan.shape
        return np.full((ny + nt - 1, nx + ns - 1), value, np.float32)

    def scaled(self, values: F4, image: F4) -> F4:
        """Return values times an image of the sensor ``(rows, columns)`` under each cutout."""
        return self._under(values, image, np.multiply)

    def added(self, values: F4, image: F4) -> F4:
        """Return values with an image of the sensor ``(rows, columns)`` added under each cutout."""
        return self._under(values, image, np.add)

    def _under(self, values: F4, image: F4, change: np.ufunc) -> F4:
        out = values.copy()
        _, ny, nx, nt, ns = values.shape
        for y in range(ny):
            for x in range(nx):
                change(out[:, y, x], image[y : y + nt, x : x + ns], out=out[:, y, x])
        return out

    def come(self) -> F8:
        """Return the completed fraction of a serpentine scan at each position ``(ny, nx, 1, 1)``."""
        ny, nx = self.plan.period
        found = np.arange(ny * nx, dtype=np.float64).reshape(ny, nx)
        found[1::2] = found[1::2, ::-1].copy()
        return (found / (ny * nx))[..., None, None]

    def grid(self) -> tuple[F8, F8]:
        """Return rows and columns of the positions ``(ny, nx)``, relative to the middle."""
        ny, nx = self.plan.period
        y, x = np.meshgrid(np.arange(ny) - (ny - 1) / 2, np.arange(nx) - (nx - 1) / 2, indexing="ij")
        return y, x

    def displaced(self, dy: F8, dx: F8) -> F4:
        """Return the light with sources of all planes displaced by fields ``(ny, nx)`` (px)."""
        return self._changed(lambda z: self._model(z, self._setup(), dy, dx))

    def deeper(self, z: int, shares: F8) -> F4:
        """Return the light if the relative error of the virtual depth of plane ``z`` is ``shares`` ``(ny, nx)``."""
        camera, planned = self.plan.camera, self.plan.depths_um[z]
        steps = np.rint(shares / max(float(np.ptp(shares)), 1e-12) * (DEPTH_STEPS - 1))
        out = self.light()
        still = np.zeros(self.plan.period)
        for step in np.unique(steps).tolist():
            own = steps == step
            errors = [0.0] * self.plan.shape[0]
            v = camera.virtual_depth(planned)
            errors[z] = camera.depth_of(v * (1 + float(shares[own].mean()))) - planned
            moved = self._model(z, replace(self._setup(), depth_errors_um=tuple(errors)), still, still, own)
            out[z][own] += moved - self._still(z)[own]
        return out

    def with_camera(self, camera: Camera) -> F4:
        """Return the light of the same scan with another camera."""
        still = np.zeros(self.plan.period)
        other = Setup(camera, described_effects(camera), (0.0,) * self.plan.shape[0])
        return self._changed(lambda z: self._model(z, other, still, still))

    def _changed(self, model: Callable[[int], F4]) -> F4:
        # a difference of two results of one engine is added, so that its systematic error cancels
        return np.stack([self._light[z] + model(z) - self._still(z) for z in range(self.plan.shape[0])])

    def _still(self, z: int) -> F4:
        if z not in self._kept:
            still = np.zeros(self.plan.period)
            self._kept[z] = self._model(z, self._setup(), still, still)
        return self._kept[z]

    @cached_property
    def _kept(self) -> dict[int, F4]:
        return {}

    def _setup(self) -> Setup:
        camera = self.plan.camera
        return Setup(camera, described_effects(camera), (0.0,) * self.plan.shape[0])

    @cached_property
    def _counts(self) -> float:
        places = np.array([[0, 0], [n // 2 for n in self.plan.period]], np.intp)
        model = PlaneModel(self._setup(), self.plan, 0, Fineness.coarse).patterns(places, np.zeros((2, 2)))
        light = self._light[0][tuple(places.T)]
        return float((light * model).sum(dtype=np.float64) / np.square(model).sum(dtype=np.float64))

    def _model(self, z: int, setup: Setup, dy: F8, dx: F8, own: NDArray[np.bool_] | None = None) -> F4:
        places = np.argwhere(np.ones(self.plan.period, np.bool_) if own is None else own)
        moved = np.stack([dy[tuple(places.T)], dx[tuple(places.T)]], 1)
        found = PlaneModel(setup, self.plan, z, Fineness.coarse).patterns(places, moved) * np.float32(self._counts)
        return found if own is not None else found.reshape(*self.plan.period, *self.plan.cutout)


PutIn = Callable[[Recording, float], F4]
"""Function that returns the patterns ``(nz, ny, nx, nt, ns)`` of a recording with a fault of a given strength."""
