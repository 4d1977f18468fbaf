"""What ``lfcal fit`` reads: an H file, or frames, of which no more than the chosen positions are cut out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lfcal.base import FileFormatError, InputError, LfcalError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.camera import Camera
    from lfcal.fit import Measured
    from lfcal.frames import CorrectionRecipe
    from lfcal.psf import PSFMatrix

__all__ = [
    "PatternReading",
    "check_frame_options",
    "is_matrix",
    "open_upright",
    "own_words",
    "parse_noise",
    "read_patterns",
]

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
    without
        Positions (z, y, x) that are not taken.
    """

    camera: Camera | None
    most: int | None
    noise: tuple[float, float] | None
    plan: Path | None
    recipe: CorrectionRecipe
    orientation: str
    without: frozenset[tuple[int, int, int]] = frozenset()


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


def check_frame_options(given: Mapping[str, object], frames: Sequence[Path | None]) -> None:
    """Raise where options of frames were ``given``, and none of the sources that they apply to holds frames."""
    option = next((name for name, said in given.items() if said), None)
    if option is not None and not any(path is not None and not is_matrix(path) for path in frames):
        raise InputError.expected(option, "frames, which it applies to", "H alone", "leave it out")


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


def open_upright(path: Path) -> PSFMatrix:
    """Return the H of a file, which may hold HT."""
    from lfcal.tasks import open_matrix

    matrix = open_matrix(path)
    return matrix.T if matrix.is_transposed else matrix


def parse_noise(text: str) -> tuple[float, float] | None:
    """Return constant and slope of a variance written as ``64,1``; None for empty."""
    if not text:
        return None
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 2:
        wanted = "CONSTANT,SLOPE of the variance of a sample"
        raise InputError.expected("--noise", wanted, repr(text), "for example 64,1: variance 64 + 1 x value")
    return values[0], values[1]


def read_patterns(source: Path, how: PatternReading, *, quiet: bool) -> tuple[Measured, dict[str, Any]]:
    """Return the patterns to fit, and what is known of their source for the provenance of what is made of them."""
    from lfcal.cli._console import report_notes
    from lfcal.fit import HELD_OUT, check_optics, measured_of
    from lfcal.tasks import tell_assumed

    with ExitStack() as stack:
        if is_matrix(source):
            matrix = stack.enter_context(open_upright(source))
            known: dict[str, Any] = {"source": source.name}
            aside = _aside_of(matrix)
        else:
            matrix, known, aside = _picked(source, how, stack, quiet=quiet)
        camera = how.camera or matrix.camera
        if camera is None:
            raise InputError.expected(str(source), "an H with its camera", "none", "name it with --camera")
        check_optics(matrix)
        how, words = _with_noise(matrix, how)
        _check_noise(matrix, source, how)
        report_notes([words] if words else [])
        known |= {"noise": matrix.provenance["noise"]} if words else {}
        tell_assumed(matrix.camera if how.camera is None else None, source.name, quiet=quiet)
        if how.without:
            left = _left(np.argwhere(matrix.recorded > 0), how, matrix.period)
            if not len(left):
                raise _none_left(source)
            return measured_of(matrix, camera, positions=left, noise=how.noise), known
        most = _most(how, aside)
        all_of_them = not most or int((matrix.recorded > 0).sum()) <= most
        apart = aside if aside and all_of_them else HELD_OUT
        return measured_of(matrix, camera, noise=how.noise, most=most or None, held_out=apart), known


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
    remedy = "fit fewer with --positions, or name another session with --validate-on"
    return InputError.expected(f"{source}, recorded positions", "some besides those fitted", "none", remedy)


def _left(
    index: NDArray[np.intp], how: PatternReading, period: tuple[int, int], aside: list[list[int]] | None = None
) -> NDArray[np.intp]:
    """Return positions that may be taken, spread evenly, no more than are asked for."""
    from lfcal.fit import spread_out

    most = _most(how, aside or [])
    found = index[[tuple(at) not in how.without for at in index.tolist()]] if len(index) else index
    return found[spread_out(found, most, period)] if most and len(found) > most else found


def _with_noise(matrix: PSFMatrix, how: PatternReading) -> tuple[PatternReading, str]:
    """Return how patterns are read, with the noise that H states of its frames, and where that is known from."""
    from lfcal.psf import noise_of

    found = noise_of(matrix.provenance)
    if how.noise is not None or found is None:
        return how, ""
    known = matrix.facts.noise
    if known is None or not np.isfinite(known[matrix.recorded > 0]).all():
        how = replace(how, noise=(found.floor, found.slope))
    return how, f"noise of the frames: {found.source} (variance {found.floor:.3g} + {found.slope:.3g} x signal)"


def _check_noise(matrix: PSFMatrix, source: Path, how: PatternReading) -> None:
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


def _picked(
    source: Path, how: PatternReading, stack: ExitStack, *, quiet: bool
) -> tuple[PSFMatrix, dict[str, Any], list[list[int]]]:
    """Return patterns of positions of a folder of frames or a session, corrected and cut out, and which to keep aside.

    Of a session of positions chosen for a fit all are taken, unless their number is given.
    """
    from lfcal.cli._console import report_notes, run_work
    from lfcal.cli._fit_first import of_one_channel, without_positions
    from lfcal.cli._orientation import upright
    from lfcal.frames import colours_of, corrected_view
    from lfcal.psf import iter_pick, scan_noise
    from lfcal.tasks import ScanFrames

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
    report_notes(frames.metadata.notes)
    view, lie = upright(corrected_view(frames, how.recipe, plan), plan, how.orientation, quiet=quiet)
    if how.camera is not None:
        plan = replace(plan, camera=how.camera)
    index = np.unique(
        np.array([tuple(view.info(k).position) for k in range(len(view))], np.intp).reshape(-1, 3), axis=0
    )
    aside = [list(p) for p in frames.metadata.kept_aside]
    taken = _left(index, how, plan.period, aside)
    if not len(taken):
        raise _none_left(source)
    with own_words():
        noise = scan_noise(view, plan) if how.noise is None else None
        matrix = run_work(iter_pick(view, plan, taken, noise=noise), quiet=quiet)
    known = _recorded(source) | {"source": source.name, "corrections": view.metadata.corrections, **lie}
    return matrix, known, aside if len(taken) == len(index) else []
