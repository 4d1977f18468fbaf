"""Inspect the quality of an H."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work, note
from lfcal.records import opt, record
from lfcal.tasks.cameras import note_assumed
from lfcal.tasks.matrices import MatrixTask, open_matrix
from lfcal.tasks.task import RunSettings, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.judge import Comparison, Inspection, RegionLoss
    from lfcal.judge.quality import QualityReport
    from lfcal.psf import PSFMatrix
    from lfcal.work import RunChoice

__all__ = ["INSPECT", "Inspect", "InspectedMatrix"]

REGIONS_PICTURE = "regions.png"
"""Name of the plot that compares the regions of the field, a file in the folder of the report."""

RATE = 200e6
"""Estimated number of bytes of H read and measured per second of processor time."""


@dataclass(frozen=True, kw_only=True)
class InspectedMatrix(TaskResult):
    """Quality of an H, whose file is closed.

    ``found`` contains the metrics and findings of ``matrix``, and ``comparison`` its differences from the reference H,
    None without a reference. ``loss`` contains the differences between regions, None if H has only one. ``page`` is the
    path of the report, None if there is none.
    """

    task: Inspect
    matrix: PSFMatrix
    found: Inspection
    comparison: Comparison | None = None
    loss: RegionLoss | None = None
    page: Path | None = None

    @property
    def failed(self) -> bool:
        """Whether H was required to be good or fair (``strict``), and is not."""
        return self.task.strict and self.found.merit not in ("good", "fair")

    @property
    def simulated(self) -> tuple[dict[str, Any] | None, ...]:
        """For each plane, a record of its simulation (engine, sampling, times and error); None if unknown."""
        from lfcal.psf import simulated_planes

        return tuple(simulated_planes(self.matrix.provenance, len(self.matrix)))

    def _values(self) -> dict[str, Any]:
        camera = self.matrix.camera
        found = self.found.to_dict(every=self.task.every)
        found |= {} if self.comparison is None else {"comparison": self.comparison.to_dict()}
        found |= {"simulated": self.simulated} if any(self.simulated) else {}
        found |= {} if self.loss is None else {"regions": self.loss.to_dict()}
        found |= {"assumed": [] if camera is None else camera.marks.paths("assumed")}
        return found if self.page is None else found | {"report": self.page}


@record
class Inspect(MatrixTask):
    """Measure the quality of H: every check with its rating, the apertures, and what to do.

    If the camera of H is known, patterns are compared with those that the camera model predicts, and the causes of
    faults are named.

    Examples
    --------
    >>> from lfcal.tasks import Inspect
    >>> (made,) = Inspect(source="H.h5", seconds=0).run()
    >>> print(made.found.quality.shape, made.found.merit)
    (2, 19, 33, 55, 55) unknown
    """

    name: ClassVar[str] = "inspect"
    input_words: ClassVar[str] = "H"
    in_units: ClassVar[bool] = True

    report: Path | None = opt(
        None,
        "Folder for an HTML report and the list of positions to record again (redo.json).",
        file="out",
        empty="no report",
    )
    reference: Path | None = opt(
        None, "Reference H of the same shape, with which H is compared.", label="Reference H", file="in", empty="none"
    )
    session: Path | None = opt(
        None,
        "Session folder with control frames, which show how well H of one period represents the whole field.",
        file="in",
        empty="none",
        more=True,
    )
    fit: Path | None = opt(
        None,
        "Folder of a fit of this scan (lfcal fit). The patterns are compared with the fitted camera.",
        label="Fit of the camera",
        file="in",
        empty="the camera stored in H",
        needs=("seconds", ""),
    )
    seconds: float = opt(
        1800.0,
        "Longest time for the comparison with the camera. If this time is reached, the verdict is “not fully "
        "judged”. 0 skips the comparison.",
        label="Time limit",
        unit="s",
        at_least=0,
    )
    patterns: int = opt(
        60,
        "Number of patterns to compare with the camera. More patterns show smaller faults, and take longer.",
        at_least=1,
        needs=("seconds", ""),
        more=True,
    )
    every: bool = opt(
        False,
        "List all checks, including those that are good or do not apply, and the aperture of each plane.",
        label="All checks",
        flag="--all",
    )
    strict: bool = opt(
        False,
        "Exit with code 1 if H should not be used as it is, or is not fully judged.",
        label="Fail unless usable",
        more=True,
    )

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The files to write are those of the report, if it is requested.
        """
        if way != "out" or self.report is None:
            return super().files(way)
        from lfcal.judge.report import report_files

        return (*report_files(self.report), self.report / REGIONS_PICTURE)

    def unit_outputs(self) -> tuple[Path, ...]:
        """Return the folder of the report, next to which the results of a stopped run are stored; empty without one."""
        return () if self.report is None else (self.report,)

    def work(self, run: RunSettings | None = None) -> Work[tuple[InspectedMatrix, ...]]:
        """Measure the quality of H, compare it with its camera and a reference H if given, and write the report."""
        from lfcal.judge import fitted_setup, iter_compare, iter_inspection
        from lfcal.judge.quality import METRICS
        from lfcal.work import discard, note_joining, parts_folder

        run = run or RunSettings()
        self._check_units(run)
        for why in METRICS.failures().values():
            note(f"left out: {why}")
        with ExitStack() as files:
            H = files.enter_context(self.opened())
            # the metrics describe images of points, so an HT file is inspected as the H that it was made from
            H = H.T if H.is_transposed else H
            note_assumed(H.camera, self.source.name)
            other, comparison = None, None
            if self.reference is not None:
                other = files.enter_context(open_matrix(self.reference, mat_order=self.mat_order))
                comparison = yield from iter_compare(H, other, by_index=True, workers=run.workers)
            setup = None if self.fit is None else fitted_setup(self.fit, H)
            choice = None if self.report is None else run.choice(self.report, H.nbytes / RATE)
            quality = yield from self._iter_quality(H, choice, run.workers)
            found = yield from iter_inspection(H, quality, setup=setup, seconds=self.seconds, patterns=self.patterns)
            if choice is not None and self.report is not None:
                note_joining(parts_folder(self.report))
            page = yield from self._iter_report(H, other, found, run.workers)
            loss = yield from self._iter_loss(run.workers)
            if choice is not None and self.report is not None:
                discard(parts_folder(self.report))
        return (InspectedMatrix(task=self, matrix=H, found=found, comparison=comparison, loss=loss, page=page),)

    def _check_units(self, run: RunSettings) -> None:
        asked = [name for name in ("executor", "scheduler", "resume") if getattr(run, name)]
        if asked and self.report is None:
            raise InputError.expected(f"--{asked[0]}", "--report", "none", "give a folder for the report")

    def _iter_quality(self, H: PSFMatrix, choice: RunChoice | None, workers: int | None) -> Work[QualityReport]:
        from lfcal.judge.quality import control_frames, iter_inspect, iter_inspect_units

        controls = None if self.session is None else control_frames(self.session, H)
        if choice is not None and self.report is not None:
            return (yield from iter_inspect_units(H, self.report, self.session, choice))
        return (yield from iter_inspect(H, controls=controls, workers=workers))

    def _iter_report(
        self, H: PSFMatrix, other: PSFMatrix | None, found: Inspection, workers: int | None
    ) -> Work[Path | None]:
        if self.report is None:
            return None
        from lfcal.judge.report import iter_report

        how: dict[str, Any] = {"reference": other, "workers": workers, "inspection": found, "every": self.every}
        return (yield from iter_report(H, self.report, **how))

    def _iter_loss(self, workers: int | None) -> Work[RegionLoss | None]:
        """Compare the regions of the field, if the file has several."""
        from lfcal.psf import regions_of

        if len(regions_of(self.source)) < 2:
            return None
        from lfcal.judge import draw_region_loss, iter_region_loss

        loss = yield from iter_region_loss(self.source, workers=workers)
        if self.report is not None:
            draw_region_loss(loss, self.report / REGIONS_PICTURE)
        return loss


INSPECT = TaskSet("inspect", (Inspect,), lambda given: Inspect, "lfcal inspect H.h5 --report report/")
