"""Exposure times and sensor values that a scan plan adds to frames that do not state them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfcal.base import InputError, Region
from lfcal.camera import Camera, ScanPlan, Sensor
from lfcal.frames.cfa import cfa_from
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, FrameSource, Noise, Samples
from lfcal.frames.view import SourceView

__all__ = ["DescribedSource", "sensor_noise", "stated_noise"]


def sensor_noise(sensor: Sensor) -> Noise:
    """Return the noise of raw samples from the sensor's description: read noise, quantisation noise and shot noise."""
    gain = sensor.electrons_per_count
    return Noise((sensor.read_noise_e / gain) ** 2 + 1 / 12, 1 / gain, sensor.black_level)


def stated_noise(camera: Camera) -> Noise | None:
    """Return the noise of raw samples of ``camera``; None if its read noise or full well is only assumed.

    A black level of 0 that was not measured is treated as unknown.
    """
    marks = camera.marks
    if "assumed" in (marks["sensor.read_noise_e"], marks["sensor.full_well_e"]):
        return None
    noise = sensor_noise(camera.sensor)
    # 0 is the default of a description: unless it was measured, it means unknown
    unsaid = camera.sensor.black_level == 0 and marks["sensor.black_level"] != "measured"
    return noise._replace(black=None) if unsaid else noise


class DescribedSource(SourceView):
    """View of a source that adds the exposure times and sensor values of the plan where the frames state none.

    Sensor values (bit depth, saturation, black level, colour filter pattern and noise) are added only to raw samples.
    Raw samples are integers with enough bits for the sensor's bit depth. Floating-point frames are assumed to have been
    processed.
    """

    def __init__(self, source: FrameSource, plan: ScanPlan) -> None:
        super().__init__(source)
        self.plan = plan
        self._raw = _raw(source, plan.camera.sensor)
        # whether the plan states their highest value
        self._filled = self._raw and self.known.bit_depth is None and self.known.saturation is None

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known``, completed from the plan."""
        if not self._raw:
            return known
        sensor = self.plan.camera.sensor
        if self._filled:
            known = replace(known, bit_depth=sensor.bit_depth, saturation=sensor.saturated_from)
        if known.black_level is None and sensor.black_level > 0:  # 0 is the default of a description: it means unknown
            known = replace(known, black_level=sensor.black_level)
        if sensor.cfa and not known.cfa and not known.channel:
            if known.origin is not None:
                known = replace(known, cfa=cfa_from(sensor.cfa, known.origin))
            elif self.source.shape == sensor.shape:
                known = replace(known, cfa=sensor.cfa)
        return known if known.noise is not None else replace(known, noise=stated_noise(self.plan.camera))

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index``.

        If the frame shows a single position and states no exposure time, that of its plane in the plan is added.
        """
        info = self.source.info(index)
        if info.exposure_s is None and len(info.points) == 1 and info.points[0].z < len(self.plan.exposures):
            return replace(info, exposure_s=self.plan.exposures[info.points[0].z])
        return info

    def repeats(self) -> FrameSource | None:
        """Return the repeated frames of the source, completed from the plan; None if it has none."""
        found = self.source.repeats() if isinstance(self.source, Frames) else None
        return None if found is None else DescribedSource(found, self.plan)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of frame ``index``, or only those in ``region``.

        Raises
        ------
        InputError
            If the bit depth comes from the plan, and a sample exceeds its highest value.
        """
        if not self._filled:
            found = self.source.samples(index, region)
            return found if found.noise is not None else found._replace(noise=self.metadata.noise)
        found = Frames.samples(self, index, region)
        if found.saturated:
            top, largest = self.plan.camera.sensor.max_value, found.values.max()
            if largest > top:
                bits = self.metadata.bit_depth
                raise InputError.expected(
                    self.info(index).label,
                    f"values up to {top} ({bits} bits, as the plan says)",
                    largest,
                    "shift left-aligned samples down, or correct the bit depth in the plan",
                )
        return found


def _raw(source: FrameSource, sensor: Sensor) -> bool:
    return source.dtype.kind in "iu" and np.iinfo(source.dtype).max >= sensor.max_value
