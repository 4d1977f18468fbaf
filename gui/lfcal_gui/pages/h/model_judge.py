"""An inspection as work for the window: its request and its results. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work
from lfcal_gui.models import FittedCamera, ProjectState, Stamp, Verdict, stamp_of, stated_order
from lfcal_gui.pages.h.model_checks import QualitySettings, kept_of

if TYPE_CHECKING:
    from lfcal.fit import Setup
    from lfcal.judge import Inspection
    from lfcal.judge.quality import QualityReport


@dataclass(frozen=True, eq=False)
class InspectionRequest:
    """Request for an inspection of H.

    Attributes
    ----------
    stamp
        File of H as it was when it was asked for.
    seconds, patterns
        Time for the comparison with the camera, 0: none; and how many patterns are compared.
    session
        Session whose control frames are looked at; empty: none.
    setup
        The camera as the fit found it, None: another.
    folder
        Folder of the fit whose camera is taken; empty: none.
    mat_order
        As in `lfcal.psf.open_psf`.
    """

    stamp: Stamp
    seconds: float
    patterns: int
    session: str
    setup: Setup | None
    folder: str
    mat_order: str = ""

    @property
    def choices(self) -> tuple[object, ...]:
        """All but the file."""
        return self.seconds, self.patterns, self.session, self.setup, self.folder, self.mat_order

    @property
    def name(self) -> str:
        """Name of the file."""
        return Path(self.stamp[0]).name

    @property
    def source(self) -> str:
        """Which camera H is compared with, in words."""
        if self.setup is not None:
            return "The camera is as the fit found it"
        if self.folder:
            return f"The camera is as in the fit {Path(self.folder).name}"
        return "The camera is as H describes it"


@dataclass(eq=False)
class InspectionRun:
    """Results so far of an inspection that runs in a thread.

    Attributes
    ----------
    report, depths
        The metrics that need no camera, and the depths of the planes (µm).
    camera
        Whether H states a camera.
    inspection
        The results of the comparison with the camera.
    """

    report: QualityReport | None = None
    depths: NDArray[np.float64] | None = None
    camera: bool = False
    inspection: Inspection | None = None


def asked_of(
    stamp: Stamp, settings: QualitySettings, fitted: FittedCamera | None, mat_order: str = ""
) -> InspectionRequest:
    """Return the request for the checks of a file. A camera fitted to another file is not used."""
    setup = None
    if settings.camera == "fitted" and fitted is not None and fitted.stamp == stamp:
        setup = fitted.setup
    folder = settings.fit if settings.camera == "saved" else ""
    return InspectionRequest(stamp, settings.seconds, settings.patterns, settings.session, setup, folder, mat_order)


def iter_judge(asked: InspectionRequest, kept: InspectionRun) -> Work[None]:
    """Measure H and compare it with its camera; what is found is in ``kept``, as jobs are remembered long."""
    from lfcal.judge import fitted_setup, iter_inspection
    from lfcal.judge.quality import control_frames, iter_inspect
    from lfcal.psf import open_psf

    with open_psf(asked.stamp[0], mat_order=asked.mat_order) as opened:
        matrix = opened.T if opened.is_transposed else opened
        setup = fitted_setup(Path(asked.folder), matrix) if asked.folder and asked.seconds else asked.setup
        controls = control_frames(Path(asked.session), matrix) if asked.session else None
        report = yield from iter_inspect(matrix, controls=controls)
        kept.depths, kept.report, kept.camera = np.array(matrix.known_depths), report, matrix.camera is not None
        work = iter_inspection(matrix, report, setup=setup, seconds=asked.seconds, patterns=asked.patterns)
        found = yield from work
        # repair functions keep references to the patterns
        kept.inspection = replace(found, faults=tuple(replace(one, repair=None) for one in found.faults))


@dataclass(frozen=True, eq=False)
class JudgedH:
    """What was found of an H, what was asked, and the verdict that the project keeps."""

    asked: InspectionRequest
    inspection: Inspection
    verdict: Verdict


def iter_judged(project: ProjectState, fitted: FittedCamera | None) -> Work[JudgedH]:
    """Judge the H of a project by its settings."""
    stamp, kept = stamp_of(project.psf), InspectionRun()
    if stamp is None:
        raise InputError.expected("H", "a file", project.psf or "none", "open or assemble one")
    asked = asked_of(stamp, QualitySettings.of(project), fitted, stated_order(project, project.psf))
    yield from iter_judge(asked, kept)
    found = judged(kept, "it was left out")
    assert found is not None  # it has ended
    return JudgedH(asked, found, kept_of(found))


def judged(kept: InspectionRun, why_not: str) -> Inspection | None:
    """Return what is known: the comparison, or the metrics alone with the reason; None before these are."""
    from lfcal.judge import Inspection

    if kept.inspection is not None or kept.report is None:
        return kept.inspection
    unfinished = f"the comparison with the camera is missing ({why_not})" if kept.camera else ""
    return Inspection(kept.report, (), 0, 0.0, why_not, 0.0, unfinished=unfinished)


def iter_write_report(psf: str, folder: str, inspection: Inspection | None, mat_order: str = "") -> Work[Path]:
    """Write the report of the H in a file; what was found is not measured again."""
    from lfcal.judge.report import iter_report
    from lfcal.psf import open_psf

    with open_psf(psf, mat_order=mat_order) as matrix:
        page = yield from iter_report(matrix, Path(folder), inspection=inspection)
        return page


def report_files(folder: str) -> list[Path]:
    """Return the paths of the files that a report writes into ``folder``, where they may exist already."""
    return [Path(folder) / name for name in ("index.html", "report.pdf", "quality.json", "redo.json")]
