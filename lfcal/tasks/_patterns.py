"""Read the patterns to fit or predict, from an H file or from the chosen positions of frames."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import FileFormatError, InputError, LfcalError, Work, check_number, note, read_text
from lfcal.records import CorrectionRecipe, opt, read_orientation
from lfcal.tasks._scan_frames import ScanFrames, find_plan, orientations
from lfcal.tasks.cameras import note_assumed
from lfcal.tasks.matrices import open_matrix

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import Camera, ScanPlan
    from lfcal.fit import Measured, StoredFit
    from lfcal.frames import FrameSource
    from lfcal.psf import PSFMatrix

__all__ = [
    "NO_PLACE",
    "SOME",
    "PatternReading",
    "check_colours",
    "is_matrix",
    "iter_patterns",
    "iter_upright_scan",
    "most_taken",
    "names_of",
    "noise_field",
    "open_upright",
    "orientation_field",
    "own_words",
    "positions_field",
    "without_positions",
]

SOME = 40
"""Default number of positions used from a source that has more."""

NO_PLACE = ", (z, y, x) = (0, 0, 0)"
"""The position that errors name for a single frame; it is removed where positions have no meaning."""


def _read_noise(text: str) -> tuple[float, float] | None:
    """Return constant and slope of a variance written as ``64,1``; None for an empty string."""
    if not text.strip():
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 2:
        wanted = "CONSTANT,SLOPE of the variance of a sample"
        raise InputError.expected(
            "noise", wanted, repr(text), "give a constant and a slope: 64,1 means the variance 64 + 1 x value"
        )
    for value in values:
        check_number("noise", value, at_least=0)
    if not sum(values):
        raise InputError.expected(
            "noise", "a variance above 0", repr(text), "give a constant and a slope, one of them above 0: 64,1"
        )
    return values[0], values[1]


def noise_field(empty: str = "as the source states") -> tuple[float, float] | None:
    """Declare the field ``noise`` of a task; ``empty`` says what applies if it is not set."""
    words = "Noise of a sample of value v, as CONSTANT,SLOPE: its variance (counts²) is CONSTANT + SLOPE x v."
    return opt(None, words, empty=empty, read=_read_noise, show=lambda value: f"{value[0]!r},{value[1]!r}")


def positions_field(help: str) -> int | None:
    """Declare the field ``positions`` of a task that reads patterns."""
    return opt(None, help, at_least=0, empty=f"{SOME}, or all positions of a session with chosen positions")


def orientation_field() -> str:
    """Declare the field ``orientation`` of a task that reads frames."""
    words = (
        "How to turn the frames upright: as-is, rot90, rot180, rot270 (anticlockwise), mirror-x (left to right), "
        "mirror-y, transpose, anti-transpose. auto: find the orientation. check: as-is, but stop if that is "
        "clearly wrong."
    )
    return opt("check", words, choices=orientations, read=read_orientation)


def most_taken(asked: int | None, aside: Sequence[object]) -> int:
    """Return the number of positions to use (0: all); by default 40, or all in a session of chosen positions."""
    return (0 if aside else SOME) if asked is None else asked


@dataclass(frozen=True)
class PatternReading:
    """Settings for reading patterns.

    Attributes
    ----------
    camera
        The camera before the fit. None: the camera of H or of the plan.
    most
        Number of positions to use, spread evenly. 0: all. None: 40, or all in a session of chosen positions.
    noise
        Constant (counts²) and slope (counts) of the variance of a sample. None: as stated by the source.
    plan
        Scan plan of frames, or of an H that has no camera.
    recipe
        Corrections of frames. None: the default ones; set it unless all sources are H.
    orientation
        Operation that turns the frames upright.
    fit
        A fit whose positions are left out if the source is the scan that was fitted. None: no fit.
    """

    camera: Camera | None = None
    most: int | None = None
    noise: tuple[float, float] | None = None
    plan: Path | None = None
    recipe: CorrectionRecipe | None = None
    orientation: str = "check"
    fit: StoredFit | None = None

    def described(self, matrix: PSFMatrix, source: Path) -> PSFMatrix:
        """Return H with its camera. If H has none, camera, depths and anchor are taken from the plan."""
        from lfcal.camera import ScanPlan
        from lfcal.psf import PSFMatrix

        if self.plan is None:
            return matrix
        if matrix.camera is not None:
            if self.recipe is None:
                got = f"{source.name}, which contains its camera"
                raise InputError.expected("--plan", "an H without a camera", got, "leave the plan out (--plan)")
            return matrix
        plan = ScanPlan.from_json(read_text(self.plan))
        if plan.shape != matrix.shape:
            wanted = f"a plan of the shape {matrix.shape} of H"
            raise InputError.expected(
                f"{source.name}, plan",
                wanted,
                f"one of shape {plan.shape}",
                "give the plan by which this H was recorded",
            )
        facts, depths = matrix.facts, plan.depths_um
        return PSFMatrix(matrix.planes, depths=depths, camera=plan.camera, anchor=plan.anchor, facts=facts)


def names_of(sources: Sequence[Path]) -> list[str]:
    """Return the names of the regions, from their files or folders; raises `InputError` if two are equal."""
    from lfcal.fit import REPORT

    names = [path.stem if path.suffix else path.name for path in sources]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError.expected(
            "sources", "a different name for each region", f"{twice} twice", "rename one of the files"
        )
    if REPORT in names:
        raise InputError.expected(
            "sources",
            "a region with another name",
            f"{REPORT}, which is the name of the common report",
            "rename the region",
        )
    return names


def is_matrix(path: Path) -> bool:
    """Return whether a file is an H file; any other HDF5 file is treated as frames."""
    suffix = path.suffix.lower()
    if path.is_dir() or suffix not in (".h5", ".hdf5", ".npy", ".mat", ".lfc"):
        return False
    if suffix not in (".h5", ".hdf5"):
        return True
    from lfcal.base.h5 import H5File
    from lfcal.psf import FORMAT

    with H5File(path) as file:
        return file.attributes().text("format") == FORMAT


@contextmanager
def own_words(without: str = "") -> Iterator[None]:
    """Return a context that removes the text ``without`` and options of other commands from error messages.

    If ``without`` is empty, the option to leave out damaged frames is named as one of ``lfcal assemble``.
    """
    try:
        yield
    except LfcalError as error:
        said = str(error)
        # frames without positions cannot be assembled
        skipped = said.replace(" (--skip-damaged)", "" if without else " (lfcal assemble --skip-damaged)")
        reported = skipped.replace(' (colour="G")', "")
        reported = reported.replace(without, "") if without else reported
        if reported == said:
            raise
        raise type(error)(reported) from None


def open_upright(path: Path, *, quiet: bool = False) -> PSFMatrix:
    """Open the H of a file; if the file contains HT, return the transpose of it."""
    matrix = open_matrix(path, quiet=quiet)
    return matrix.T if matrix.is_transposed else matrix


def iter_patterns(source: Path, how: PatternReading) -> Work[tuple[Measured, dict[str, Any]]]:
    """Return the patterns of a source, and an entry on the source for the provenance of results."""
    import numpy as np

    from lfcal.camera import ScanPlan
    from lfcal.fit import HELD_OUT, check_optics, kept_aside, measured_of

    with ExitStack() as stack:
        if is_matrix(source):
            matrix = how.described(stack.enter_context(open_upright(source)), source)
            known: dict[str, Any] = {"source": source.name}
            aside = kept_aside(matrix)
        else:
            matrix, known, aside = yield from _iter_picked(source, how, stack)
        camera = how.camera or matrix.camera or (how.fit.setup.camera if how.fit else None)
        if camera is None:
            raise InputError.expected(
                str(source), "an H with its camera", "an H without one", "state the camera (--camera)"
            )
        check_optics(matrix)
        noise, words = _noise_of(matrix, source, how.noise)
        if words:
            note(words)
            known["noise"] = matrix.provenance["noise"]
        note_assumed(matrix.camera if how.camera is None else None, source.name)
        if how.fit is not None:
            depths = tuple(float(z) for z in matrix.depths)
            plan = ScanPlan(camera, matrix.period, matrix.cutout, depths, matrix.anchor)
            if how.fit.positions and how.fit.is_of(plan):
                left = _left(source, np.argwhere(matrix.recorded > 0), how, plan)
                return measured_of(matrix, camera, positions=left, noise=noise), known
        most = most_taken(how.most, aside)
        all_of_them = not most or int((matrix.recorded > 0).sum()) <= most
        apart = aside if aside and all_of_them else HELD_OUT
        return measured_of(matrix, camera, noise=noise, most=most or None, held_out=apart), known


def _left(
    source: Path, index: NDArray[np.intp], how: PatternReading, plan: ScanPlan, aside: Sequence[object] = ()
) -> NDArray[np.intp]:
    """Return at most the requested number of positions that were not fitted, spread evenly."""
    from lfcal.fit import spread_out

    most, fit = most_taken(how.most, aside), how.fit
    without = fit.positions if fit is not None and fit.is_of(plan) else frozenset()
    found = index[[tuple(at) not in without for at in index.tolist()]] if len(index) else index
    if not len(found):
        remedy = "fit fewer positions, or give another recording"
        raise InputError.expected(
            f"{source}, recorded positions", "at least one position that was not fitted", "none", remedy
        )
    return found[spread_out(found, most, plan.period)] if most and len(found) > most else found


def _noise_of(
    matrix: PSFMatrix, source: Path, given: tuple[float, float] | None
) -> tuple[tuple[float, float] | None, str]:
    """Return the noise to use (None if H states a variance), and a description of its source if it was derived.

    Raises
    ------
    InputError
        If the noise is unknown, or H states it for samples above a black level.
    """
    import numpy as np

    from lfcal.psf import noise_of

    if given is not None:
        return given, ""
    found, words = noise_of(matrix.provenance), ""
    if found is not None:
        words = f"noise of the frames: {found.source} (variance {found.floor:.3g} + {found.slope:.3g} x signal)"
    known = matrix.facts.noise
    stated = None if known is None else known[matrix.recorded > 0]
    if stated is not None and np.isfinite(stated).all():
        # with the black level, the variance is smallest at that level; extrapolated to 0 it would be negative
        if (stated[:, 0] < 0).any():
            wanted, remedy = (
                "samples without the black level",
                "subtract dark frames or the black level (--dark or --black-level)",
            )
            raise InputError.expected(f"{source}, samples", wanted, "samples that include it", remedy)
        return None, words
    if found is not None:
        return (found.floor, found.slope), words
    got, remedy = "none", "state the noise (--noise CONSTANT,SLOPE)"
    marks = None if matrix.camera is None else matrix.camera.marks
    if marks is not None and "assumed" in (marks["sensor.read_noise_e"], marks["sensor.full_well_e"]):
        got = "a sensor whose read noise or full well is assumed"
        remedy = f"state these values (lfcal camera new --set sensor.read_noise_e=…), or {remedy}"
    raise InputError.expected(f"{source}, noise", "a known variance of the samples", got, remedy)


LISTED = ("--order", "--manifest", "--pattern")
"""Options of ``lfcal assemble`` that state positions; ``lfcal fit`` has none of them."""


def assembled_first(source: Path, plan: Path | None, *options: str) -> str:
    """Return the remedy: assemble H of ``source`` with the given options, then fit that H."""
    words = ["lfcal", "assemble", str(source), *(["--plan", str(plan)] if plan else []), *options, "-o", "H.h5"]
    return f"run {shlex.join(words)}, then lfcal fit H.h5"


def of_one_channel(source: Path, plan: Path | None, colours: Sequence[str]) -> str:
    """Return the remedy for frames of several ``colours``: assemble green, which has the most light, or the first."""
    green = [name for name in ("G", "G1") if name in colours]
    return assembled_first(source, plan, "--channel", [*green, *colours][0])


def without_positions(
    error: InputError, source: Path, plan: Path | None, recipe: CorrectionRecipe | None, matrix: Path | None = None
) -> InputError:
    """Return ``error`` with a remedy for this command, if it is about positions that ``source`` does not state.

    ``plan`` and ``recipe`` are those that were given. If the frames of exactly one subfolder state their positions, the
    message names this folder. ``matrix`` is the H to check with the frames; it shows the
    positions of single frames. None in a fit.
    """
    said, _, remedy = str(error).partition("; ")
    if not any(option in remedy for option in LISTED):
        return error
    below = _below(source, plan)
    if below is not None:
        command = ["fit"] if matrix is None else ["fit", "check", str(matrix)]
        words = ["lfcal", *command, str(below), *(["--plan", str(plan)] if plan else [])]
        given = str(recipe.dark if recipe else "") or (str(source / "dark") if (source / "dark").is_dir() else "")
        return InputError(f"{said}; run {shlex.join([*words, *(['--dark', given] if given else [])])}")
    if matrix is not None:
        return InputError(
            f"{said}; give the files of single frames instead of {source}, because the positions of their "
            "sources can be found in H"
        )
    named = re.search(r"give --pattern '([^']+)'", remedy)
    if named:
        return InputError(f"{said}; {assembled_first(source, plan, '--pattern', named.group(1))}")
    if "raster" in remedy:
        reported = assembled_first(source, plan, "--order", "serpentine")
        return InputError(f"{said}; {reported} (or --order raster, or --manifest LIST)")
    return InputError(f"{said}; {assembled_first(source, plan, '--manifest', 'LIST.csv')}")


def _below(source: Path, plan: Path | None) -> Path | None:
    """Return the only folder in ``source`` whose frames state their positions, or None."""
    from lfcal.frames import open_frames

    if not source.is_dir():
        return None
    found = []
    for folder in sorted(path for path in source.iterdir() if path.is_dir() and not path.name.startswith(".")):
        try:
            with open_frames(folder, plan=find_plan(folder, plan)) as frames:
                found += [folder] if len(frames) else []
        except LfcalError:
            continue
    return found[0] if len(found) == 1 else None


def check_colours(source: Path, frames: FrameSource, plan: ScanPlan, remedy: Callable[[Sequence[str]], str]) -> None:
    """Raise `InputError` if frames have several colours; ``remedy`` returns the remedy for these colours."""
    from lfcal.frames import colours_of

    if colours := colours_of(frames, plan):
        got = f"a mosaic of {', '.join(colours)}"
        raise InputError.expected(str(source), "frames of one colour", got, remedy(colours))


def iter_upright_scan(
    source: Path, how: PatternReading, stack: ExitStack, remedy: Callable[[Sequence[str]], str]
) -> Work[tuple[FrameSource, ScanPlan, dict[str, Any]]]:
    """Return the frames of a scan, corrected and upright, their plan, and how they were turned.

    ``remedy`` is as in `check_colours`.
    """
    from lfcal.frames import corrected_view, oriented
    from lfcal.psf import iter_upright

    frames, plan = ScanFrames(source, how.plan, orientation=how.orientation).open()
    stack.enter_context(frames)
    check_colours(source, frames, plan, remedy)
    for one in frames.metadata.notes:
        note(one)
    corrected = corrected_view(frames, how.recipe or CorrectionRecipe(), plan)
    turn, lie = yield from iter_upright(corrected, plan, how.orientation)
    return oriented(corrected, turn, plan.camera.sensor.shape), plan, lie


def _iter_picked(
    source: Path, how: PatternReading, stack: ExitStack
) -> Work[tuple[PSFMatrix, dict[str, Any], list[list[int]]]]:
    """Return patterns cropped from corrected frames, an entry for the provenance, and the positions to hold out.

    ``source`` is a folder of frames or a session. All positions of a session chosen for a fit are used, unless their
    number is given.
    """
    import numpy as np

    from lfcal.acquire import NAME, SessionFile
    from lfcal.psf import iter_pick, scan_noise

    try:
        view, plan, lie = yield from iter_upright_scan(
            source, how, stack, lambda colours: of_one_channel(source, how.plan, colours)
        )
    except FileFormatError as error:
        # the library's argument is not an option of this command
        one = of_one_channel(source, how.plan, "RGB")
        raise FileFormatError(str(error).replace(' (colour="G")', f": {one}")) from None
    except InputError as error:
        raise without_positions(error, source, how.plan, how.recipe) from None
    if how.camera is not None:
        plan = replace(plan, camera=how.camera)
    index = np.unique(
        np.array([tuple(view.info(k).position) for k in range(len(view))], np.intp).reshape(-1, 3), axis=0
    )
    aside = [list(p) for p in view.metadata.kept_aside]
    taken = _left(source, index, how, plan, aside)
    with own_words():
        noise = scan_noise(view, plan) if how.noise is None else None
        matrix = yield from iter_pick(view, plan, taken, noise=noise)
    known: dict[str, Any] = {"source": source.name, "corrections": view.metadata.corrections, **lie}
    # the recording time of other frames is unknown: their file times may be those of a copy
    if (source / NAME).is_file() and (runs := SessionFile.read(source).runs):
        known = {"recorded": runs[-1].ended or runs[-1].started} | known
    return matrix, known, aside if len(taken) == len(index) else []
