"""Recalibrate a camera with ordinary frames, whose objects are unknown."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work
from lfcal.records import (
    CorrectionRecipe,
    opt,
    panel,
    record,
    required,
)
from lfcal.tasks._object_frames import ObjectFrameReading, channel_field, turn_field, windows_field
from lfcal.tasks._patterns import noise_field, open_upright
from lfcal.tasks.cameras import is_camera_file, preset_names
from lfcal.tasks.fit import FOLDER, read_unknowns
from lfcal.tasks.planned import cutout_field, depths_field, planned_scan, virtual_depths_field
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.recalibrate import Recalibration

__all__ = ["FIT_FRAMES", "Recalibrate", "Recalibrated"]


@dataclass(frozen=True, kw_only=True)
class Recalibrated(TaskResult):
    """A camera recalibrated on frames, and its files.

    ``found`` is the result of the fit, and ``files`` were written to the folder ``out``.
    """

    found: Recalibration
    out: Path
    files: tuple[Path, ...]

    @property
    def failed(self) -> bool:
        """Whether the camera does not explain the frames, so that nothing was written."""
        return not self.found.accepted

    def _values(self) -> dict[str, Any]:
        from lfcal.recalibrate import recalibration_dict

        return recalibration_dict(self.found) | {"files": list(self.files)}


@record
class Recalibrate(Task):
    """Recalibrate a camera with ordinary frames, and compute its H.

    The frames may show any structured objects within the depth planes. The fit estimates gap, rotation, offset and
    pitch of the array, focal lengths, iris and aberrations. The object and the dark field of each frame are estimated
    together with them. It writes camera.json, effects.json, H.h5 and recalibration.json into a folder. Exit code 1: the
    camera does not explain the frames, and nothing is written.

    Examples
    --------
    >>> from lfcal.tasks import Recalibrate
    >>> task = Recalibrate(frames="beads.tif", psf="H.h5", noise="64,1", out="monday")
    >>> print(task.files("out")[0], task.noise)
    monday/H.h5 (64.0, 1.0)
    """

    name: ClassVar[str] = "fit frames"
    resumes: ClassVar[bool] = True

    frames: tuple[Path, ...] = required(
        "Frames of unknown structured objects: files, or folders of frames.", argument=True, file="in"
    )
    out: Path = opt(FOLDER, "Folder for the results.", label="Folder", short="-o", file="out")
    psf: Path | None = opt(
        None,
        "H to recalibrate. Its camera, planes and cutout are the start.",
        label="H",
        file="in",
        empty="none: give a camera with planes",
    )
    camera: str = opt(
        "",
        "Preset, camera file or scan plan to start from.",
        file="in",
        is_path=is_camera_file,
        examples=preset_names,
        empty="the camera of H",
    )
    depths: tuple[float, ...] = depths_field("the planes of H or of the plan")
    virtual_depths: tuple[float, ...] = virtual_depths_field("the planes of H or of the plan")
    cutout: tuple[int, int] | None = cutout_field("H or the plan", more=True)
    unknowns: str = opt(
        "auto",
        "Groups of unknowns to fit, separated by commas. auto: gap, rotation, offset and pitch of the array, focal "
        "lengths, iris and wavefront.",
        examples=("auto",),
        read=read_unknowns,
        more=True,
    )
    windows: int | None = windows_field("to which the camera is fitted")
    noise: tuple[float, float] | None = noise_field("as stated by the frames")
    orientation: str = turn_field()
    channel: str = channel_field()
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")
    write_h: bool = opt(True, "Compute and write H of the fitted camera.", label="Compute H", flag="--no-h")

    def __post_init__(self) -> None:
        """Check every field and the combinations that exclude each other."""
        super().__post_init__()
        given = [name for name in ("camera", "depths", "virtual_depths", "cutout") if getattr(self, name)]
        if self.psf is not None and given:
            raise InputError.expected(
                "start of the recalibration",
                "either H or a camera with planes",
                f"H and {given[0].replace('_', ' ')}",
                "leave one out",
            )
        if self.psf is None and not self.camera:
            raise InputError.expected(
                "start of the recalibration", "H, or a camera with planes", "neither", "give one of them"
            )

    def files(self, way: str) -> tuple[Path, ...]:
        """Return the files that the task reads (``way="in"``) or writes (``way="out"``).

        The files to write are those in the folder ``out``.
        """
        from lfcal.recalibrate import recalibration_outputs

        return recalibration_outputs(self.out, with_h=self.write_h) if way == "out" else super().files(way)

    def work(self, run: RunSettings | None = None) -> Work[tuple[Recalibrated, ...]]:
        """Read the frames and recalibrate the camera. If it explains the frames, write the results."""
        from lfcal.recalibrate import iter_recalibrate, iter_write_recalibration
        from lfcal.work import discard

        workers = run.workers if run else None
        plan = self._plan()
        groups = None if self.unknowns == "auto" else self.unknowns.split(",")
        with ExitStack() as stack:
            reading = ObjectFrameReading(plan, self.orientation, self.channel, self.corrections)
            frames = list(reading.frames(self.frames, stack))
            steps = self._steps(run or RunSettings())
            work = iter_recalibrate(
                frames, plan, noise=self.noise, unknowns=groups, windows=self.windows, workers=workers, steps=steps
            )
            found = yield from work
        known = {"sources": [path.name for path in self.frames], "task": self.to_dict(absolute=True, outputs=False)}
        writing = iter_write_recalibration(found, self.out, known, with_h=self.write_h, workers=workers)
        files = yield from writing
        discard(steps)
        return (Recalibrated(found=found, out=self.out, files=files),)

    def _steps(self, run: RunSettings) -> Path:
        """Return the folder for finished steps.

        The steps of a stopped run are kept with ``resume`` and deleted with ``force``; otherwise they raise an error.
        """
        from lfcal.work import discard, parts_folder

        found = parts_folder(self.out)
        if run.force and not run.resume:
            discard(found)
        if found.exists() and not run.resume:
            raise InputError(
                f"{found}: contains the finished steps of a stopped run; continue from them (--resume), or start again "
                "(--force)"
            )
        return found

    def _plan(self) -> ScanPlan:
        """Return the scan plan with the camera to start from."""
        from lfcal.judge import plan_of

        if self.psf is None:
            return planned_scan(self.camera, self.depths, self.virtual_depths, self.cutout)
        with open_upright(self.psf) as matrix:
            plan = plan_of(matrix)
        if plan is None:
            raise InputError.expected(
                str(self.psf), "an H with its camera", "an H without one", "give the camera and the planes instead"
            )
        return plan


FIT_FRAMES = TaskSet(
    "fit frames", (Recalibrate,), lambda given: Recalibrate, "lfcal fit frames frame.tif --psf H.h5 -o monday/"
)
