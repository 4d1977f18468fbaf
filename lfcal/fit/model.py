"""Predict patterns of a setup anywhere in the period, with a displacement of each source."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, for_each_chunk, worker_count
from lfcal.camera import Camera, ScanPlan
from lfcal.fit.setup import Setup
from lfcal.psf import Facts, Header, Plane, PlaneSource, Reopening, Stored, Zeros
from lfcal.simulate import (
    AnyScene,
    PlaneResponse,
    PupilScene,
    Sampling,
    at_wavelength,
    effects_from_records,
    effects_to_records,
    filtered,
    resolve_level,
    scene_for,
)
from lfcal.simulate.accuracy import grid_margin, step_for
from lfcal.simulate.engines import Displaceable, PlaneEngine, engine_for

__all__ = ["LEVEL", "Fineness", "ModelPlanes", "PlaneModel", "predict"]

LEVEL = "grid"
"""Level at which patterns are computed: all lenslets coherent, with exact angles, and smooth in every unknown."""

REACH_PX = 1.0
"""Displacement of sources up to which tables stay valid (pixels)."""


class Fineness:
    """Samplings used in the stages of a fit (samples of the grid per pixel).

    For the bench camera, patterns differ from the coherent reference by 0.4 % (relative L2) with 4 samples, by 0.1 %
    with 6, and by 0.06 % with 8.
    """

    coarse = Sampling(4.0)
    fine = Sampling(6.0)
    finest = Sampling(8.0)


LIGHT_OUTSIDE = {Fineness.coarse: 0.015, Fineness.fine: 0.006, Fineness.finest: 0.003}
"""Fraction of light allowed outside a grid's margin; coarse patterns of a main lens use the default margin."""


PUPIL_ERROR = {Fineness.coarse: 0.05, Fineness.fine: 0.02, Fineness.finest: 0.01}
"""Error (relative L1) of complete patterns behind single lenslets; see `_elemental` for the patterns of a fit."""


class PlaneModel:
    """Model of the patterns of one depth plane of a setup, with tables that are computed once.

    Parameters
    ----------
    setup, planned, z
        The setup to compute, the scan as planned, and the index of the plane.
    sampling
        Sampling, usually one of `Fineness`.
    """

    def __init__(self, setup: Setup, planned: ScanPlan, z: int, sampling: Sampling) -> None:
        plan = setup.plan(planned)
        further = setup.depth_errors_um[z]
        self._level = LEVEL if plan.camera.has_lattice else "wave"
        response = PlaneResponse(plan, z, setup.effects, level=self._level, sampling=sampling, depth_error_um=further)
        self._samples, self._kernel = response.samples, response.kernel
        # the same margin with and without a filter, because another grid would have another error
        self._halo = max(response.halo, 1)
        rows, columns = plan.cutout
        scene, self._sampling = _resolved(plan, z, setup, sampling)
        scene = replace(scene, cutout=(rows + 2 * self._halo, columns + 2 * self._halo))
        if not isinstance(scene, PupilScene):
            margin = grid_margin(scene, LIGHT_OUTSIDE.get(sampling, 1.0))
            self._sampling = replace(sampling, margin_px=max(sampling.margin_px, margin))
        self._pixel = scene.pixel_um
        self._planned = np.zeros((*scene.period, 2)) if scene.offsets_um is None else np.array(scene.offsets_um)
        self._middle = (np.array(scene.period) - 1) / 2
        self._scale, self._aside = setup.stage_scale, np.array(setup.aside_px) + setup.drift_px(plan.depths_um[z])
        source = max(max(abs(s.rows), abs(s.columns)) for s in self._samples)
        self._reach = (REACH_PX + source) * self._pixel
        self._engines: dict[float, PlaneEngine] = {}
        # the table of the array is made for displaced sources from the start
        self._scene = replace(scene, offsets_um=self._planned + self._reach)

    def patterns(self, places: NDArray[np.intp], offsets_px: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the patterns ``(n, nt, ns)`` of sources displaced from the positions ``places`` ``(n, 2)`` (y, x).

        ``offsets_px`` ``(n, 2)`` are the displacements (dy, dx) of the sources in pixels on the sensor, in addition to
        those of the stage in the setup. Values are fractions of the light that passes the iris.
        """
        moved = offsets_px + self._aside + self._scale * (places - self._middle)
        layers = list(_once_each(places))
        if len(layers) == len(self._samples) == 1:  # without copies
            (only,) = self._samples
            out = self._run(only.wavelength_um, places, moved + np.array([only.rows, only.columns]))
            out *= np.float32(only.weight)
        else:
            out = np.zeros((len(places), *self._scene.cutout), np.float32)
            for layer, sample in product(layers, self._samples):
                at = moved[layer] + np.array([sample.rows, sample.columns])
                out[layer] += np.float32(sample.weight) * self._run(sample.wavelength_um, places[layer], at)
        h = self._halo
        whole = out if self._kernel is None else filtered(out, self._kernel)
        return np.ascontiguousarray(whole[:, h:-h, h:-h])

    def _run(self, wave: float, places: NDArray[np.intp], moved_px: NDArray[np.float64]) -> NDArray[np.float32]:
        if wave not in self._engines:
            self._engines[wave] = engine_for(at_wavelength(self._scene, wave), self._level, self._sampling)
        engine = self._engines[wave]
        offsets = self._planned.copy()
        offsets[places[:, 0], places[:, 1]] += moved_px * self._pixel
        if isinstance(engine, Displaceable):
            engine = engine.displaced(offsets)
        else:
            engine = engine_for(replace(engine.scene, offsets_um=offsets), self._level, self._sampling)
        out = np.empty((len(places), *self._scene.cutout), np.float32)
        for y in np.unique(places[:, 0]).tolist():
            own = np.flatnonzero(places[:, 0] == y)
            out[own] = engine.rows([y], places[own, 1], workers=1)[0]
        return out


def _resolved(plan: ScanPlan, z: int, setup: Setup, sampling: Sampling) -> tuple[AnyScene, Sampling]:
    """Return the scene of a plane and the sampling of its engine; for single lenslets, it is set by `PUPIL_ERROR`."""
    scene = scene_for(plan, z, setup.effects, depth_error_um=setup.depth_errors_um[z])
    if isinstance(scene, PupilScene):
        return scene, step_for(scene, "wave", PUPIL_ERROR.get(sampling, 0.01)).sampling
    return resolve_level(scene, LEVEL)[0], sampling


def _once_each(places: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    """Yield subsets of ``places`` in which no position occurs twice."""
    left = np.arange(len(places))
    while left.size:
        _, first = np.unique(places[left], axis=0, return_index=True)
        yield left[np.sort(first)]
        left = np.delete(left, first)


def predict(
    setup: Setup,
    planned: ScanPlan,
    index: NDArray[np.intp],
    offsets_px: NDArray[np.float64],
    sampling: Sampling,
) -> NDArray[np.float32]:
    """Return the patterns ``(n, nt, ns)`` of sources displaced from the positions ``index`` ``(n, 3)`` (z, y, x).

    ``setup``, ``planned`` and ``sampling`` are as in `PlaneModel`. ``offsets_px`` ``(n, 2)`` are the displacements
    (dy, dx) of the sources in pixels on the sensor, in addition to those of the stage in the setup. Values are
    fractions of the light that passes the iris.
    """
    out = np.empty((len(index), *planned.cutout), np.float32)
    for z in np.unique(index[:, 0]).tolist():
        own = np.flatnonzero(index[:, 0] == z)
        out[own] = PlaneModel(setup, planned, z, sampling).patterns(index[own, 1:], offsets_px[own])
    return out


class ModelPlanes(PlaneSource):
    """The planes of H of a setup, with the patterns of all positions, without noise.

    Parameters
    ----------
    header
        Header of H, without its values.
    setup, planned
        The setup to compute, and the scan as planned.
    gains
        Factor for the patterns of each plane ``(nz,)``.
    sampling
        Sampling, usually one of `Fineness`.

    Raises
    ------
    InputError
        If H is computed in work units, and an effect of the setup cannot be found by its name.
    """

    def __init__(
        self,
        header: Header,
        setup: Setup,
        planned: ScanPlan,
        gains: Sequence[float],
        sampling: Sampling = Fineness.finest,
    ) -> None:
        self.header, self.setup, self.planned, self.gains = header, setup, planned, tuple(gains)
        self.sampling = sampling

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Compute plane ``z``; progress counts the rows of this plane if ``alone``, otherwise those of all planes."""
        nz, ny, nx = self.planned.shape[:3]
        clock, before = (Clock(f"model plane {z}", ny), 0) if alone else (Clock("model", nz * ny), z * ny)
        count, gain = worker_count(workers), np.float32(self.gains[z])
        yield clock.at(before)
        values, plane = zeros(), PlaneModel(self.setup, self.planned, z, self.sampling)

        def rows(start: int, stop: int) -> None:
            for y in range(start, stop):
                places = np.stack([np.full(nx, y), np.arange(nx)], axis=1)
                values[y] = gain * plane.patterns(places, np.zeros((nx, 2)))

        for first in range(0, ny, count):
            last = min(ny, first + count)
            for_each_chunk(lambda a, b, at=first: rows(at + a, at + b), last - first, count)  # type: ignore[misc]
            yield clock.at(before + last)
        return Plane(values, Facts.of(self.planned.period, self.planned.cutout))

    def reopening(self, z: int, stored: Stored) -> Reopening:
        """Return setup, scan and gains as plain JSON types, and the name of the function that reads them."""
        setup = self.setup
        values = {
            "camera": setup.camera.to_dict(),
            "effects": effects_to_records(setup.effects),
            "depth_errors_um": setup.depth_errors_um,
            "aside_px": setup.aside_px,
            "plan": self.planned.to_dict(),
            "gains": self.gains,
            "sampling": asdict(self.sampling),
        }
        return Reopening(f"{__name__}:{open_model.__name__}", values)

    def named(self, out: Path) -> str:
        """Return the title of a run of units that writes ``out``, for messages."""
        return f"H of the fitted camera, {out.name}"


def open_model(values: Mapping[str, Any], workers: int) -> ModelPlanes:
    """Return the planes of a model from ``values`` of `ModelPlanes.reopening`; ``workers`` is not used."""
    planned = ScanPlan.from_dict(values["plan"])
    rows, columns = values["aside_px"]
    setup = Setup(
        Camera.from_dict(values["camera"]),
        effects_from_records(values["effects"]),
        tuple(values["depth_errors_um"]),
        aside_px=(rows, columns),
    )
    header, sampling = Header(planned.shape, planned.depths_um), Sampling(**values["sampling"])
    return ModelPlanes(header, setup, planned, values["gains"], sampling)
