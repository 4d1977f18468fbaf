"""H from frames in units of a plane each: how other processes open the same frames.

Defect pixels are searched for again in each process; what else is found from many frames, the command finds itself.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.camera import ScanPlan
from lfcal.cli.channels import Part, open_colour, parts_of
from lfcal.cli.outputs import files_of
from lfcal.cli.scan_frames import ScanFrames
from lfcal.frames import CorrectionRecipe, Frames, FrameSource, corrected_view, named_orientation, oriented
from lfcal.frames.damage import SelectedSource
from lfcal.frames.half_cell import with_partners
from lfcal.plain import plain
from lfcal.progress import Work
from lfcal.psf import assemble_units
from lfcal.psf.assemble_plan import AssemblySettings, find_plan_cutout
from lfcal.psf.assemble_units import AssemblyTool, iter_one_plane
from lfcal.psf.assembly import Assembly
from lfcal.psf.assembly_report import AssemblyReport
from lfcal.psf.filling import Fill
from lfcal.psf.measured_noise import MeasuredNoise
from lfcal.work import RunChoice
from lfcal.work.unit import stamp_of

__all__ = ["PartFrames", "do_plane", "iter_assemble_units"]


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


def iter_assemble_units(
    view: FrameSource,
    part: Part,
    same: PartFrames,
    settings: AssemblySettings,
    *,
    run: RunChoice,
    provenance: Mapping[str, Any],
    fill: Fill | None,
) -> Work[AssemblyReport]:
    """Assemble H of a part into its file as `lfcal.psf.assemble_plan.iter_assemble_plan` does, plane by plane.

    Parameters
    ----------
    view
        Its frames, clean and upright.
    part
        What is made, and by which plan.
    same
        How others open the same frames.
    settings, provenance, fill
        As in `lfcal.psf.assemble_plan.iter_assemble_plan`.
    run
        By whom, and what becomes of an earlier run.

    Raises
    ------
    InputError, FileFormatError, StorageError
        As that does, and `lfcal.work.iter_made`; the planes that are done stay for the next run.
    """
    told = {"part": same.plain(), "stamp": stamp_of(same.inputs(part.source))}
    task = f"{__name__}:{do_plane.__name__}"
    return assemble_units.iter_assemble_units(
        view, part.plan, part.out, settings, told=told, run=run, task=task, provenance=provenance, fill=fill
    )


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Assemble one plane into an H file of its own: the task of a unit."""
    return iter_one_plane(arguments, out, workers, _made)


def _made(shared: Mapping[str, Any], workers: int) -> AssemblyTool:
    same = PartFrames.of(shared["part"])
    given = shared["settings"]
    settings = AssemblySettings(**{**given, "cutout": tuple(given["cutout"]), "workers": workers})
    raw, view, plan = same.open()
    try:
        cutout = find_plan_cutout(view, plan, settings)
        fill: Fill | None = None
        if same.fill is not None:
            from lfcal.fit.stored import Filler, read_fit

            fill = Filler(read_fit(same.fill), plan, workers)
        noise = None if shared["noise"] is None else MeasuredNoise(*shared["noise"])
        assembly = Assembly(view, plan.shape[:3], cutout, strict=settings.strict, noise=noise, measured=True)
        return AssemblyTool(plan, assembly, fill, raw.close)
    except BaseException:
        raw.close()
        raise
