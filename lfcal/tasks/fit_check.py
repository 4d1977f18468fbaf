"""Whether an old H still holds, from new frames."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import InputError, Work
from lfcal.records import CorrectionRecipe, opt, panel, read_share, record, required
from lfcal.tasks._patterns import (
    SOME,
    PatternReading,
    check_colours,
    iter_upright_scan,
    noise_field,
    open_upright,
    orientation_field,
    own_words,
)
from lfcal.tasks.scan_frames import find_plan
from lfcal.tasks.task import RunSettings, Task, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.fit import Compared, NewFrame
    from lfcal.frames import FrameSource
    from lfcal.judge import Check
    from lfcal.psf import PSFMatrix

__all__ = ["FIT_CHECK", "CheckMatrix", "CheckMatrixByScan", "CheckedMatrix", "new_frame", "single_frames"]

NAMES = ("*z{z}_y{y}_x{x}.*", "*y{y}_x{x}.*")
"""Names of single files that say where their source is."""

ONE_COLOUR = "take one colour out of them, and the H of that colour"

NEAR_DEPTH = 0.02
"""Largest relative difference between a depth and that of its plane in H."""


@dataclass(frozen=True, kw_only=True)
class CheckedMatrix(TaskResult):
    """What new frames show of an old H."""

    check: Check
    matrix: Path
    frames: tuple[Path, ...]

    @property
    def failed(self) -> bool:
        """Whether H does not hold, or the frames do not decide it."""
        return self.check.holds is not True

    def to_dict(self) -> dict[str, Any]:
        """Return all of it as plain values."""
        return check_dict(self.check) | {"h": self.matrix, "frames_from": list(self.frames)}


@record
class CheckMatrix(Task):
    """Check whether an old H still holds for new frames of a point source.

    Nothing is fitted or written. Exit code 1: H does not hold, or the frames do not decide it.

    Examples
    --------
    >>> from lfcal.tasks import CheckMatrix
    >>> task = CheckMatrix(matrix="H.h5", frames="frame.tif", noise="64,1", limit="3%")
    >>> print(task.frames, task.noise, task.limit)
    (PosixPath('frame.tif'),) (64.0, 1.0) 0.03
    """

    name: ClassVar[str] = "fit check"
    input_words: ClassVar[str] = "files of single frames"

    matrix: Path = required("H file to check.", argument=True, file="in")
    frames: tuple[Path, ...] = required(
        "New frames of a point source: files, folders of frames, or recorded sessions.", argument=True, file="in"
    )
    limit: float = opt(0.02, "Largest error (relative L2) of an H that holds.", above=0, below=1, read=read_share)
    positions: int = opt(SOME, "Number of frames to take of each input, spread evenly; 0 takes all.", at_least=0)
    noise: tuple[float, float] | None = noise_field("as the frames or H state")
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
    """Check an old H by the frames of a scan.

    Examples
    --------
    >>> from lfcal.tasks import CheckMatrixByScan
    >>> print(CheckMatrixByScan(matrix="H.h5", frames="session", positions=10).files("in"))
    (PosixPath('H.h5'), PosixPath('session'))
    """

    input_words: ClassVar[str] = "a folder of frames"

    plan: Path | None = opt(None, "Scan plan (.json) of the frames.", short="-p", file="in", empty="with the frames")


def _iter_frames(H: PSFMatrix, source: Path, task: CheckMatrix, stack: ExitStack) -> Work[list[NewFrame]]:
    """Return the frames of a file, a folder or a session, with what is known of where their sources are."""
    import numpy as np

    from lfcal.acquire import NAME
    from lfcal.fit import spread_out
    from lfcal.frames import corrected_view, named_orientation, oriented
    from lfcal.judge import plan_of
    from lfcal.psf import AUTO, CHECK

    own, most, named = plan_of(H), task.positions, task.plan if isinstance(task, CheckMatrixByScan) else None
    if source.is_dir() and ((source / NAME).is_file() or find_plan(source, named) is not None):
        how = PatternReading(plan=named, recipe=task.corrections, orientation=task.orientation)
        view, plan, _ = yield from iter_upright_scan(source, how, stack, lambda _: ONE_COLOUR)
        _check_grid(H, view, plan, source)
        index = np.array([tuple(view.info(k).position) for k in range(len(view))], np.intp).reshape(-1, 3)
        taken = spread_out(index, most, plan.period) if most and len(index) > most else np.arange(len(index))
        return [_of_scan(H, view, plan, k) for k in taken.tolist()]
    single = single_frames(source, stack)
    if own is not None:
        check_colours(source, single, own, lambda _: ONE_COLOUR)
    seen: FrameSource = corrected_view(single, task.corrections, own)
    if task.orientation not in (AUTO, CHECK):
        shape = seen.shape if own is None else own.camera.sensor.shape
        seen = oriented(seen, named_orientation(task.orientation), shape)
    _check_grid(H, seen, own, source)
    names = np.unique(np.linspace(0, len(seen) - 1, most or len(seen)).astype(int))
    return [_of_file(H, seen, k) for k in names.tolist()]


def single_frames(source: Path, stack: ExitStack) -> FrameSource:
    """Return frames of which nobody knows the places: every page of a file, or of a folder's files."""
    from lfcal.base import StorageError
    from lfcal.frames import FolderSource, FrameEntry, Manifest, Position, natural_key, open_image
    from lfcal.frames.formats import image_suffixes

    if not source.exists():
        raise StorageError(f"{source}: no such file or folder; check the name")
    if source.is_dir():
        files = sorted((p.name for p in source.iterdir() if p.suffix.lower() in image_suffixes()), key=natural_key)
        if not files:
            raise InputError.expected(f"frames in {source}", "images", "none", "name the folder that holds them")
        root = source
    else:
        root, files = source.parent, [source.name]
    entries = []
    for name in files:
        with own_words():
            image = open_image(root / name)
        try:
            entries += [FrameEntry(name, Position(0, 0, 0), page) for page in range(image.pages)]
        finally:
            image.close()
    return stack.enter_context(FolderSource(root, Manifest(tuple(entries))))


def _check_grid(H: PSFMatrix, view: FrameSource, plan: ScanPlan | None, source: Path) -> None:
    """Raise unless pixels of the frames are pixels of H's sensor."""
    if H.camera is None:
        return
    wanted = H.camera.sensor.shape
    origin = view.info(0).origin
    if origin == (0, 0) and view.shape != wanted and (plan is None or plan.camera.sensor.shape != view.shape):
        raise InputError.expected(f"{source}, pixels", f"{wanted} as H's camera", view.shape, "take whole frames of it")
    if plan is not None and plan.camera.sensor.shape != wanted:
        got = plan.camera.sensor.shape
        raise InputError.expected(f"{source}, sensor", f"{wanted} pixels as H's camera", got, "name the H of this one")


def _of_scan(H: PSFMatrix, view: FrameSource, plan: ScanPlan, k: int) -> NewFrame:
    import numpy as np

    info = view.info(k)
    z, y, x = info.position
    drift = info.drift or (0.0, 0.0)
    place = (plan.anchor[0] + y + drift[0], plan.anchor[1] + x + drift[1])
    depth = plan.depths_um[z]
    nearest = int(np.abs(H.depths - depth).argmin())
    if abs(float(H.depths[nearest]) - depth) > NEAR_DEPTH * max(abs(depth), 1.0):
        got = f"{depth:.6g} µm"
        wanted = "a depth of H, " + ", ".join(f"{v:.6g}" for v in H.depths[:6]) + " µm"
        raise InputError.expected(f"{info.label}, depth", wanted, got, "name an H of these depths")
    return new_frame(view, k, place, nearest, info.label)


def _of_file(H: PSFMatrix, view: FrameSource, k: int) -> NewFrame:
    """Return a frame of a file of its own, whose name may say where its source is."""
    from lfcal.frames import NamePattern

    label = view.info(k).label
    found = next((at for one in NAMES if (at := NamePattern(one).parse(label)) is not None), None)
    nz, ny, nx = H.shape[:3]
    if found is None or not (found[0].z < nz and found[0].y < ny and found[0].x < nx):
        return new_frame(view, k, None, 0 if nz == 1 else None, label)
    z, y, x = found[0]
    named = NamePattern(NAMES[0]).parse(label) is not None
    return new_frame(view, k, (H.anchor[0] + y, H.anchor[1] + x), z if named or nz == 1 else None, label)


def new_frame(view: FrameSource, k: int, place: tuple[float, float] | None, plane: int | None, label: str) -> NewFrame:
    """Return frame ``k`` of a corrected view with its noise, where that is known."""
    import numpy as np

    from lfcal.fit import NewFrame

    with own_words(without="" if place else ", (z, y, x) = (0, 0, 0)"):
        samples = view.samples(k)
    noise = None
    if samples.noise is not None:
        typical = samples.noise.typical(samples.values)
        noise = (float(typical.constant), float(typical.slope))
    values = np.asarray(samples.values, np.float32)
    return NewFrame(values, samples.valid, noise, view.info(k).origin, place, plane, label)


def check_dict(found: Check) -> dict[str, Any]:
    """Return what was found as plain types."""
    from lfcal.base import plain
    from lfcal.judge import judgement_of

    error, chi2 = found.error, found.chi_square
    result: dict[str, Any] = plain(
        {
            "format": "lfcal-check",
            "version": 1,
            "answer": found.answer,
            "limit": found.limit,
            "error": {"known": error.known, "value": error.value, "sigma": error.sigma, "limit": error.limit},
            "stated_error": found.stated,
            "doubt": found.doubt,
            "chi2": {"lit": chi2.lit, "sigma": chi2.sigma, "excess": chi2.excess, "all_pixels": chi2.all_pixels},
            "noise_from": found.noise_from,
            "model_misfit": found.model_misfit,
            "notes": found.notes,
            "frames": [_frame_dict(one) for one in found.frames],
            "suspects": [
                {
                    "name": one.name,
                    "shows": one.shows,
                    "error": one.error,
                    "sigma": one.sigma,
                    "left": one.left,
                    "values": [
                        {"name": name, "change": value, "sigma": sigma, "unit": unit}
                        for name, value, sigma, unit in one.values
                    ],
                }
                for one in found.suspects
            ],
            **judgement_of(found).to_dict(),
        }
    )
    return result


def _frame_dict(one: Compared) -> dict[str, Any]:
    at = one.found
    return {
        "label": one.label,
        "position": [at.z, at.y, at.x],
        "pixel": [at.row, at.column],
        "correlation": at.correlation,
        "displacement_px": one.displacement_px,
        "displacement_sigma_px": one.displacement_sigma,
        "beside_px": one.beside_px,
        "light": one.gain,
        "background": one.background,
        "error": {"known": one.error.known, "value": one.error.value, "limit": one.error.limit},
        "chi2": one.chi_square.lit,
    }


def kind_of(given: Mapping[str, Any]) -> type[Task]:
    """Return which kind of frames H is checked by."""
    return CheckMatrixByScan if any(Path(one).is_dir() for one in given["frames"]) else CheckMatrix


FIT_CHECK = TaskSet("fit check", (CheckMatrix, CheckMatrixByScan), kind_of, "lfcal fit check old.h5 frame.tif")
