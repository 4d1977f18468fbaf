"""Simulate a camera: sensor noise, exposure, regions and injected faults, with the light of a renderer."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from lfcal.camera import Camera, StageAxes
from lfcal.devices.errors import DeviceLost, FrameTimeout
from lfcal.devices.protocols import Frame, Point, Rendered, Roi, Setting, TimeSource
from lfcal.devices.simulated._stage import SimStage, VirtualTime
from lfcal.devices.simulated.faults import CAMERA_FAULTS, DeviceFault, FaultSchedule

__all__ = ["AUTOMATIC", "LightPatch", "Renderer", "SimCamera", "SimLight"]

BUMP_UM = (15.0, -15.0, 0.0)
"""Distance that a stage moves when it is bumped during an exposure (µm)."""

SLIP_PX = 3
"""Displacement of a region after a slip (columns)."""
WARM = 60 / 4095
"""Rise of the dark level (fraction of the range)."""
DIMMED = 0.7
CLAMPED = 0.1
"""Fractions that remain of the lamp's light and of the exposure during the faults that reduce them."""

FIXED = {"ExposureAuto": "Off", "GainAuto": "Off", "Gamma": "1"}
AUTOMATIC = {"ExposureAuto": "Continuous", "GainAuto": "Continuous", "Gamma": "2.2"}
"""Settings of the camera, with values that keep samples proportional to light, and with automatic values."""
PEAK = 0.7
"""Level of the brightest pixel with automatic exposure and gain (fraction of the range above black)."""

SPREAD = 64
"""Additional rows and columns of the noise field, so that every row of every frame has a separate part."""


class _Grain(NamedTuple):
    """Position of a frame's noise in the noise field: a row, and a first column, for each row of the frame."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    @classmethod
    def two(cls, draw: int, rows: int) -> tuple[_Grain, _Grain]:
        """Return the positions of read noise and of photon noise, which share no sample of the field.

        Each row uses a separate part of the field. With one part for a whole frame, two of 4096 frames would have
        equal noise, unlike any real sensor. Their dark rows would be equal, and the content guard would treat them as
        one buffer.
        """
        rng = np.random.default_rng(draw)
        first = int(rng.integers(SPREAD))
        other = (first + int(rng.integers(1, SPREAD))) % SPREAD
        shifts, down = rng.integers(0, SPREAD, (2, rows)), np.arange(rows)
        return cls(first + down, shifts[0]), cls(other + down, shifts[1])

    def of(self, field: NDArray[Any], rows: slice, columns: slice) -> NDArray[Any]:
        """Return a part of the frame as a new array from the field's windows ``(rows, shifts, columns)``."""
        return np.asarray(field[self.rows[rows], self.columns[rows], columns])


class LightPatch(NamedTuple):
    """Light on a part of the sensor: its first row and column, and counts above black ``(rows, columns)``."""

    row: int
    column: int
    counts: NDArray[Any]


class Renderer(Protocol):
    """The light of a point source on the sensor.

    A session records the ``optics`` of a renderer that is `Rendered`, and otherwise the name of its class.
    """

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> LightPatch:
        """Return the expected light of a source at (right, down, away) µm; it may extend beyond ``roi``."""
        ...


class SimLight:
    """The simulated lamp."""

    def __init__(self) -> None:
        self.on = True

    def switch(self, on: bool) -> None:
        """Switch the lamp on or off."""
        self.on = on


class SimCamera:
    """A simulated camera.

    The same position and exposure always give the same frame, so that an interrupted session can be compared with an
    uninterrupted one. Further frames without a move have different noise.

    Parameters
    ----------
    description
        Description of the camera: sensor, noise and bit depth.
    axes
        Actual motion of the source by the stage's axes.
    stage, time, light
        The simulated stage, clock and lamp.
    renderer
        The optics.
    automatic
        Settings of `AUTOMATIC` that cannot be switched off. Automatic exposure or gain gives every frame the same
        peak; a gamma makes samples nonlinear.
    seed
        Seed of the noise.
    faults
        Device faults to inject, of the kinds in `CAMERA_FAULTS`.
    """

    name = "simulated camera"

    def __init__(
        self,
        description: Camera,
        axes: StageAxes,
        stage: SimStage,
        time: TimeSource,
        light: SimLight,
        renderer: Renderer,
        *,
        faults: Iterable[DeviceFault] = (),
        automatic: Collection[str] = (),
        seed: int = 0,
    ) -> None:
        self._automatic = frozenset(automatic)
        self._sensor = description.sensor
        self._axes, self._stage, self._time, self._light, self._renderer = axes, stage, time, light, renderer
        self._matrix, self._origin = axes.matrix().tolist(), axes.origin_um
        self.faults = FaultSchedule(faults, CAMERA_FAULTS)
        self._seed = seed
        self._number = 0
        self._asked = self._exposure = 0.01
        self._last: Frame | None = None
        self._before: NDArray[Any] | None = None
        self._lost = False
        self._since_move = (-1, 0)
        self.set_roi(Roi(0, 0, *self._sensor.shape))

    @property
    def waits(self) -> bool:
        """Whether `grab` takes real time."""
        return not isinstance(self._time, VirtualTime)

    @property
    def optics(self) -> str:
        """Method by which the light is computed; a session records it, and real cameras lack this attribute."""
        return self._renderer.optics if isinstance(self._renderer, Rendered) else type(self._renderer).__name__

    @property
    def sensor_shape(self) -> tuple[int, int]:
        """Rows and columns of the sensor."""
        return self._sensor.shape

    @property
    def bit_depth(self) -> int:
        """Bits per sample."""
        return self._sensor.bit_depth

    @property
    def max_value(self) -> int:
        """Sample value of a saturated pixel."""
        return self._sensor.max_value

    def set_exposure(self, seconds: float) -> Setting[float]:
        """Set the exposure in steps of 1 µs, from 10 µs to 60 s."""
        self._check_connected()
        self._asked = min(max(round(seconds * 1e6), 10), 60_000_000) / 1e6
        self._exposure = self._taken(self.faults.pending())
        return Setting(seconds, self._exposure)

    def fixed_settings(self) -> dict[str, Setting[str | None]]:
        """Return exposure mode, gain mode, gamma and gain under the names that GenICam cameras use."""
        wrong = {name: AUTOMATIC[name] for name in self._automatic}
        wanted: dict[str, str | None] = {**FIXED, "Gain": None}
        return {name: Setting(value, wrong.get(name, value or "0")) for name, value in wanted.items()}

    def set_roi(self, roi: Roi) -> Setting[Roi]:
        """Set the region, clipped to the sensor."""
        rows, columns = self._sensor.shape
        row, column = min(max(roi.row, 0), rows - 1), min(max(roi.column, 0), columns - 1)
        actual = Roi(row, column, min(roi.rows, rows - row), min(roi.columns, columns - column))
        self._roi = actual
        sensor = self._sensor
        # noise is drawn once for a region and shifted for each frame, because drawing takes longer than an exposure
        rng = np.random.default_rng((self._seed, actual.row, actual.column, actual.rows, actual.columns))
        shape = (actual.rows + SPREAD, actual.columns + SPREAD)
        normal = rng.standard_normal(shape, np.float32)
        dark = sensor.black_level + normal * np.float32(sensor.read_noise_e / sensor.electrons_per_count)
        dark = np.clip(np.rint(dark), 0, sensor.max_value).astype(np.uint8 if sensor.bit_depth <= 8 else np.uint16)
        # windows as wide as a frame at every shift; views need no memory
        self._normal, self._dark = (sliding_window_view(field, actual.columns, 1) for field in (normal, dark))
        return Setting(roi, actual)

    def grab(self, timeout_s: float) -> Frame:
        """Expose and return a frame; an active fault changes it."""
        active = self.faults.next_call()
        self._lost = self._lost or "vanishes" in active
        self._check_connected()
        if "clock jumps" in active and isinstance(self._time, VirtualTime):
            self._time.jump(-86400.0)
        if "times out" in active:
            self._time.sleep(timeout_s)
            raise FrameTimeout(
                f"simulated camera: no frame in {timeout_s:g} s because of the simulated fault 'times out'; try again"
            )
        if "stale" in active and self._last is not None:
            return self._last
        self._exposure = self._taken(active)
        started = self._time.monotonic()
        self._time.sleep(self._exposure)
        if "bumped" in active:
            self._stage.bump(BUMP_UM)
        data = self._with_faults(self._expose("lamp dims" in active), active)
        self._number += 1
        status = "complete"
        if "incomplete" in active:
            data[data.shape[0] // 2 :] = 0
            status = "half of the packets are missing"
        if "wrong shape" in active:
            data = data[:-1]
        self._last = Frame(data, self._number, self._exposure, started, status)
        return self._last

    def close(self) -> None:
        """Do nothing."""

    def _taken(self, active: frozenset[str]) -> float:
        """Return the actual exposure time (s), which the camera also reports."""
        return round(CLAMPED * self._asked, 6) if "clamps exposure" in active else self._asked

    def _with_faults(self, data: NDArray[Any], active: frozenset[str]) -> NDArray[Any]:
        """Return ``data`` as delivered by a camera with injected faults."""
        before, self._before = self._before, data
        if not active:
            return data
        if before is None or before.shape != data.shape:
            before = data
        if "frozen" in active:
            self._before = before  # so the next frame is affected too
        if "frozen" in active or "repeats" in active:
            data = before
        if "torn" in active:
            half = len(data) // 2
            data = np.concatenate((data[:half], before[half:]))
        if "blank" in active:
            data = self._dark[: data.shape[0], 0].copy()
        if "region slips" in active:
            data = np.roll(data, SLIP_PX, axis=1)
        if "dark level" in active:
            warmer = data + round(WARM * self._sensor.max_value)
            data = np.minimum(warmer, self._sensor.max_value).astype(data.dtype)
        return data

    def _expose(self, dimmed: bool = False) -> NDArray[Any]:
        place = self._stage.true_position()
        # repeated frames without a move differ; the first frame after a move is reproducible
        count = self._since_move[1] + 1 if self._since_move[0] == self._stage.moves else 0
        self._since_move = (self._stage.moves, count)
        key = struct.pack(
            # nanometres and microseconds: rounding errors of the same position must not change the noise
            "<4q2I",
            *(round(v * 1000) for v in place),
            round(self._exposure * 1e6),
            count,
            self._light.on,
        )
        draw = zlib.crc32(key, self._seed)
        grains = _Grain.two(draw, self._roi.rows)
        frame = grains[0].of(self._dark, slice(None), slice(None))
        if self._light.on:
            # plain numbers, because arrays of three are slower
            offset = [p - o for p, o in zip(place, self._origin, strict=True)]
            source = tuple(sum(offset[k] * self._matrix[k][j] for k in range(3)) for j in range(3))
            patch = self._renderer.render((source[0], source[1], source[2]), self._exposure, self._roi)
            if self._automatic:
                patch = patch._replace(counts=self._with_automatic_settings(patch.counts))
            if dimmed:
                patch = patch._replace(counts=patch.counts * np.float32(DIMMED))
            self._add(frame, patch, grains)
        return frame

    def _with_automatic_settings(self, counts: NDArray[Any]) -> NDArray[Any]:
        """Return light changed by the automatic settings: scaled to the same peak, and made nonlinear by gamma."""
        peak = float(counts.max(initial=0.0))
        full = self._sensor.max_value - self._sensor.black_level
        if self._automatic - {"Gamma"} and peak > 0:
            counts = counts * np.float32(PEAK * full / peak)
        if "Gamma" in self._automatic:
            counts = np.float32(full) * np.clip(counts / np.float32(full), 0, 1) ** np.float32(1 / 2.2)
        return np.asarray(counts, np.float32)

    def _add(self, frame: NDArray[Any], patch: LightPatch, grains: tuple[_Grain, _Grain]) -> None:
        """Write the samples for the light of ``patch`` into ``frame``, in place."""
        row, column = patch.row - self._roi.row, patch.column - self._roi.column
        top, left = max(row, 0), max(column, 0)
        bottom = min(row + patch.counts.shape[0], frame.shape[0])
        right = min(column + patch.counts.shape[1], frame.shape[1])
        if bottom <= top or right <= left:
            return
        light = patch.counts[top - row : bottom - row, left - column : right - column]
        # the same random numbers give read and photon noise, so that both are reproducible at a position
        dark, normal = (grain.of(self._normal, slice(top, bottom), slice(left, right)) for grain in grains)
        sensor = self._sensor
        gain = np.float32(1 / sensor.electrons_per_count)
        # round once, as a converter does; rounding twice would lose light below half a count
        total = np.sqrt(light * gain) * normal + light
        total += dark * (np.float32(sensor.read_noise_e) * gain) + np.float32(sensor.black_level)
        np.rint(total, out=total)
        np.clip(total, 0, sensor.max_value, out=total)
        frame[top:bottom, left:right] = total

    def _check_connected(self) -> None:
        if self._lost:
            raise DeviceLost(
                "simulated camera: connection lost because of the simulated fault 'vanishes'; connect again"
            )
