"""H of a scan plan from any frame source: the one call behind the command line, the window and scripts."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from lfcal.camera import ScanPlan
from lfcal.checks import check_number
from lfcal.errors import InputError
from lfcal.frames.part import check_stated
from lfcal.frames.source import FrameSource
from lfcal.plain import plain
from lfcal.progress import Work, drained
from lfcal.psf.assembly import AssembledPlanes, Assembly
from lfcal.psf.assembly_report import AssemblyReport
from lfcal.psf.cutout import Cutout, find_cutout
from lfcal.psf.filling import Fill
from lfcal.psf.gather import Gatherer
from lfcal.psf.layout import Stored
from lfcal.psf.make import Reopening, iter_make
from lfcal.psf.measured_noise import MeasuredNoise
from lfcal.psf.pedestal import check_pedestal
from lfcal.psf.steps import check_store_tolerance

if TYPE_CHECKING:
    from lfcal.work import RunChoice

__all__ = [
    "AssemblySettings",
    "assemble_plan",
    "find_plan_cutout",
    "iter_assemble_plan",
    "known_of",
    "planes_of_frames",
]

SAMPLED = 24
"""Frames that a cutout is chosen by."""


@dataclass(frozen=True)
class AssemblySettings:
    """How frames become H.

    Attributes
    ----------
    cutout
        Pixels ``(nt, ns)``, odd; None: the plan's; ``"auto"``: the smallest that loses at most ``lost``.
    lost
        With ``"auto"``: largest share of the energy left outside.
    interpolation
        One of `lfcal.psf.cutout.INTERPOLATIONS`; empty: ``nearest``, or ``cubic`` where the plan resamples.
    pad
        Pad cutouts that leave the frame with zeros, and mark them, instead of an error.
    strict
        Missing and repeated positions are errors.
    keep_pedestal
        Do not refuse frames whose black level nothing subtracts and would be more than 2 % of the light of H.
    dtype
        Stored type, as in `PSFWriter`: ``"rounded"`` (at most 0.1 % error at a third of the bytes), or ``"float32"``.
    compression
        ``"gzip"``, ``"zstd"`` or ``"none"``.
    workers
        Threads; None takes every processor.
    store_tolerance
        In a file, the share (L1) that each pattern may lack: stored in whole steps as wide as that allows; None: as
        ``dtype`` says.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from lfcal.camera import ScanPlan
    >>> from lfcal.frames import ArraySource, open_frames
    >>> from lfcal.psf import AssemblySettings, assemble_plan
    >>> plan = ScanPlan.from_json(Path("session/plan.json").read_text())
    >>> with open_frames("session/frames", plan=plan) as frames:
    ...     places = [frames.info(k).position for k in range(24)]
    ...     few = ArraySource(np.stack([frames.read(k) for k in range(24)]), places)
    >>> report = assemble_plan(few, plan, settings=AssemblySettings(cutout="auto", lost=0.02))
    >>> print(plan.cutout, "could be", report.matrix.cutout)
    (55, 55) could be (29, 29)
    """

    cutout: tuple[int, int] | str | None = None
    lost: float = 0.005
    interpolation: str = ""
    pad: bool = False
    strict: bool = False
    keep_pedestal: bool = False
    dtype: str = "rounded"
    compression: str = "gzip"
    workers: int | None = None
    store_tolerance: float | None = None

    @property
    def stored(self) -> Stored:
        """How values are stored."""
        return Stored(self.dtype, self.compression, self.store_tolerance)

    def __post_init__(self) -> None:
        """Check what the parts below do not."""
        check_number("energy lost", self.lost, above=0, below=1)
        if isinstance(self.cutout, str) and self.cutout != "auto":
            raise InputError.expected("cutout", "(rows, columns) or auto", repr(self.cutout), "correct it")
        if self.store_tolerance is not None:
            check_store_tolerance(self.store_tolerance)
            if self.dtype != "rounded":
                raise InputError.expected("stored type in steps", "rounded", self.dtype, "leave one of them out")


def iter_assemble_plan(
    source: FrameSource,
    plan: ScanPlan,
    out: str | os.PathLike[str] | None = None,
    settings: AssemblySettings | None = None,
    *,
    provenance: Mapping[str, Any] | None = None,
    fill: Fill | None = None,
    run: RunChoice | None = None,
    reopening: Reopening | None = None,
) -> Work[AssemblyReport]:
    """Assemble H of ``plan`` from the frames of ``source``, which are taken as they come.

    Parameters
    ----------
    source
        Frames, corrected: `lfcal.frames.corrected_view`.
    plan
        Positions, depths, anchor and cutout.
    out
        H file to write; None keeps H in memory as float32.
    settings
        How; None: the defaults.
    provenance
        Kept with H, besides plan, corrections and settings.
    fill, run, reopening
        As in `iter_assemble`.

    Raises
    ------
    InputError
        As `lfcal.psf.iter_assemble`; and where a pedestal would stay in H.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan
    >>> from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    >>> from lfcal.psf import iter_assemble_plan
    >>> plan = ScanPlan.from_json(Path("session/plan.json").read_text())
    >>> with open_frames("session/frames", plan=plan) as frames:
    ...     view = corrected_view(frames, CorrectionRecipe(dark="session/dark"), plan)
    ...     work = iter_assemble_plan(view, plan, "new.h5")
    ...     step = next(work)
    ...     work.close()  # cancelled: no file is left
    >>> print(step.stage, step.count, Path("new.h5").exists())
    assemble frames 0 of 1254 False
    """
    settings = settings or AssemblySettings()
    cutout = find_plan_cutout(source, plan, settings)
    assembly = Assembly(source, plan.shape[:3], cutout, strict=settings.strict)
    header = assembly.header(plan.depths_um, plan.camera, known_of(source, plan, provenance))
    if reopening is not None:
        # what was found from many frames is not looked for again by others
        found = replace(settings, cutout=cutout.shape, keep_pedestal=True, workers=None)
        noise = None if assembly.noise is None else list(assembly.noise)
        reopening = replace(reopening, values={**reopening.values, "settings": plain(found), "noise": noise})
    planes = AssembledPlanes(assembly, header, fill, reopening=reopening)
    return assembly.report((yield from iter_make(planes, out, settings.stored, run=run, workers=settings.workers)))


assemble_plan = drained(
    iter_assemble_plan,
    """
    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan
    >>> from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    >>> from lfcal.psf import assemble_plan
    >>> plan = ScanPlan.from_json(Path("session/plan.json").read_text())
    >>> recipe = CorrectionRecipe(dark="session/dark", white="session/white")
    >>> with open_frames("session/frames", plan=plan) as frames:
    ...     report = assemble_plan(corrected_view(frames, recipe, plan), plan)
    >>> print(report.frames, "frames:", report.matrix)
    1254 frames: <PSFMatrix (z, y, x, t, s) = (2, 19, 33, 55, 55), float32, camera 'bench (sample session)'>
    """,
)


def find_plan_cutout(source: FrameSource, plan: ScanPlan, settings: AssemblySettings) -> Cutout:
    """Return the cutout that ``settings`` ask for; raises `InputError` where a pedestal would stay in H, or lack."""
    check_stated(source, plan.camera)
    outside = "zero" if settings.pad else "error"
    cutout = Cutout.for_plan(plan, interpolation=settings.interpolation, outside=outside)
    if settings.cutout is not None:
        cutout = replace(cutout, shape=_cutout_shape(source, cutout, settings))
    _check_filter(source, plan)
    keeps_level = source.metadata.keeps_level
    # of frames that went through no corrections nothing is known
    if keeps_level is not None and not settings.keep_pedestal:
        infos = tuple(source.info(k) for k in range(len(source)))
        check_pedestal(Gatherer(source, infos, cutout), plan.shape[0], subtracted=not keeps_level)
    return cutout


def _check_filter(source: FrameSource, plan: ScanPlan) -> None:
    """Raise `InputError` where the colours of a mosaic do not come back with the lenslets."""
    cfa = source.metadata.cfa
    if not cfa or source.metadata.channel:
        return
    step = math.isqrt(len(cfa))  # letters by rows of a square
    if any(n % step for n in plan.period):
        period = " x ".join(str(math.lcm(n, step)) for n in plan.period)
        raise InputError.expected(
            "period of a scan through a colour filter",
            f"a multiple of {step} pixels, the filter's pattern",
            f"{plan.period[0]} x {plan.period[1]}, after which the same place of a lenslet lies on another colour",
            f"scan {period} positions, or describe the sensor without its filter if it has none",
        )


def known_of(source: FrameSource, plan: ScanPlan, provenance: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return what H keeps of the scan that it is made of."""
    told = ("session", "devices", "simulated", "optics", "suspect", "half_cell", "kept_aside")
    return {**source.metadata.stated(told), "plan": plan.to_dict(), **(provenance or {})}


def planes_of_frames(
    source: FrameSource, plan: ScanPlan, values: Mapping[str, Any], fill: Fill | None, close: Callable[[], None]
) -> AssembledPlanes:
    """Return the planes of frames that another process assembles in units, of the ``values`` of its `Reopening`.

    ``close`` closes the frames when the planes are made.
    """
    given = values["settings"]
    settings = AssemblySettings(**{**given, "cutout": tuple(given["cutout"])})
    cutout = find_plan_cutout(source, plan, settings)
    noise = None if values["noise"] is None else MeasuredNoise(*values["noise"])
    assembly = Assembly(source, plan.shape[:3], cutout, strict=settings.strict, noise=noise, measured=True)
    return AssembledPlanes(assembly, assembly.header(plan.depths_um), fill, close=close)


def _cutout_shape(source: FrameSource, cutout: Cutout, settings: AssemblySettings) -> tuple[int, int]:
    if not isinstance(settings.cutout, str):
        assert settings.cutout is not None
        return settings.cutout
    sample = range(0, len(source), max(1, len(source) // SAMPLED))
    images = (source.read(k) for k in sample)

    def centre(k: int) -> tuple[float, float]:
        info = source.info(k)
        row, column = (
            cutout.anchor[axis] + step / cutout.scale[axis] - info.origin[axis]
            for axis, step in enumerate((info.position.y, info.position.x))
        )
        return row, column

    return find_cutout(images, (centre(k) for k in sample), lost=settings.lost)
