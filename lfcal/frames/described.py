"""What a scan plan says of frames that do not say it themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from lfcal.camera import Camera, ScanPlan, Sensor
from lfcal.errors import InputError
from lfcal.frames.cfa import cfa_from
from lfcal.frames.regions import Region
from lfcal.frames.source import FrameInfo, Frames, FrameSource, Noise, Samples
from lfcal.frames.view import SourceView

__all__ = ["DescribedSource", "sensor_noise", "stated_noise"]


def sensor_noise(sensor: Sensor) -> Noise:
    """Return the variance of raw samples as the sensor's description states it: read, quantisation and photon noise."""
    gain = sensor.electrons_per_count
    return Noise((sensor.read_noise_e / gain) ** 2 + 1 / 12, 1 / gain, sensor.black_level)


def stated_noise(camera: Camera) -> Noise | None:
    """Return the variance of raw samples of ``camera``, or None where its noise was assumed and nobody stated it."""
    marks = camera.marks
    if "assumed" in (marks["sensor.read_noise_e"], marks["sensor.full_well_e"]):
        return None
    noise = sensor_noise(camera.sensor)
    # 0 is the default of a description: unless it was measured it states nothing
    unsaid = camera.sensor.black_level == 0 and marks["sensor.black_level"] != "measured"
    return noise._replace(black=None) if unsaid else noise


class DescribedSource(SourceView):
    """Frames with the plan's exposures, and the facts of its sensor, where they do not state their own.

    Only raw samples (integers that have room for the sensor's bit depth) are taken for those of the plan's sensor:
    floats have been through somebody's processing.
    """

    def __init__(self, source: FrameSource, plan: ScanPlan) -> None:
        super().__init__(source)
        self.plan = plan
        self._facts = dict(source.metadata)
        self._filled = _raw(source, plan.camera.sensor) and self._fill(plan.camera)

    def _fill(self, camera: Camera) -> bool:
        """Enter what the frames do not state; return whether their highest value comes from the plan."""
        facts, sensor, noise = self._facts, camera.sensor, stated_noise(camera)
        unsaid = facts.get("bit_depth") is None and facts.get("saturation") is None
        if unsaid:
            facts |= {"bit_depth": sensor.bit_depth, "saturation": sensor.saturated_from}
        if sensor.black_level > 0:  # 0 is the default of a description, so it states nothing
            facts.setdefault("black_level", sensor.black_level)
        place = facts.get("origin")
        if sensor.cfa and not facts.get("cfa") and "channel" not in facts:
            if place is not None:
                facts["cfa"] = cfa_from(sensor.cfa, place)
            elif self.source.shape == sensor.shape:
                facts["cfa"] = sensor.cfa
        if noise is not None:
            facts.setdefault("noise", noise)
        return unsaid

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What frames and plan say together."""
        return self._facts

    def info(self, index: int) -> FrameInfo:
        """Return what is known of frame ``index``, with the plan's exposure where it has none of its own."""
        info = self.source.info(index)
        if info.exposure_s is None and len(info.points) == 1 and info.points[0].z < len(self.plan.exposures):
            return replace(info, exposure_s=self.plan.exposures[info.points[0].z])
        return info

    def repeats(self) -> FrameSource | None:
        """Return the source's repeated frames, as the plan describes them."""
        found = self.source.repeats() if isinstance(self.source, Frames) else None
        return None if found is None else DescribedSource(found, self.plan)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the source's samples; raises `InputError` where they exceed the bit depth that the plan states."""
        if not self._filled:
            found = self.source.samples(index, region)
            return found if found.noise is not None else found._replace(noise=self._facts.get("noise"))
        found = Frames.samples(self, index, region)
        if found.saturated:
            top, largest = self.plan.camera.sensor.max_value, found.values.max()
            if largest > top:
                bits = self._facts["bit_depth"]
                raise InputError.expected(
                    self.info(index).label,
                    f"values up to {top} ({bits} bits, as the plan says)",
                    largest,
                    "shift left-aligned samples down, or correct the bit depth in the plan",
                )
        return found


def _raw(source: FrameSource, sensor: Sensor) -> bool:
    return source.dtype.kind in "iu" and np.iinfo(source.dtype).max >= sensor.max_value
