"""Compute the response of one depth plane with all its effects: engines for all samples of the light, then filters."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import raise_if_abandoned
from lfcal.camera import ScanPlan
from lfcal.simulate._pupil_scene import AnyScene, PupilScene
from lfcal.simulate._symmetry import mirrored_rows
from lfcal.simulate.accuracy import RETRIES, balanced, finer, settle, step_for
from lfcal.simulate.effects import Effect, LightSample
from lfcal.simulate.engines import Certificate, Displaceable, EnergyError, PlaneEngine, Sampling, engine_for
from lfcal.simulate.staging import filter_kernel, filtered, light_samples, outlook_of, resolve_level, scene_for

__all__ = ["PlaneResponse"]


class PlaneResponse:
    """Responses of one depth plane of a plan, simulated with the given effects.

    Engines are created on demand, one for each wavelength. For `rows`, there is also one for each displaced source
    point, which is freed before the next one is created.

    Parameters
    ----------
    plan, z
        The plan and the index of the plane.
    effects
        Effects on scene, light and response; others are ignored here.
    level, tolerance, sampling
        Level and sampling as in `simulate_psf`; ``tolerance`` is the error allowed for the computation. A given
        sampling is used unchanged. Otherwise, a probe (`lfcal.simulate.accuracy.probe`) determines the sampling of the
        first engine. If more light arrives at a position than was transmitted, the sampling is refined, at most
        ``RETRIES`` times. This response is then computed again; earlier results are kept.
    cutout
        Pixels ``(nt, ns)`` of the cutout. None: those of the plan.
    depth_error_um
        Displacement of the plane away from the camera, relative to the plan (µm).
    on_sensor
        Whether to compute on the sensor's pixels if the plan resamples its frames, as `point` requires. Positions of
        `rows` are then one sensor pixel apart instead of one resampled pixel.

    Attributes
    ----------
    reached
        Relative L1 error of the computation, measured by the probe; for the reference, the expected error. NaN before
        the first engine is made, and if the sampling was given.
    """

    def __init__(
        self,
        plan: ScanPlan,
        z: int,
        effects: Sequence[Effect],
        *,
        level: str = "auto",
        tolerance: float = 0.03,
        sampling: Sampling | None = None,
        cutout: tuple[int, int] | None = None,
        depth_error_um: float = 0.0,
        on_sensor: bool = False,
    ) -> None:
        self.kernel = filter_kernel(effects, plan.camera)
        halo = 0 if self.kernel is None else max(self.kernel.shape) // 2
        scene = scene_for(plan, z, effects, depth_error_um=depth_error_um, on_sensor=on_sensor)
        self.sensor_um = plan.camera.sensor.pixel_um
        window = cutout or plan.cutout
        scene = replace(scene, cutout=(window[0] + 2 * halo, window[1] + 2 * halo))
        self.scene, self.level = resolve_level(scene, level)
        self.cutout, self.halo, self.sampling = window, halo, sampling
        outlook = outlook_of(plan, z)
        self.tolerance, self._escalate = tolerance, level == "auto"
        self.settled, self.reached = sampling, math.nan
        samples = light_samples(effects, outlook)
        # rays do not depend on the wavelength, unless images and foci do
        alike = self.level == "geometric" and _is_achromatic(scene)
        self.samples = merged(samples, scene.wavelength_um) if alike else samples
        self._engines: dict[float, PlaneEngine] = {}
        self._lock = threading.Lock()
        self._freed: list[Certificate] = []

    @property
    def sampling_used(self) -> dict[str, Any] | None:
        """Sampling in use, as plain JSON types; None if none was given and no engine has been created."""
        return None if self.settled is None else asdict(self.settled)

    def record(self) -> dict[str, Any]:
        """Return the name of the ``engine``, its ``sampling`` and its ``grid_side`` as plain JSON types.

        ``grid_side`` is as in `PlaneEngine`, or 0 if no engine has been created; ``engine`` is then the planned one.
        """
        used = next(iter(self._engines.values()), None)
        level = self.level if used is None else used.level
        # the name that the level has in commands
        name = "microscope" if level == "debye" else level
        return {"engine": name, "sampling": self.sampling_used, "grid_side": 0 if used is None else used.grid_side}

    @property
    def runs(self) -> int:
        """Number of engine runs for each response."""
        return len(self.samples)

    @property
    def certificate(self) -> Certificate:
        """Energy balance of all responses so far, over all light samples."""
        parts = [*self._freed, *(engine.certificate for engine in self._engines.values())]
        return Certificate(
            sum(p.responses for p in parts),
            sum(p.energy_in for p in parts),
            sum(p.energy_out for p in parts),
            max((p.worst for p in parts), default=0.0),
        )

    def engine(self, wavelength_um: float | None = None) -> PlaneEngine:
        """Return the engine for ``wavelength_um`` (µm) and the undisplaced source. None: the design wavelength."""
        wave = self.scene.wavelength_um if wavelength_um is None else wavelength_um
        with self._lock:
            if wave not in self._engines:
                self._engines[wave] = self._make_engine(at_wavelength(self.scene, wave))
            return self._engines[wave]

    def adopt(self, other: PlaneResponse) -> None:
        """Use the level and the sampling of ``other`` without another probe; ``other`` is probed now if necessary."""
        other.engine()
        self.level, self.settled, self.reached = other.level, other.settled, other.reached

    def rows(self, ys: ArrayLike, xs: ArrayLike, workers: int | None = None) -> NDArray[np.float32]:
        """Return the responses ``(len(ys), len(xs), nt, ns)`` of the positions in rows ``ys`` and columns ``xs``.

        Positions are integers, which may be outside the period.
        """
        y, x = np.asarray(ys, np.intp), np.asarray(xs, np.intp)
        out = np.zeros((len(y), len(x), *self.cutout), np.float32)
        for _ in self.accumulate(out, y, x, block=max(1, len(y)), workers=workers):
            pass
        return out

    def accumulate(
        self,
        out: NDArray[np.float32],
        ys: NDArray[np.intp],
        xs: NDArray[np.intp],
        *,
        block: int,
        workers: int | None = None,
    ) -> Iterator[int]:
        """Add the responses of `rows` to ``out``, ``block`` rows at a time, and yield the number of rows done.

        Rows are counted once per light sample: `runs` times ``len(ys)`` in total.
        """
        done = 0
        for sample in self.samples:
            engine = self._engine_of(sample)
            order = _pairs_together(engine.scene, ys)
            for start in range(0, len(ys), block):
                raise_if_abandoned()
                part = order[start : start + block]
                engine = self._add(out, part, engine, sample.weight, (ys[part], xs), workers)
                done += part.size
                yield done
            # engines of displaced points are freed here, so that only one is in memory; their certificates are kept
            if engine not in self._engines.values():
                self._freed.append(engine.certificate)

    def _add(
        self,
        out: NDArray[np.float32],
        part: NDArray[np.intp],
        engine: PlaneEngine,
        weight: float,
        places: tuple[NDArray[np.intp], NDArray[np.intp]],
        workers: int | None,
    ) -> PlaneEngine:
        """Add rows ``part``; return the engine that computed them, which is finer if ``engine`` was too coarse."""
        # if one engine run fills consecutive rows, it may write into the result without a copy
        in_order = bool((np.diff(part) == 1).all())
        if self.runs == 1 and self.kernel is None and in_order and out.flags.c_contiguous:
            whole = out[part[0] : part[-1] + 1]
            return self._balanced(engine, lambda e: e.rows(*places, out=whole, workers=workers))[0]
        engine, values = self._balanced(engine, lambda e: e.rows(*places, workers=workers))
        out[part] += np.float32(weight) * self._filter(values)
        return engine

    def _balanced(
        self, engine: PlaneEngine, compute: Callable[[PlaneEngine], NDArray[np.float32]]
    ) -> tuple[PlaneEngine, NDArray[np.float32]]:
        """Return the engine, a finer one if the energy did not balance, and the result of ``compute`` with it."""
        for attempt in range(RETRIES + 1):
            try:
                return engine, compute(engine)
            except EnergyError:
                if self.sampling is not None:
                    raise
                # the sampling of a grid depends on the light's angles: refining it changes nothing
                if self.level in ("reference", "grid") or attempt == RETRIES:
                    balance = f"at most the light that enters the camera, at level {self.level!r}"
                    remedy = "choose another level, or a smaller tolerance"
                    raise EnergyError.expected("simulated light on the sensor", balance, "more light", remedy) from None
                engine = self._finer(engine)
        raise AssertionError  # the last attempt returns or raises

    def _finer(self, engine: PlaneEngine) -> PlaneEngine:
        """Return a finer engine of the same scene, which replaces ``engine``."""
        with self._lock:
            self._freed.append(engine.certificate)
            assert self.settled is not None  # an engine was made with it
            self.settled = finer(self.settled)
            made = self._make_engine(engine.scene)
            self._engines = {wave: made if held is engine else held for wave, held in self._engines.items()}
        return made

    def _engine_of(self, sample: LightSample) -> PlaneEngine:
        if not (sample.rows or sample.columns):
            return self.engine(sample.wavelength_um)
        # offsets displace the source on the sensor's scale; the pixels do not move
        shift = np.array([sample.rows, sample.columns]) * self.sensor_um
        planned = np.zeros((*self.scene.period, 2)) if self.scene.offsets_um is None else self.scene.offsets_um
        undisplaced = self.engine(sample.wavelength_um)
        if isinstance(undisplaced, Displaceable):
            return undisplaced.displaced(planned + shift)
        return self._make_engine(replace(undisplaced.scene, offsets_um=planned + shift))

    def _make_engine(self, scene: AnyScene) -> PlaneEngine:
        if self.sampling is not None:
            return engine_for(scene, self.level, self.sampling)
        if self.settled is not None and isinstance(scene, PupilScene):
            return engine_for(scene, self.level, self.settled)
        if self.settled is not None:  # other wavelengths and source points need the same sampling as the first
            engine, _, self.settled = balanced(scene, self.level, self.settled)
            return engine
        if self.level == "reference":  # the reference is not compared with anything
            step = step_for(scene, self.level, self.tolerance)
            self.settled, self.reached = step.sampling, step.expected
            return engine_for(scene, self.level, self.settled)
        found = settle(scene, self.level, self.tolerance, escalate=self._escalate)
        self.level, self.settled, self.reached = found.level, found.sampling, found.error
        return found.engine

    def point(self, y_px: float, x_px: float) -> list[tuple[int, int, NDArray[np.float32]]]:
        """Return windows ``(row, column, values)`` whose sum is the light of a source.

        The paraxial chief ray of the source meets the sensor at (``y_px``, ``x_px``), in sensor pixels relative to
        position (0, 0). ``row, column`` is the middle pixel of a window, in the same coordinates, and ``values`` are
        ``(nt, ns)``. There is one window for each light sample, a source point and a wavelength.
        """
        out = []
        for sample in self.samples:
            at = self.scene.imaged_um((y_px + sample.rows) * self.sensor_um, (x_px + sample.columns) * self.sensor_um)
            _, values = self._balanced(self.engine(sample.wavelength_um), lambda e, at=at: e.point(*at))  # type: ignore[misc]
            row, column = self.scene.nearest_pixel(*at)
            out.append((row, column, np.float32(sample.weight) * self._filter(values)))
        return out

    def _filter(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        if self.kernel is None:
            return values
        h = self.halo
        return filtered(values, self.kernel)[..., h:-h, h:-h]


def _pairs_together(scene: AnyScene, ys: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return an order of rows in which mirror images are adjacent, because engines compute only one of the two."""
    # neighbouring rows are in one block, because an engine mirrors rows only within a block
    twins = mirrored_rows(scene, ys)
    order = [i for k in range(len(ys)) if k not in twins for i in (k, *(t for t, of in twins.items() if of == k))]
    return np.array(order, np.intp)


def _is_achromatic(scene: AnyScene) -> bool:
    """Return whether rays are the same at all wavelengths."""
    return isinstance(scene, PupilScene) or not (scene.colour_rate or scene.dispersion_um2)


def at_wavelength(scene: AnyScene, wavelength_um: float) -> AnyScene:
    """Return the scene at another wavelength (µm).

    Aberrations keep their path lengths. The image and the lenslets' foci move as `Scene.colour_rate` and
    `Scene.dispersion_um2` specify.
    """
    if isinstance(scene, PupilScene):
        return replace(scene, wavelength_um=wavelength_um)
    scale = scene.wavelength_um / wavelength_um
    # the glass keeps its path length in µm, which is another number of waves
    terms = tuple((n, m, waves * scale) for n, m, waves in scene.wavefront)
    found = replace(
        scene,
        wavelength_um=wavelength_um,
        wavefront=terms,
        lenslet_waves=scene.lenslet_waves * scale,
        type_waves=tuple(waves * scale for waves in scene.type_waves),
    )
    if scene.colour_rate:
        found = found.refocused(scene.colour_rate * (wavelength_um - scene.wavelength_um))
    if scene.dispersion_um2:
        power = 1.0 + scene.dispersion_um2 * (wavelength_um**-2 - scene.wavelength_um**-2)
        types = tuple(replace(kind, focal_length_um=kind.focal_length_um / power) for kind in scene.lattice.types)
        found = replace(found, lattice=replace(found.lattice, types=types))
    return found


def merged(samples: Sequence[LightSample], wavelength_um: float) -> tuple[LightSample, ...]:
    """Return one sample for each source point, at ``wavelength_um``, with the sum of the weights of its wavelengths."""
    weights: dict[tuple[float, float], float] = {}
    for s in samples:
        weights[s.rows, s.columns] = weights.get((s.rows, s.columns), 0.0) + s.weight
    return tuple(LightSample(y, x, wavelength_um, w) for (y, x), w in weights.items())
