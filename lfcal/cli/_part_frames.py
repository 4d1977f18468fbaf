"""The frames of one H, as any process opens them that makes a plane of it.

Defect pixels are searched for again in each process; what else is found from many frames, the command finds itself.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import plain
from lfcal.camera import ScanPlan
from lfcal.cli._channels import open_colour, parts_of
from lfcal.cli._scan_frames import ScanFrames
from lfcal.cli.outputs import files_of
from lfcal.frames import (
    CorrectionRecipe,
    Frames,
    FrameSource,
    SelectedSource,
    corrected_view,
    named_orientation,
    oriented,
    with_partners,
)
from lfcal.psf import AssembledPlanes, Fill, Reopening, planes_of_frames
from lfcal.work import stamp_of

__all__ = ["PartFrames", "open_planes"]


@dataclass(frozen=True)
class PartFrames:
    """The clean and upright frames that one H is made of, as any process opens them.

    Attributes
    ----------
    scan
        Where they lie.
    channel
        The colour that H is of, empty for the frames as they are.
    recipe
        Their corrections.
    turn
        Name of what makes them upright.
    half_cell
        Whether each stands for the position half a period away, too.
    left_out
        Numbers of those that are damaged.
    fill
        Folder of the fit whose model fills missing positions; or None.
    """

    scan: ScanFrames
    channel: str
    recipe: CorrectionRecipe
    turn: str
    half_cell: bool
    left_out: tuple[int, ...]
    fill: Path | None

    def open(self) -> tuple[Frames, FrameSource, ScanPlan]:
        """Return what is to be closed afterwards, the frames, and the plan that H is made by."""
        raw, scan = open_colour(self.scan.open, self.channel)
        part = parts_of(self.channel, raw, scan, Path(), _nobody, quiet=True)[0]
        frames = part.source
        if self.left_out:
            frames = SelectedSource(frames, np.setdiff1d(np.arange(len(frames)), self.left_out), ())
        view: FrameSource = corrected_view(frames, self.recipe, scan)
        view = oriented(view, named_orientation(self.turn), part.plan.camera.sensor.shape)
        return raw, with_partners(view, part.plan) if self.half_cell else view, part.plan

    def inputs(self, source: Frames) -> list[str]:
        """Return all files that are read, those of ``source`` among them."""
        recipe = self.recipe
        given = [str(path) for path in (recipe.dark, recipe.white, self.fill or "")]
        others = [path for name in given for path in files_of(name)]
        return [*self.scan.files(source), *sorted(os.path.abspath(path) for path in others if path.is_file())]

    def plain(self) -> dict[str, Any]:
        """Return this as plain JSON types, paths absolute."""
        recipe = asdict(self.recipe)
        for name in ("dark", "white"):
            if recipe[name] and recipe[name] != "none":
                recipe[name] = os.path.abspath(recipe[name])
        own = {"channel": self.channel, "turn": self.turn, "half_cell": self.half_cell, "left_out": self.left_out}
        fill = None if self.fill is None else os.path.abspath(self.fill)
        found: dict[str, Any] = plain({"scan": self.scan.plain(), "recipe": recipe, "fill": fill, **own})
        return found

    def reopening(self, source: Frames) -> Reopening:
        """Return how any process assembles the frames of ``source``, the same ones."""
        values = {"part": self.plain(), "stamp": stamp_of(self.inputs(source))}
        return Reopening(f"{__name__}:{open_planes.__name__}", values)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> PartFrames:
        """Return what `plain` gave."""
        read = {
            "scan": ScanFrames.of(values["scan"]),
            "recipe": CorrectionRecipe(**values["recipe"]),
            "left_out": tuple(values["left_out"]),
            "fill": None if values["fill"] is None else Path(values["fill"]),
        }
        return cls(**{**values, **read})


def _nobody(colour: str) -> Frames:
    raise AssertionError(f"frames of {colour} are open")


def open_planes(values: Mapping[str, Any], workers: int) -> AssembledPlanes:
    """Return the planes of frames as another process opens them, of what `PartFrames.reopening` says."""
    same = PartFrames.of(values["part"])
    raw, view, plan = same.open()
    try:
        fill: Fill | None = None
        if same.fill is not None:
            from lfcal.fit import Filler, read_fit

            fill = Filler(read_fit(same.fill), plan, workers)
        return planes_of_frames(view, plan, values, fill, raw.close)
    except BaseException:
        raw.close()
        raise
