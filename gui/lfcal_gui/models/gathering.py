"""Current state of the work (`Sitting`), from the project, its jobs and the reports of pages. No Qt."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from lfcal.base import Progress
from lfcal_gui.models.job import JobState, WindowJob
from lfcal_gui.models.next_step import JOBS, Place, Sitting
from lfcal_gui.models.pace import Paces
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.settings import ScanRates
from lfcal_gui.models.stamp import stamp_of
from lfcal_gui.models.verdict import Verdict, kept_verdict

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.psf import PSFMatrix

Reported = Mapping[str, Mapping[str, Any]]
"""Reports of pages: values of fields of `Sitting`."""

MOST_RESIDUAL_PX = 0.3
"""Largest residual of the period (px) at which positions still share the phases of the array."""

LEAST_S = 1.0
"""Smallest duration of a job before its remaining time is shown (s)."""

DECLINED, DESCRIBED, CHECKED, EXPORTED = "declined", "described", "checked", "exported"
"""Entries of a project's settings: declined steps, whether the user chose a camera, digest of the camera that was
checked, and export of H."""

SOURCES: dict[str, Literal["rig", "folder", "compute"]] = {
    "acquire": "rig",
    "frames": "folder",
    "simulate": "compute",
}
"""Source of H by the current page."""


def described(project: ProjectState) -> bool:
    """Return whether the user chose a camera; a new project begins with a preset."""
    changed = project.camera != ProjectState().camera or any(True for _ in project.camera.marks)
    return project.plan is not None or changed or project.settings.get(DESCRIBED) is True


def with_described(project: ProjectState) -> dict[str, Any]:
    """Return the settings of a project, marked to show that the user chose its camera."""
    return {**project.settings, DESCRIBED: True}


def _exists(frames: str) -> bool:
    """Return whether there is a file or folder of frames."""
    if not frames:
        return False
    from lfcal.frames import split_dataset

    return os.path.exists(split_dataset(frames)[0])


def sitting_of(
    project: ProjectState,
    reported: Reported,
    jobs: Iterable[WindowJob],
    *,
    page: str = "",
    place: str = "",
    matrix: PSFMatrix | None = None,
    paces: Paces | None = None,
) -> Sitting:
    """Return all facts on which the next step depends.

    Parameters
    ----------
    project, reported, jobs
        The project, the reports of the pages, and the jobs of the window.
    page, place
        Keys of the current page and of its place.
    matrix
        The project's H, None while it is not open.
    paces
        Measured speeds that correct the forecasts.
    """
    stamp = stamp_of(project.psf)
    path = exported_to(project)
    file = stamp_of(path)
    found = Sitting(
        place=place if place in get_args(Place) else "setup",  # type: ignore[arg-type]
        declined=_declined(project),
        camera=described(project),
        white=project.settings.get(CHECKED) == _digest(project) or "measured" in dict(project.camera.marks).values(),
        assumed=_assumed(project),
        wrong=_wrong(project),
        plan=project.plan is not None,
        source=_source(project, page),
        simulated=_simulated(project),
        folder=_exists(project.frames),
        h=stamp is not None,
        h_camera=matrix is None or matrix.camera is not None,
        verdict=kept_verdict(project),
        filled=filled_of(kept_verdict(project), matrix),
        exported=path,
        exported_bytes=0.0 if file is None else float(file[2]),
        light_field=bool(project.light_field),
        volume=bool(project.volume),
        **_costs(project.plan, ScanRates.of(project)),
        **_job(jobs),
    )
    facts_of_all = {name: value for facts in reported.values() for name, value in facts.items()}
    return replace(found, **(facts_of_all if paces is None else paces.corrected(facts_of_all)))


def filled_of(verdict: Verdict | None, matrix: PSFMatrix | None) -> int:
    """Return the number of bad positions that a model has already filled."""
    if verdict is None or matrix is None:
        return 0
    from lfcal.psf import Origin

    origin = (matrix.T if matrix.is_transposed else matrix).facts.origin
    return 0 if origin is None else sum(int(origin[place]) >= Origin.MODEL for place in verdict.redo)


def _source(project: ProjectState, page: str) -> Literal["rig", "folder", "compute"]:
    shown = SOURCES.get(page)
    if project.frames and project.plan is not None and shown != "compute":
        return "folder"
    return "rig" if shown is None or (shown == "compute" and project.plan is None) else shown


def _simulated(project: ProjectState) -> bool:
    """Return whether the simulated devices are chosen, as they are in a new project."""
    chosen = project.settings.get("acquire")
    return not isinstance(chosen, Mapping) or chosen.get("backend", "sim") == "sim"


def _assumed(project: ProjectState) -> tuple[str, ...]:
    """Return the assumed values that determine image positions; others affect neither time nor cutout."""
    from lfcal.camera import quantities_of

    there = set(project.camera.marks.paths("assumed"))
    return tuple(q.label for q in quantities_of(project.camera) if q.path in there and not q.light) if there else ()


def _wrong(project: ProjectState) -> str:
    if project.plan is None:
        return ""
    residual = max(map(abs, project.plan.period_residual_px))
    return f"its period is off by {residual:.2f} px" if residual > MOST_RESIDUAL_PX else ""


@lru_cache(maxsize=2)
def _costs(plan: ScanPlan | None, rates: ScanRates) -> dict[str, Any]:
    """Return the forecast costs of the plan at the speed and frame rate of Set up."""
    if plan is None:
        return {}
    from lfcal.camera import Forecast

    cost = Forecast.of(plan, **rates.forecast_keywords())
    planes = len(plan.depths_um)
    seconds, size = 3600 * cost.hours, float(cost.frame_bytes)
    return {"positions": cost.positions, "planes": planes, "frame_bytes": size, "record_s": seconds}


def _job(jobs: Iterable[WindowJob]) -> dict[str, Any]:
    """Return the job shown in the line of the next step: the oldest running one, else the oldest waiting one."""
    own = [job for job in jobs if job.active and job.kind in JOBS]
    if not own:
        return {}
    job = min(own, key=lambda one: (one.state is not JobState.RUNNING, one.number))
    record = job.progress
    if record is None:
        return {"job": job.kind, "job_words": "waiting for other jobs" if job.state is JobState.WAITING else ""}
    return {"job": job.kind, "job_words": _progress_words(record), "job_left_s": _left(record)}


def _progress_words(record: Progress) -> str:
    count = f" {record.count}" if record.count else ""
    return f"{record.stage}:{count}" if count else record.stage


def _left(record: Progress) -> float | None:
    eta = record.eta_seconds
    return eta if eta is not None and record.seconds >= LEAST_S and record.done < record.total else None


def session_counts(folder: str) -> dict[str, Any]:
    """Return ``done`` and ``total`` of the session in ``folder``, 0 if there is none, and what is ``counted``."""
    from lfcal.acquire import SessionFile
    from lfcal.base import LfcalError

    if not (Path(folder) / "session.json").is_file():
        return {"done": 0, "total": 0}
    try:
        session = SessionFile.read(Path(folder))
        there = session.acknowledged(Path(folder))
    except (LfcalError, OSError):
        return {"done": 0, "total": 0}
    counted = {} if session.target is None else {"counted": "frame"}
    return {"done": int(there[session.chosen].sum()), "total": int(session.chosen.sum()), **counted}


# -- what the project remembers ----------------------------------------------------------------------------
def _digest(project: ProjectState) -> str:
    """Return a digest of the camera."""
    import hashlib

    return hashlib.sha1(project.camera.to_json().encode(), usedforsecurity=False).hexdigest()


def with_checked(project: ProjectState) -> dict[str, Any]:
    """Return the settings of a project, marked to show that its camera agrees with a white image."""
    return {**project.settings, CHECKED: _digest(project)}


def with_exported(project: ProjectState, path: str) -> dict[str, Any]:
    """Return the settings of a project with the file to which its H was exported."""
    stamp = stamp_of(project.psf)
    return {**project.settings, EXPORTED: {"path": path, "stamp": [] if stamp is None else list(stamp[1:])}}


def exported_to(project: ProjectState) -> str:
    """Return the file to which the current H was exported; empty if there is none."""
    stamp, kept = stamp_of(project.psf), project.settings.get(EXPORTED)
    if stamp is None or not isinstance(kept, Mapping) or kept.get("stamp") != list(stamp[1:]):
        return ""
    path = str(kept.get("path"))
    return path if stamp_of(path) is not None else ""


def with_declined(project: ProjectState, action: str, place: str) -> dict[str, Any]:
    """Return the settings of a project with a declined step; a step in H is declined until H changes."""
    kept = project.settings.get(DECLINED)
    before = dict(kept) if isinstance(kept, Mapping) else {}
    stamp = stamp_of(project.psf) if place == "h" else None
    return {**project.settings, DECLINED: {**before, action: None if stamp is None else list(stamp[1:])}}


def _declined(project: ProjectState) -> frozenset[str]:
    kept, stamp = project.settings.get(DECLINED), stamp_of(project.psf)
    if not isinstance(kept, Mapping):
        return frozenset()
    now = None if stamp is None else list(stamp[1:])
    return frozenset(action for action, of in kept.items() if of is None or of == now)
