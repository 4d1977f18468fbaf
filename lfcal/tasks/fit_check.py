"""Check an old H with new frames."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work
from lfcal.records import CorrectionRecipe, opt, panel, read_share, record, required
from lfcal.tasks._patterns import (
    NO_PLACE,
    SOME,
    PatternReading,
    check_colours,
    iter_upright_scan,
    noise_field,
    open_upright,
    orientation_field,
    own_words,
    without_positions,
)
from lfcal.tasks._scan_frames import find_plan
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.fit import NewFrame
    from lfcal.frames import FrameSource
    from lfcal.judge import Check
    from lfcal.psf import PSFMatrix

__all__ = ["FIT_CHECK", "CheckMatrix", "CheckMatrixByScan", "CheckedMatrix"]

ONE_COLOUR = "extract one colour, and use the H of that colour"


@dataclass(frozen=True, kw_only=True)
class CheckedMatrix(TaskResult):
    """Result of checking an old H with new frames.

    ``check`` is the result, ``matrix`` the file of H, and ``frames`` the files, folders or sessions with the frames.
    """

    check: Check
    matrix: Path
    frames: tuple[Path, ...]

    @property
    def failed(self) -> bool:
        """Whether H is no longer valid, or the frames are not sufficient to decide."""
        return self.check.holds is not True

    def _values(self) -> dict[str, Any]:
        return self.check.to_dict() | {"h": self.matrix, "frames_from": list(self.frames)}


@record
class CheckMatrix(Task):
    """Check whether an old H is still valid, with new frames of a point source.

    Nothing is fitted or written. Exit code 1: H is no longer valid, or the frames are not sufficient to decide.

    Examples
    --------
    >>> from lfcal.tasks import CheckMatrix, CheckMatrixByScan
    >>> task = CheckMatrix(matrix="H.h5", frames="frame.tif", noise="64,1", limit="3%")
    >>> print(task.frames, task.noise, task.limit)
    (PosixPath('frame.tif'),) (64.0, 1.0) 0.03
    >>> other = CheckMatrixByScan(matrix="H.h5", frames="session", positions=10)
    """

    name: ClassVar[str] = "fit check"
    input_words: ClassVar[str] = "files of single frames"

    matrix: Path = required("H file to check.", argument=True, file="in")
    frames: tuple[Path, ...] = required(
        "New frames of a point source: files, folders of frames, or recorded sessions.", argument=True, file="in"
    )
    limit: float = opt(
        0.02, "Largest error (relative L2) at which H is still valid.", above=0, below=1, read=read_share
    )
    positions: int = opt(SOME, "Number of frames to use from each input, spread evenly. 0 uses all frames.", at_least=0)
    noise: tuple[float, float] | None = noise_field("as stated by the frames or H")
    orientation: str = orientation_field()
    corrections: CorrectionRecipe = panel(CorrectionRecipe(), "Corrections")

    def work(self, run: RunSettings | None = None) -> Work[tuple[CheckedMatrix, ...]]:
        """Compare the frames with H."""
        from lfcal.judge import iter_check

        with open_upright(self.matrix) as H, ExitStack() as stack:
            frames = []
            for source in self.frames:
                frames += yield from _iter_frames(H, source, self, stack)
            found = yield from iter_check(H, frames, noise=self.noise, limit=self.limit)
        return (CheckedMatrix(check=found, matrix=self.matrix, frames=self.frames),)


@record
class CheckMatrixByScan(CheckMatrix):
    """Check an old H with the frames of a scan."""

    input_words: ClassVar[str] = "a folder of frames"

    plan: Path | None = opt(
        None, "Scan plan (.json) of the frames.", short="-p", file="in", empty="stored with the frames"
    )


def _iter_frames(H: PSFMatrix, source: Path, task: CheckMatrix, stack: ExitStack) -> Work[list[NewFrame]]:
    """Return the frames of a file, a folder or a session, with the positions of their sources if they are known."""
    from lfcal.acquire import NAME
    from lfcal.frames import corrected_view, named_orientation, open_unplaced, oriented
    from lfcal.judge import new_frames, plan_of
    from lfcal.psf import AUTO, CHECK

    named = task.plan if isinstance(task, CheckMatrixByScan) else None
    if source.is_dir() and ((source / NAME).is_file() or find_plan(source, named) is not None):
        how = PatternReading(plan=named, recipe=task.corrections, orientation=task.orientation)
        try:
            view, plan, _ = yield from iter_upright_scan(source, how, stack, lambda _: ONE_COLOUR)
        except InputError as error:
            raise without_positions(error, source, named, task.corrections, task.matrix) from None
        return new_frames(H, view, str(source), plan, most=task.positions)
    own = plan_of(H)
    with own_words():
        single = stack.enter_context(open_unplaced(source))
    if own is not None:
        check_colours(source, single, own, lambda _: ONE_COLOUR)
    seen: FrameSource = corrected_view(single, task.corrections, own)
    if task.orientation not in (AUTO, CHECK):
        shape = seen.shape if own is None else own.camera.sensor.shape
        seen = oriented(seen, named_orientation(task.orientation), shape)
    with own_words(without=NO_PLACE):
        return new_frames(H, seen, str(source), most=task.positions)


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task that checks H with the ``given`` frames."""
    return CheckMatrixByScan if any(Path(one).is_dir() for one in given["frames"]) else CheckMatrix


FIT_CHECK = TaskSet("fit check", (CheckMatrix, CheckMatrixByScan), kind_of, "lfcal fit check old.h5 frame.tif")
