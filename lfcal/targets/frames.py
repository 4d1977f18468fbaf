"""Open frames of a target from files or a session, in the order of their plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import InputError, format_pixels
from lfcal.frames import FrameInfo, FrameMetadata, Frames, FrameSource, SourceView, open_frames
from lfcal.targets.plan import FORMAT, TargetPlan

__all__ = ["TargetFrames", "frames_of", "open_target_frames", "read_target_plan"]


class TargetFrames(SourceView):
    """Complete frames of a target in the order of a plan; ``metadata`` contains ``target`` and ``target_frames``.

    Parameters
    ----------
    source
        Frames in any order; frame ``order[k]`` is frame k of the plan.
    plan
        Plan of the frames.
    order
        Index in ``source`` of each frame of the plan. None: the source is in the plan's order.

    Raises
    ------
    InputError
        If the number of frames differs from the plan, or their shape from the sensor's.
    """

    def __init__(self, source: FrameSource, plan: TargetPlan, order: list[int] | None = None) -> None:
        super().__init__(source)
        self.plan = plan
        self._order = list(range(len(source))) if order is None else order
        if len(self._order) != len(plan.frames):
            wanted = f"{len(plan.frames)}, as in the plan"
            raise InputError.expected(
                "frames of a target", wanted, len(self._order), "use the plan with which these frames were recorded"
            )
        if source.shape != plan.scan.camera.sensor.shape:
            raise InputError.expected(
                "frames of a target",
                f"{format_pixels(plan.scan.camera.sensor.shape)}, the size of the plan's sensor",
                format_pixels(source.shape),
                "give frames of the whole sensor, or use the plan with which these frames were recorded",
            )

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return ``known``, the metadata of the source, with the plan of the target."""
        return replace(known, plan_shape=None, target=self.plan, target_frames=self.plan.frames, plan=self.plan.scan)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._order)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index`` without positions, which must be detected in the frame."""
        info = self.source.info(self._order[index])
        z, _ = self.plan.frames[index]
        exposure = self.plan.scan.exposures[z] if info.exposure_s is None else info.exposure_s
        return FrameInfo((), info.origin, exposure, None, info.saturated, info.label, info.mask)

    def read(self, index: int, region: Any = None) -> Any:
        """Return frame ``index``, or its ``region`` (row and column slices)."""
        return self.source.read(self._order[index], region)

    def samples(self, index: int, region: Any = None) -> Any:
        """Return the samples of frame ``index``, or of its ``region``, with their noise and validity."""
        return self.source.samples(self._order[index], region)


def read_target_plan(frames: Path, plan: Path | None) -> TargetPlan | None:
    """Return the target plan in the file ``plan``; if this is None, that in ``plan.json``.

    ``plan.json`` is in the folder of ``frames``, or in the folder above it. The result is None if neither exists, or if
    the file contains the plan of a single point.
    """
    from lfcal.base import read_text

    folder = frames if frames.is_dir() else frames.parent
    places = [plan] if plan else [p for p in (folder / "plan.json", folder.parent / "plan.json") if p.is_file()]
    if not places:
        return None
    text = read_text(places[0])
    return TargetPlan.from_json(text) if f'"{FORMAT}"' in text[:200] else None


def open_target_frames(frames: Path, plan: TargetPlan, *, skip_damaged: bool = False) -> Frames:
    """Open the complete frames in a folder, or in a file of several pages, in the order of the plan.

    Images in a folder are sorted by their names in natural order, or by a manifest with the frame numbers as x.
    ``skip_damaged`` is as in `open_frames`.

    Raises
    ------
    InputError
        If there is not exactly one frame for each frame of the plan, or the shape of the frames is not the sensor's.
    """
    count = len(plan.frames)
    listed = frames.is_dir() and any((frames / name).is_file() for name in ("manifest.json", "manifest.csv"))
    try:
        if listed:
            source = open_frames(frames, skip_damaged=skip_damaged)
        else:
            source = open_frames(frames, order="raster", plan_shape=(1, 1, count), skip_damaged=skip_damaged)
    except InputError as error:
        raise InputError(f"{error} (the plan of the target needs {count} frames, in order)") from None
    numbers = np.array([source.info(k).position.x for k in range(len(source))], np.intp)
    order = np.argsort(numbers, kind="stable")
    if not np.array_equal(numbers[order], np.arange(count)):
        source.close()
        wanted = f"each of the frames 0 to {count - 1} of the plan once"
        raise InputError.expected(
            str(frames), wanted, f"{len(numbers)} frames", "give the plan by which they were recorded"
        )
    return TargetFrames(source, plan, order.tolist())


def frames_of(source: FrameSource, plan: TargetPlan) -> tuple[tuple[int, int], ...]:
    """Return the indices of the plane and the offset of every frame of a source, from its metadata or from ``plan``.

    Raises
    ------
    InputError
        If frames show several offsets and were not decoded, or their number differs from that expected.
    """
    if plan.lit is not None and not source.metadata.decoded:
        wanted = "frames that show one offset each"
        remedy = "decode them (lfcal.targets.decoded)"
        raise InputError.expected("frames of a target", wanted, "sums of several offsets", remedy)
    reported = source.metadata.target_frames
    frames = plan.frames if reported is None else tuple((int(z), int(k)) for z, k in reported)
    if len(frames) != len(source):
        wanted = f"{len(frames)}, as in the plan"
        raise InputError.expected(
            "frames of a target", wanted, len(source), "give the plan by which they were recorded"
        )
    return frames
