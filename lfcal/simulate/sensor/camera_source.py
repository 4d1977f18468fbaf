"""Frames of a simulated session: the light of the source on the whole sensor, and the response of the sensor."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Position, Region, centre, check_number, check_region, read_text
from lfcal.camera import FORMAT as PLAN_FORMAT
from lfcal.camera import ScanPlan
from lfcal.frames import FrameInfo, FrameMetadata, Frames
from lfcal.frames.sources import FrameOptions, SourceKind
from lfcal.simulate.accuracy import plan_effects
from lfcal.simulate.effects import FiniteSource, FrameEffect, MotionEffect
from lfcal.simulate.engines import Sampling
from lfcal.simulate.plane_task import EffectsLike, budgeted, describe, tolerance_for
from lfcal.simulate.sensor.noise import FrameKind, expose, random_numbers, sample_type, temporal_noise
from lfcal.simulate.sensor.responses import Responses, joined, place, sum_of
from lfcal.simulate.sensor.white import elemental_white, white_light, white_tile

__all__ = ["SOURCE", "SimulatedCamera"]

PROBES = 8
"""Number of positions along each axis at which the brightest pixel is searched for."""

Lit = tuple[int, int, NDArray[np.float32]]
"""First row and column of a patch of light on the sensor, and its photoelectrons."""


class SimulatedCamera(Frames):
    """A `FrameSource` of simulated full sensor frames, one for each position of a scan plan, in scan order.

    With the same parameters, a frame depends only on its index. Frames can therefore be read in any order and from
    several threads. The lenslets are fixed relative to the sensor, and each pattern appears around the point where the
    chief ray of the source meets the sensor. Motion effects displace the source, but the metadata of the frames contain
    the planned positions.

    Parameters
    ----------
    plan
        The scan plan, whose order determines the indices of the frames.
    effects
        As in `simulate_psf`, but ``"auto"`` also selects effects on frames. ``"auto"`` never selects motion effects:
        list them explicitly. Frames are uint16 if `Quantisation` is among the effects, otherwise float32; both are in
        counts.
    level, tolerance, sampling
        As in `simulate_psf`.
    peak
        Signal of the brightest pixel of the session, as a fraction of the full well.
    seed
        Seed of all random numbers; equal seeds produce equal frames.

    Raises
    ------
    InputError
        If ``effects``, ``peak`` or ``seed`` is not valid. For effects that are incompatible with the plan, the error
        may not be raised until the light of a frame is computed.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import SimulatedCamera
    >>> from lfcal.simulate.effects import Quantisation
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> source = SimulatedCamera(plan, (Quantisation(),), level="geometric", peak=0.8)
    >>> frames = [source.read(k) for k in range(len(source))]
    >>> print(max(int(frame.max()) for frame in frames))  # 64 + 0.8 (4095 - 64)
    3289
    """

    def __init__(
        self,
        plan: ScanPlan,
        effects: EffectsLike = "auto",
        *,
        level: str = "auto",
        tolerance: float | None = None,
        sampling: Sampling | None = None,
        peak: float = 0.8,
        seed: int = 0,
    ) -> None:
        check_number("brightest pixel (fraction of the full well)", peak, above=0, at_most=1000)
        check_number("seed", seed, at_least=0, at_most=2**64 - 1, integer=True)
        if effects == "auto":
            effects = plan_effects(plan, tolerance_for(effects, tolerance), frames=True, peak=peak)
        self.plan, self.camera = plan, plan.camera
        self.budget = budgeted(effects, plan, tolerance)
        self.effects = self.budget.effects
        self.level, self.tolerance, self.sampling = level, self.budget.tolerance, sampling
        self.peak, self.seed = peak, seed
        self._frame_effects = [e for e in self.effects if isinstance(e, FrameEffect)]
        self._order = plan.order_indices()
        self._responses = Responses(plan, self.budget, level, sampling)
        self._lock = threading.Lock()
        self._white: NDArray[np.float32] | None = None

    def __reduce__(self) -> Any:
        """Send the inputs to another process, because frames depend only on their index and the seed."""
        chosen: EffectsLike = self.effects
        if self.budget.selection is not None:  # effects that are off do not matter
            chosen = replace(self.budget.selection, rows=tuple(row for row in self.budget.selection.rows if row.on))
        settings: dict[str, Any] = {"level": self.level, "tolerance": self.tolerance, "sampling": self.sampling}
        return partial(SimulatedCamera, self.plan, chosen, **settings, peak=self.peak, seed=self.seed), ()

    # -- frame source ------------------------------------------------------------------------------------
    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of the sensor (px)."""
        return self.camera.sensor.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Data type of the frames: uint16, or float32 without `Quantisation`."""
        return sample_type(self.effects)

    @cached_property
    def metadata(self) -> FrameMetadata:
        """Metadata of the frames: sensor, temporal noise, plan, and the effects, level and seed of the simulation."""
        sensor = self.camera.sensor
        return FrameMetadata(
            cfa=sensor.cfa,
            bit_depth=sensor.bit_depth,
            saturation=sensor.saturated_from,
            black_level=sensor.black_level,
            noise=temporal_noise(self.effects, self.camera),
            plan=self.plan,
            plan_shape=self.plan.shape[:3],
            simulated={"effects": describe(self.effects), "level": self.level, "seed": self.seed},
        )

    def __len__(self) -> int:
        """Return the number of positions."""
        return self.plan.n_positions

    def position(self, index: int) -> Position:
        """Return the planned scan position of frame ``index``."""
        z, y, x = self._order[self._checked(index)].tolist()
        return Position(z, y, x)

    def exposure_s(self, index: int) -> float:
        """Return the exposure time of frame ``index`` (s)."""
        return self.plan.exposures[self.position(index).z]

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index``; its position is the planned one, as a real stage would report."""
        z, y, x = self.position(index)
        label = f"simulated frame {index} (z {z}, y {y}, x {x})"
        return FrameInfo((Position(z, y, x),), exposure_s=self.plan.exposures[z], drift=(0.0, 0.0), label=label)

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index`` in counts, or its ``region`` (row and column slices).

        The whole frame is computed, even for a region.
        """
        frame = self.expose(self.light(index), self.exposure_s(index), FrameKind.LIGHT, index)
        return frame if region is None else np.ascontiguousarray(frame[check_region(region, self.shape)])

    def dark_frame(self, index: int = 0, exposure_s: float | None = None) -> NDArray[np.uint16] | NDArray[np.float32]:
        """Return dark frame ``index`` in counts, exposed for ``exposure_s`` (s). None: as in the first plane."""
        seconds = self.plan.exposures[0] if exposure_s is None else exposure_s
        return self.expose(np.zeros(self.shape, np.float32), seconds, FrameKind.DARK, index)

    def white_frame(self, index: int = 0, level: float = 0.6) -> NDArray[np.uint16] | NDArray[np.float32]:
        """Return white frame ``index`` in counts, exposed as in the first plane.

        The signal of its brightest pixel is about the fraction ``level`` of the full well.
        """
        with self._lock:
            if self._white is None:
                if self.camera.has_lattice:
                    tile = white_tile(self.plan, self.effects)
                    self._white = white_light(self.plan, tile / tile.max(), self.effects)
                else:
                    self._white = elemental_white(self.camera)
        light = self._white * np.float32(level * self.camera.sensor.full_well_e)
        return self.expose(light, self.plan.exposures[0], FrameKind.WHITE, index)

    # -- light -------------------------------------------------------------------------------------------
    def light(self, index: int) -> NDArray[np.float32]:
        """Return the light of frame ``index`` in photoelectrons ``(rows, columns)``, before effects of the sensor."""
        return self._on_sensor(self.patch(index))

    def patch(self, index: int) -> Lit:
        """Return the lit part of `light` of frame ``index``: its first row and column (px), and its photoelectrons.

        The first row and column may be outside the sensor. Most of a large sensor is dark. Processing patches is
        therefore many times faster than processing complete frames.
        """
        z, y, x = self.position(index)
        moved = self.displacement_um(index)
        if any(moved) or self._off_grid or self._responses.at(z).scene.image_map is not None:
            return self._patch(z, self.image_px(index), moved[0])
        row, column, values = joined([self._responses.of_position(z, y, x)])
        return row, column, values * np.float32(self.electrons_per_unit(z))

    def light_of(self, source_um: tuple[float, float, float]) -> NDArray[np.float32]:
        """Return the photoelectrons ``(rows, columns)`` of a source at ``source_um``, which is as in `patch_of`."""
        return self._on_sensor(self.patch_of(source_um))

    def patch_of(self, source_um: tuple[float, float, float]) -> Lit:
        """Return the patch, as in `patch`, of a source at ``source_um``, for the exposure time of the nearest plane.

        Parameters
        ----------
        source_um
            Source position (x, y, z) in object space (µm). The axes x and y point to the right and down from the point
            imaged onto the sensor's centre; z points away from the camera, relative to the working plane.
        """
        right, down, away = source_um
        z = int(np.argmin(np.abs(np.array(self.plan.depths_um) - away)))
        step, (row, column) = self.camera.step_um(away), self.camera.sensor.centre_px
        image = row + down / step, column + right / step
        return self._patch(z, image, away - self.plan.depths_um[z])

    def _patch(self, z: int, image_px: tuple[float, float], depth_error_um: float) -> Lit:
        """Return the patch of a source near plane ``z`` whose paraxial chief ray meets the sensor there."""
        rate = np.float32(self.electrons_per_unit(z))
        windows = self._responses.windows(z, depth_error_um, image_px)
        return joined([(row, column, rate * values) for row, column, values in windows])

    def _on_sensor(self, patch: Lit) -> NDArray[np.float32]:
        """Return a whole frame of photoelectrons; light beyond the sensor is lost."""
        row, column, values = patch
        out = np.zeros(self.shape, np.float32)
        place(out, values, row + centre(values.shape[0]), column + centre(values.shape[1]))
        return out

    def displacement_um(self, index: int) -> tuple[float, float, float]:
        """Return the actual minus the planned source position of frame ``index``, (z, y, x) in object space (µm)."""
        dz, dy, dx = self._displacements[self._checked(index)].tolist()
        return dz, dy, dx

    def image_px(self, index: int) -> tuple[float, float]:
        """Return the sensor position (row, column) of the source's paraxial chief ray in frame ``index`` (px).

        It includes the displacement of the source.
        """
        position, (dz, dy, dx) = self.position(index), self.displacement_um(index)
        right, down, away = self.plan.object_um(position).tolist()
        step = self.camera.step_um(away + dz)
        row, column = self.camera.sensor.centre_px
        return row + (down + dy) / step, column + (right + dx) / step

    def electrons_per_unit(self, z: int) -> float:
        """Return the factor from H to photoelectrons in the plane with index ``z``."""
        return self._rate * self.plan.exposures[z]

    def counts_per_unit(self, z: int) -> float:
        """Return the factor from H to counts above the black level in the plane with index ``z``."""
        return self.electrons_per_unit(z) / self.camera.sensor.electrons_per_count

    # -- workings ----------------------------------------------------------------------------------------
    @cached_property
    def _displacements(self) -> NDArray[np.float64]:
        """True minus commanded positions (z, y, x) ``(n, 3)`` in scan order (µm)."""
        commanded = self.plan.object_um(self._order)[:, ::-1]
        out = np.zeros(commanded.shape)
        for number, effect in enumerate(e for e in self.effects if isinstance(e, MotionEffect)):
            rng = random_numbers(self.seed, FrameKind.MOTION, number)
            out += effect.displace(commanded, self.camera, rng)
        return out

    @cached_property
    def _off_grid(self) -> bool:
        """Whether windows cannot be taken from whole rows: a source of finite size, or resampled steps."""
        return any(isinstance(e, FiniteSource) for e in self.effects) or self.plan.resample_factors != (1.0, 1.0)

    @cached_property
    def _rate(self) -> float:
        """Electrons per unit of H and second, at which the brightest of some positions reaches the peak."""
        ny, nx = self.plan.period
        ys, xs = (np.unique(np.linspace(0, n - 1, PROBES).round().astype(np.intp)) for n in (ny, nx))
        brightest = 0.0
        for z, seconds in enumerate(self.plan.exposures):
            response = self._responses.at(z)
            peaks = response.engine().rows(ys, xs).max(axis=(2, 3))
            y, x = np.unravel_index(int(peaks.argmax()), peaks.shape)
            image = sum_of(response.point(float(ys[y]), float(xs[x])))
            brightest = max(brightest, float(image.max()) * seconds)
        if not brightest > 0:
            raise InputError.expected(
                "simulated light", "some light in the cutout", "none", "check the cutout and the depths"
            )
        return self.peak * self.camera.sensor.full_well_e / brightest

    def expose(
        self, light_e: NDArray[np.float32], seconds: float, kind: FrameKind, index: int
    ) -> NDArray[np.uint16] | NDArray[np.float32]:
        """Return the frame (counts) that the sensor records for ``light_e``, photoelectrons ``(rows, columns)``.

        ``seconds`` is the exposure time (s). ``kind`` and ``index`` determine the random numbers.
        """
        return expose(
            light_e, self.camera, self._frame_effects, exposure_s=seconds, seed=self.seed, kind=kind, index=index
        )

    def _checked(self, index: int) -> int:
        if not 0 <= index < len(self):
            raise InputError.expected("frame index", f"0 to {len(self) - 1}", index, "choose a frame in this range")
        return int(index)


def _open_plan(path: Path, options: FrameOptions) -> SimulatedCamera:
    options.refuse("simulated camera of a plan")
    return SimulatedCamera(ScanPlan.from_json(read_text(path)))


def _is_plan(path: Path) -> bool:
    """Return whether a JSON file claims to be a scan plan."""
    if path.suffix.lower() != ".json" or not path.is_file():
        return False
    with path.open("rb") as file:
        return PLAN_FORMAT.encode() in file.read(4096)


SOURCE = SourceKind("simulated camera", _is_plan, _open_plan)
