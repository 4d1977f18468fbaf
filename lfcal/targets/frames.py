"""Frames of a target from files or a session, in the order of their plan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import InputError
from lfcal.frames import FrameInfo, FrameMetadata, Frames, FrameSource, SourceView, open_frames
from lfcal.targets.plan import FORMAT, TargetPlan

__all__ = ["TargetFrames", "frames_of", "open_target_frames", "read_target_plan"]


class TargetFrames(SourceView):
    """Whole frames that show a target, each where a plan moved it: ``metadata`` has ``target`` and ``target_frames``.

    Parameters
    ----------
    source
        Frames in any order; ``order[k]`` of them is frame k of the plan.
    plan
        What they show.
    order
        None: as they come.
    """

    def __init__(self, source: FrameSource, plan: TargetPlan, order: list[int] | None = None) -> None:
        super().__init__(source)
        self.plan = plan
        self._order = list(range(len(source))) if order is None else order
        if len(self._order) != len(plan.frames):
            wanted = f"{len(plan.frames)}, as many as the plan has"
            raise InputError.expected("frames of a target", wanted, len(self._order), "give the plan of these frames")
        if source.shape != plan.scan.camera.sensor.shape:
            wanted = f"{plan.scan.camera.sensor.shape} pixels, the plan's sensor"
            raise InputError.expected("frames of a target", wanted, source.shape, "give whole sensor frames")

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return what is known of all frames, and of the target they show."""
        return replace(known, plan_shape=None, target=self.plan, target_frames=self.plan.frames, plan=self.plan.scan)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._order)

    def info(self, index: int) -> FrameInfo:
        """Return what is known of frame ``index``: not which positions it shows, they have to be found in it."""
        info = self.source.info(self._order[index])
        z, _ = self.plan.frames[index]
        exposure = self.plan.scan.exposures[z] if info.exposure_s is None else info.exposure_s
        return FrameInfo((), info.origin, exposure, None, info.saturated, info.label, info.mask)

    def read(self, index: int, region: Any = None) -> Any:
        """Return frame ``index``."""
        return self.source.read(self._order[index], region)

    def samples(self, index: int, region: Any = None) -> Any:
        """Return frame ``index`` with what is known of its samples."""
        return self.source.samples(self._order[index], region)


def read_target_plan(frames: Path, plan: Path | None) -> TargetPlan | None:
    """Return the target's plan of a file, or of ``plan.json`` in or above the folder of the frames; None: no target's.

    A plan of a scan with a single point is none.
    """
    from lfcal.base import read_text

    folder = frames if frames.is_dir() else frames.parent
    places = [plan] if plan else [p for p in (folder / "plan.json", folder.parent / "plan.json") if p.is_file()]
    if not places:
        return None
    text = read_text(places[0])
    return TargetPlan.from_json(text) if f'"{FORMAT}"' in text[:200] else None


def open_target_frames(frames: Path, plan: TargetPlan, *, skip_damaged: bool = False) -> Frames:
    """Return whole frames from a folder, or a file of many, in the order of their plan.

    Images of a folder are taken in the natural order of their names, or by a manifest, whose x is a frame's number.

    Raises
    ------
    InputError
        If there are not as many as the plan has, or not of its sensor.
    """
    count = len(plan.frames)
    listed = frames.is_dir() and any((frames / name).is_file() for name in ("manifest.json", "manifest.csv"))
    try:
        if listed:
            source = open_frames(frames, skip_damaged=skip_damaged)
        else:
            source = open_frames(frames, order="raster", plan_shape=(1, 1, count), skip_damaged=skip_damaged)
    except InputError as error:
        raise InputError(f"{error} (frames of a target: its plan expects {count}, in order)") from None
    numbers = np.array([source.info(k).position.x for k in range(len(source))], np.intp)
    order = np.argsort(numbers, kind="stable")
    if not np.array_equal(numbers[order], np.arange(count)):
        source.close()
        wanted = f"frames 0 … {count - 1} of the plan, each once"
        raise InputError.expected(str(frames), wanted, f"{len(numbers)} frames", "give the plan they were recorded by")
    return TargetFrames(source, plan, order.tolist())


def frames_of(source: FrameSource, plan: TargetPlan) -> tuple[tuple[int, int], ...]:
    """Return plane and offset number of every frame of a source, from its metadata or its plan.

    Raises
    ------
    InputError
        If it does not state them, and the number of frames differs from the plan.
    """
    if plan.lit is not None and not source.metadata.decoded:
        wanted = "those that show one offset each"
        remedy = "solve for them (lfcal.targets.decoded)"
        raise InputError.expected("frames of a target", wanted, "sums of several offsets", remedy)
    told = source.metadata.target_frames
    frames = plan.frames if told is None else tuple((int(z), int(k)) for z, k in told)
    if len(frames) != len(source):
        wanted = f"{len(frames)}, as many as the plan has"
        raise InputError.expected("frames of a target", wanted, len(source), "give the plan they were recorded by")
    return frames
