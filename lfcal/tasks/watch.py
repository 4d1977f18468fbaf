"""Check for each frame of a series whether H is still valid."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work, format_share
from lfcal.records import CorrectionRecipe, opt, panel, read_share, record, required
from lfcal.tasks._object_frames import ObjectFrameReading, channel_field, turn_field, windows_field
from lfcal.tasks._patterns import noise_field, open_upright
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.fit import NewFrame, Setup
    from lfcal.recalibrate import Contents, DriftWatch, Recalibration

__all__ = ["WATCH", "Watch", "Watched"]

MOST_FRAMES = 3
"""Largest number of frames on which the camera is recalibrated."""

COMPARED = 4
"""Number of patterns of H that are compared with its camera."""


@dataclass(frozen=True, kw_only=True)
class Watched(TaskResult):
    """Whether H is still valid for the frames of a series, and the files of the result.

    ``found`` contains the tests of all frames, and ``files`` are the files written; empty without an output folder.
    ``recalibration`` is the camera recalibrated on frames that differ from the calibration; None if it was not
    requested, or is not needed.
    """

    found: DriftWatch
    files: tuple[Path, ...]
    recalibration: Recalibration | None = None

    @property
    def failed(self) -> bool:
        """Whether H is no longer valid, or does not explain the frames."""
        return self.found.holds is not True

    def _values(self) -> dict[str, Any]:
        fit = self.recalibration
        return self.found.to_dict() | {"files": list(self.files), "recalibration": None if fit is None else fit.verdict}


@record
class Watch(Task):
    """Check for each frame of a series whether H is still valid.

    The frames may show any structured objects within the depth planes of H. For each frame, lfcal measures the shift of
    the array and the change of the gap, with their uncertainty. H is not changed. Exit code 1: H is no longer valid, or
    does not explain the frames.

    Examples
    --------
    >>> from lfcal.tasks import Watch
    >>> task = Watch(psf="monday/H.h5", frames="friday", quiet="monday/frames", mean=3, noise="64,1")
    >>> print(task.quiet, task.rate, task.noise)
    (PosixPath('monday/frames'),) 0.01 (64.0, 1.0)
    """

    name: ClassVar[str] = "watch"

    psf: Path = required(
        "H file, or the folder with H.h5 that lfcal fit frames wrote.", label="H", argument=True, file="in"
    )
    frames: tuple[Path, ...] = required(
        "Frames of unknown structured objects in the order of recording: files, or folders of frames.",
        argument=True,
        file="in",
    )
    out: Path | None = opt(
        None,
        "Folder for watch.csv, watch.json and watch.png.",
        label="Folder",
        short="-o",
        file="out",
        empty="no files",
    )
    quiet: tuple[Path, ...] = opt(
        (),
        "Frames recorded directly after the calibration, at least 6: files, or folders of frames. May be repeated. "
        "Drifts are relative to them, and their scatter sets the threshold.",
        label="Quiet frames",
        file="in",
        empty="drifts are relative to H, and the stated noise sets the threshold",
    )
    mean: int = opt(1, "Number of consecutive frames to average before each test.", at_least=1)
    rate: float = opt(
        0.01, "Probability of a false alarm in each test.", label="False alarms", above=0, below=0.5, read=read_share
    )
    recalibrate: bool = opt(
        False,
        "If H is no longer valid, recalibrate the camera on the first frames that show the drift, as lfcal fit frames "
        "does. The camera and its H are written to the subfolder “recalibrated” of the output folder.",
        label="Recalibrate after a drift",
    )
    windows: int | None = windows_field("in which the frames are compared with H")
    noise: tuple[float, float] | None = noise_field("as stated by the frames")
    orientation: str = turn_field()
    channel: str = channel_field()
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")

    def __post_init__(self) -> None:
        """Check every field, and that recalibration has an output folder."""
        super().__post_init__()
        if self.recalibrate and self.out is None:
            raise InputError.expected("--recalibrate", "an output folder", "none", "state the folder (--out)")

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The files to write are those in the folder ``out``; there are none without it.
        """
        from lfcal.recalibrate import RECALIBRATED, recalibration_outputs, watch_outputs

        if way == "out":
            more = recalibration_outputs(self.out / RECALIBRATED) if self.out and self.recalibrate else ()
            return () if self.out is None else (*watch_outputs(self.out), *more)
        return (*super().files(way), self._h())

    def work(self, run: RunSettings | None = None) -> Work[tuple[Watched, ...]]:
        """Measure the drift in each frame or average of ``mean`` frames; recalibrate and write files if requested."""
        from lfcal.recalibrate import RECALIBRATED, iter_watch, iter_write_recalibration, write_watch

        setup, plan, contents = self._described()
        reading = ObjectFrameReading(plan, self.orientation, self.channel, self.corrections)
        with ExitStack() as stack:
            frames = reading.frames(self.frames, stack)
            work = iter_watch(
                frames,
                setup,
                plan,
                quiet=reading.frames(self.quiet, stack),
                times=frames.times,
                noise=self.noise,
                rate=self.rate,
                mean=self.mean,
                contents=contents,
                windows=self.windows,
                workers=run.workers if run else None,
            )
            found = yield from work
            known = {"task": self.to_dict(absolute=True, outputs=False)}
            # before the recalibration, which may fail or be stopped
            files = () if self.out is None else write_watch(found, self.out, known)
            fit = yield from self._iter_recalibrated(found, frames, setup, plan, run)
        if fit is not None and self.out is not None:
            workers = run.workers if run else None
            more = yield from iter_write_recalibration(fit, self.out / RECALIBRATED, known, workers=workers)
            if more:
                files = (*write_watch(found, self.out, known | {"recalibrated": True}), *more)
        return (Watched(found=found, files=files, recalibration=fit),)

    def _iter_recalibrated(
        self, found: DriftWatch, frames: Sequence[NewFrame], setup: Setup, plan: ScanPlan, run: RunSettings | None
    ) -> Work[Recalibration | None]:
        """Return the camera recalibrated on the first frames that differ from the calibration, if requested."""
        from lfcal.recalibrate import iter_recalibrate

        if not self.recalibrate or found.first_moved is None:
            return None
        later = range(found.first_moved, len(frames))
        used = [k for k in later if not found.frames[k].problem][:MOST_FRAMES]
        depths = tuple(z + error for z, error in zip(plan.depths_um, setup.depth_errors_um, strict=True))
        work = iter_recalibrate(
            [frames[k] for k in used],
            replace(plan, depths_um=depths),
            noise=self.noise,
            effects=setup.effects,
            windows=self.windows,
            workers=run.workers if run else None,
        )
        return (yield from work)

    def _h(self) -> Path:
        """Return the H file."""
        from lfcal.fit import MODEL

        return self.psf / MODEL if self.psf.is_dir() else self.psf

    def _described(self) -> tuple[Setup, ScanPlan, Contents | None]:
        """Return the camera of H, its scan plan, and the assumptions about frames made in its recalibration, if any."""
        import numpy as np

        from lfcal.camera import NoLatticeError
        from lfcal.judge import behind
        from lfcal.recalibrate import stated_contents

        with open_upright(self._h()) as matrix:
            if matrix.camera is not None and not matrix.camera.has_lattice:
                raise NoLatticeError.of("watching frames")
            index = np.argwhere(matrix.recorded)
            some = index[np.linspace(0, len(index) - 1, COMPARED).astype(int)] if len(index) else index
            found = behind(matrix, some) if len(some) else None
            contents = stated_contents(matrix.provenance)
        if found is None or not found.explains:
            got = (
                "an H without a camera"
                if found is None
                else f"a camera that leaves {format_share(found.misfit)} of H unexplained"
            )
            raise InputError.expected(
                str(self._h()), "an H with a camera that explains it", got, "fit the camera first (lfcal fit)"
            )
        return found.setup, found.plan, contents


WATCH = TaskSet(
    "watch", (Watch,), lambda given: Watch, "lfcal watch monday/H.h5 friday/*.tif --quiet monday/frames -o friday/watch"
)
