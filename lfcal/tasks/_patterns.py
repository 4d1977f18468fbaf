"""Patterns to fit or to predict: those of an H file, or of frames, of which only the chosen positions are cut out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import FileFormatError, InputError, LfcalError, Work
from lfcal.records import CorrectionRecipe
from lfcal.tasks._assembled_first import of_one_channel, without_positions
from lfcal.tasks.cameras import tell_assumed
from lfcal.tasks.matrices import open_matrix
from lfcal.tasks.notes import note
from lfcal.tasks.scan_frames import ScanFrames

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import Camera, ScanPlan
    from lfcal.fit import Measured, StoredFit
    from lfcal.psf import PSFMatrix

__all__ = [
    "SOME",
    "PatternReading",
    "is_matrix",
    "iter_patterns",
    "names_of",
    "open_upright",
    "own_words",
    "read_noise",
    "show_noise",
]

REPORT = "report"
"""Folder of the report of all regions."""

AS_RECORDED = CorrectionRecipe()

SOME = 40
"""Positions that are taken of a source that has more."""


@dataclass(frozen=True)
class PatternReading:
    """How patterns are read.

    Attributes
    ----------
    camera
        The camera as described; None takes that of H or of the plan.
    most
        Positions that are taken, spread evenly; 0: all; None: 40, or all of a session of chosen positions.
    noise
        Constant and slope of a sample's variance; None takes what the source states.
    plan
        Scan plan of frames.
    recipe
        Corrections of frames.
    orientation
        What makes frames upright.
    fit
        A fit whose positions are not taken, where the source is of the scan that was fitted.
    """

    camera: Camera | None = None
    most: int | None = None
    noise: tuple[float, float] | None = None
    plan: Path | None = None
    recipe: CorrectionRecipe = AS_RECORDED
    orientation: str = "check"
    fit: StoredFit | None = None

    def without(self, plan: ScanPlan) -> frozenset[tuple[int, int, int]]:
        """Return the positions (z, y, x) of a scan that are not taken."""
        return self.fit.positions if self.fit is not None and self.fit.is_of(plan) else frozenset()


def names_of(sources: Sequence[Path]) -> list[str]:
    """Return what the regions are called: as their files or folders are.

    Raises
    ------
    InputError
        If two have one name.
    """
    names = [path.stem if path.suffix else path.name for path in sources]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError.expected("sources", "regions of different names", f"{twice} twice", "rename a file")
    if REPORT in names:
        raise InputError.expected("sources", "a region of another name", f"{REPORT}, the folder of all", "rename it")
    return names


def is_matrix(path: Path) -> bool:
    """Return whether a file holds H; an HDF5 file of any other kind is taken for frames."""
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
    """Let errors name no option that this command lacks, nor ``without``, a position that nobody gave."""
    try:
        yield
    except LfcalError as error:
        said = str(error)
        told = said.replace("(--skip-damaged)", "(lfcal assemble --skip-damaged)")
        told = told.replace(' (colour="G")', "")
        told = told.replace(without, "") if without else told
        if told == said:
            raise
        raise type(error)(told) from None


def open_upright(path: Path, *, quiet: bool = False) -> PSFMatrix:
    """Return the H of a file, which may hold HT."""
    matrix = open_matrix(path, quiet=quiet)
    return matrix.T if matrix.is_transposed else matrix


def read_noise(text: str) -> tuple[float, float] | None:
    """Return constant and slope of a variance written as ``64,1``; None for empty."""
    if not text.strip():
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 2:
        wanted = "CONSTANT,SLOPE of the variance of a sample"
        raise InputError.expected("noise", wanted, repr(text), "for example 64,1: variance 64 + 1 x value")
    return values[0], values[1]


def show_noise(value: tuple[float, float]) -> str:
    """Return the text that `read_noise` reads."""
    return f"{value[0]!r},{value[1]!r}"


def iter_patterns(source: Path, how: PatternReading) -> Work[tuple[Measured, dict[str, Any]]]:
    """Return the patterns of a source, and what is known of it for the provenance of what is made of them."""
    import numpy as np

    from lfcal.fit import HELD_OUT, check_optics, measured_of

    with ExitStack() as stack:
        if is_matrix(source):
            matrix = stack.enter_context(open_upright(source))
            known: dict[str, Any] = {"source": source.name}
            aside = _aside_of(matrix)
        else:
            matrix, known, aside = yield from _iter_picked(source, how, stack)
        camera = how.camera or matrix.camera or (how.fit.setup.camera if how.fit else None)
        if camera is None:
            raise InputError.expected(str(source), "an H with its camera", "none", "name it with --camera")
        check_optics(matrix)
        how, words = _with_noise(matrix, how)
        _check_noise(matrix, source, how)
        if words:
            note(words)
        known |= {"noise": matrix.provenance["noise"]} if words else {}
        tell_assumed(matrix.camera if how.camera is None else None, source.name)
        if how.fit is not None and how.without(plan := _plan_of(matrix, camera)):
            left = _left(np.argwhere(matrix.recorded > 0), how, plan)
            if not len(left):
                raise _none_left(source)
            return measured_of(matrix, camera, positions=left, noise=how.noise), known
        most = _most(how, aside)
        all_of_them = not most or int((matrix.recorded > 0).sum()) <= most
        apart = aside if aside and all_of_them else HELD_OUT
        return measured_of(matrix, camera, noise=how.noise, most=most or None, held_out=apart), known


def _plan_of(matrix: PSFMatrix, camera: Camera) -> ScanPlan:
    from lfcal.camera import ScanPlan

    depths = tuple(float(z) for z in matrix.depths)
    return ScanPlan(camera, matrix.period, matrix.cutout, depths, matrix.anchor)


def _most(how: PatternReading, aside: list[list[int]]) -> int:
    """Return how many positions are taken, 0 for all: of a session that chose them, all."""
    return (0 if aside else SOME) if how.most is None else how.most


def _aside_of(matrix: PSFMatrix) -> list[list[int]]:
    """Return the positions that H says are not to be fitted; what is no such list says nothing."""
    said = matrix.provenance.get("kept_aside")
    shape = (matrix.shape[0], *matrix.period)
    # provenance comes from a file that anyone may have written
    good = isinstance(said, list) and all(
        isinstance(p, list)
        and len(p) == 3
        and all(type(v) is int and 0 <= v < n for v, n in zip(p, shape, strict=True))
        for p in said
    )
    return said if good and said else []


def _none_left(source: Path) -> InputError:
    remedy = "fit fewer positions, or name another recording"
    return InputError.expected(f"{source}, recorded positions", "some besides those fitted", "none", remedy)


def _left(
    index: NDArray[np.intp], how: PatternReading, plan: ScanPlan, aside: list[list[int]] | None = None
) -> NDArray[np.intp]:
    """Return positions that may be taken, spread evenly, no more than are asked for."""
    from lfcal.fit import spread_out

    most, without = _most(how, aside or []), how.without(plan)
    found = index[[tuple(at) not in without for at in index.tolist()]] if len(index) else index
    return found[spread_out(found, most, plan.period)] if most and len(found) > most else found


def _with_noise(matrix: PSFMatrix, how: PatternReading) -> tuple[PatternReading, str]:
    """Return how patterns are read, with the noise that H states of its frames, and where that is known from."""
    import numpy as np

    from lfcal.psf import noise_of

    found = noise_of(matrix.provenance)
    if how.noise is not None or found is None:
        return how, ""
    known = matrix.facts.noise
    if known is None or not np.isfinite(known[matrix.recorded > 0]).all():
        how = replace(how, noise=(found.floor, found.slope))
    return how, f"noise of the frames: {found.source} (variance {found.floor:.3g} + {found.slope:.3g} x signal)"


def _check_noise(matrix: PSFMatrix, source: Path, how: PatternReading) -> None:
    import numpy as np

    if how.noise is not None:
        return
    noise = None if matrix.facts.noise is None else matrix.facts.noise[matrix.recorded > 0]
    if noise is None or not np.isfinite(noise).all():
        got, remedy = "none", "state it with --noise CONSTANT,SLOPE"
        if _assumes_noise(matrix):
            got = "a sensor whose read noise or full well is assumed"
            remedy = "state them (camera new --set sensor.read_noise_e=…), or state it with --noise CONSTANT,SLOPE"
        raise InputError.expected(f"{source}, noise", "a variance of the samples", got, remedy)
    # of samples above a black level the variance begins there, and at 0 it would be below nothing
    if (noise[:, 0] < 0).any():
        raise InputError.expected(
            f"{source}, samples", "without their black level", "with it", "name --dark, or --black-level"
        )


def _assumes_noise(matrix: PSFMatrix) -> bool:
    """Return whether the camera has noise that nobody stated: it is counted with as little as if there were none."""
    marks = None if matrix.camera is None else matrix.camera.marks
    return marks is not None and "assumed" in (marks["sensor.read_noise_e"], marks["sensor.full_well_e"])


def _recorded(source: Path) -> dict[str, Any]:
    """Return when a session was recorded; nothing for other frames, whose files' times are those of a copy."""
    from lfcal.acquire import NAME, SessionFile

    if not (source / NAME).is_file():
        return {}
    ended = [run.ended or run.started for run in SessionFile.read(source).runs]
    return {"recorded": ended[-1]} if ended else {}


def _iter_picked(
    source: Path, how: PatternReading, stack: ExitStack
) -> Work[tuple[PSFMatrix, dict[str, Any], list[list[int]]]]:
    """Return patterns of positions of a folder of frames or a session, corrected and cut out, and which to keep aside.

    Of a session of positions chosen for a fit all are taken, unless their number is given.
    """
    import numpy as np

    from lfcal.frames import colours_of, corrected_view, oriented
    from lfcal.psf import iter_pick, iter_upright, scan_noise

    try:
        frames, plan = ScanFrames(source, how.plan, orientation=how.orientation).open()
    except FileFormatError as error:
        # the library's word for it is not an option here
        one = of_one_channel(source, how.plan, "RGB")
        raise FileFormatError(str(error).replace(' (colour="G")', f": {one}")) from None
    except InputError as error:
        raise without_positions(error, source, how.plan, str(how.recipe.dark)) from None
    stack.enter_context(frames)
    colours = colours_of(frames, plan)
    if colours:
        one = of_one_channel(source, how.plan, colours)
        raise InputError.expected(str(source), "frames of one colour", f"a mosaic of {', '.join(colours)}", one)
    for one in frames.metadata.notes:
        note(one)
    corrected = corrected_view(frames, how.recipe, plan)
    turn, lie = yield from iter_upright(corrected, plan, how.orientation)
    view = oriented(corrected, turn, plan.camera.sensor.shape)
    if how.camera is not None:
        plan = replace(plan, camera=how.camera)
    index = np.unique(
        np.array([tuple(view.info(k).position) for k in range(len(view))], np.intp).reshape(-1, 3), axis=0
    )
    aside = [list(p) for p in frames.metadata.kept_aside]
    taken = _left(index, how, plan, aside)
    if not len(taken):
        raise _none_left(source)
    with own_words():
        noise = scan_noise(view, plan) if how.noise is None else None
        matrix = yield from iter_pick(view, plan, taken, noise=noise)
    known = _recorded(source) | {"source": source.name, "corrections": view.metadata.corrections, **lie}
    return matrix, known, aside if len(taken) == len(index) else []
