"""One colour of a scan that was recorded with a colour filter: its own positions, plan and camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import NDArray

from lfcal.base import InputError, Position
from lfcal.camera import ScanPlan
from lfcal.frames.cfa import channel_names, channel_phase, pattern_side
from lfcal.frames.regions import Region
from lfcal.frames.source import FrameInfo, FrameMetadata, FrameSource, Samples
from lfcal.frames.view import SourceView

__all__ = ["ColourScan", "ThinnedSource", "colour_scan", "colours_of"]


@dataclass(frozen=True)
class ColourScan:
    """The part of a scan that a colour filter's channel sees in steps of its own pixels.

    Attributes
    ----------
    channel
        Name of the channel.
    plan
        Its plan: a camera with larger pixels, fewer positions, a smaller cutout.
    first
        First row and column of positions of the whole scan that belong to it; then every ``step``-th.
    step
        Side of the filter's pattern (pixels).
    """

    channel: str
    plan: ScanPlan
    first: tuple[int, int]
    step: int


def colours_of(source: FrameSource, plan: ScanPlan) -> tuple[str, ...]:
    """Return the channels that the frames have, empty for monochrome ones: by what they say, else the plan's sensor."""
    return channel_names(_filter(source, plan))


def _filter(source: FrameSource, plan: ScanPlan) -> str:
    sensor = plan.camera.sensor
    return source.metadata.cfa or (sensor.cfa if source.shape == sensor.shape else "")


def colour_scan(source: FrameSource, plan: ScanPlan, channel: str) -> ColourScan | None:
    """Return what ``channel`` has of a scan of the whole mosaic; None where the plan is that of the channel already.

    One step of a source whose image moves by one pixel of the mosaic is half a pixel of a Bayer channel. H needs whole
    steps, so each channel takes those positions whose image lies on a pixel of its own: a quarter of them. After one
    cell of the lenslet array the pattern of light comes back, but on the same colour only if the cell is an even number
    of pixels; else two cells have to be scanned.

    Raises
    ------
    InputError
        If there is no such channel, the period is no multiple of the filter's pattern, or the plan resamples.
    """
    cfa = _filter(source, plan)
    phase, step = channel_phase(cfa, channel), pattern_side(cfa)
    if source.shape != plan.camera.sensor.shape:
        return None
    if plan.resample:
        raise InputError.expected(
            f"plan for channel {channel}", "sensor pixels", "resampled ones", "make the plan without --resample"
        )
    if any(n % step for n in plan.period):
        raise InputError.expected(
            f"period of channel {channel}",
            f"a multiple of {step} pixels, the filter's pattern",
            f"{plan.period[0]} x {plan.period[1]}",
            f"scan {step} cells along the odd side: only there the light comes back on the same colour",
        )
    # the first positions whose image lies nearest to a pixel of the colour
    first = [round(r0 - a) % step for r0, a in zip(phase, plan.anchor, strict=True)]
    anchor = tuple((a + o - r0) / step for a, o, r0 in zip(plan.anchor, first, phase, strict=True))
    small = replace(
        plan,
        camera=_camera(plan, phase, step),
        period=(plan.period[0] // step, plan.period[1] // step),
        cutout=(_odd(plan.cutout[0], step), _odd(plan.cutout[1], step)),
        anchor=(anchor[0], anchor[1]),
    )
    return ColourScan(channel, small, (first[0], first[1]), step)


def _odd(n: int, step: int) -> int:
    """Return the odd number of the channel's pixels that covers ``n`` pixels."""
    return -(-n // step) | 1


def _camera(plan: ScanPlan, phase: tuple[int, int], step: int) -> Any:
    """Return the camera that the channel is by itself: its pixels are larger, its centre lies up to a pixel aside."""
    camera, sensor = plan.camera, plan.camera.sensor
    shape = tuple(-(-(n - r0) // step) for n, r0 in zip(sensor.shape, phase, strict=True))
    aside = [
        (r0 + step * (m - 1) / 2 - (n - 1) / 2) * sensor.pixel_um
        for r0, m, n in zip(phase, shape, sensor.shape, strict=True)
    ]
    x, y = camera.lattice.offset_um
    lattice = replace(camera.lattice, offset_um=(x - aside[1], y - aside[0]))
    own = replace(sensor, shape=(shape[0], shape[1]), pixel_um=sensor.pixel_um * step, cfa="")
    return replace(camera, sensor=own, lattice=lattice)


class ThinnedSource(SourceView):
    """The frames whose positions a colour's plan has, renumbered for it."""

    def __init__(self, source: FrameSource, scan: ColourScan) -> None:
        super().__init__(source)
        self._scan = scan
        infos = [source.info(k) for k in range(len(source))]
        (y0, x0), step = scan.first, scan.step
        self._kept = [
            k
            for k, info in enumerate(infos)
            if info.position.y % step == y0 % step and info.position.x % step == x0 % step
        ]
        if not self._kept:
            raise InputError.expected(
                f"frames of channel {scan.channel}",
                f"some at rows {y0}, {y0 + step} … and columns {x0}, {x0 + step} …",
                "none",
                "record the whole scan",
            )

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return what is known of the frames, with the positions of the colour's plan."""
        return replace(known, plan=None, plan_shape=self._scan.plan.shape[:3])

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._kept)

    def info(self, index: int) -> FrameInfo:
        """Return what is known of a frame, at its position of the colour's plan."""
        info = self.source.info(self._kept[index])
        (y0, x0), step = self._scan.first, self._scan.step
        z, y, x = info.position
        return replace(info, points=(Position(z, (y - y0) // step, (x - x0) // step),))

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or a part of it."""
        return self.source.read(self._kept[index], region)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of frame ``index``."""
        return self.source.samples(self._kept[index], region)
