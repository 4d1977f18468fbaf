"""What ``lfcal fit`` reads: an H file, or frames, of which no more than the chosen positions are cut out."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.errors import FileFormatError, InputError

if TYPE_CHECKING:
    from lfcal.camera import Camera
    from lfcal.fit import Measured
    from lfcal.frames import CorrectionRecipe
    from lfcal.psf import PSFMatrix

__all__ = ["Reading", "is_matrix", "open_upright", "parse_noise", "read_patterns"]


@dataclass(frozen=True)
class Reading:
    """How patterns are read.

    Attributes
    ----------
    camera
        The camera as described; None takes that of H or of the plan.
    most
        Positions that are taken, spread evenly; 0: all.
    noise
        Constant and slope of a sample's variance; None takes what the source states.
    plan
        Scan plan of frames.
    recipe
        Corrections of frames.
    orientation
        What makes frames upright.
    """

    camera: Camera | None
    most: int
    noise: tuple[float, float] | None
    plan: Path | None
    recipe: CorrectionRecipe
    orientation: str


def is_matrix(path: Path) -> bool:
    """Return whether a file holds H; an HDF5 file of any other kind is taken for frames."""
    suffix = path.suffix.lower()
    if path.is_dir() or suffix not in (".h5", ".hdf5", ".npy", ".mat", ".lfc"):
        return False
    if suffix not in (".h5", ".hdf5"):
        return True
    from lfcal.h5.file import H5File
    from lfcal.psf.store import FORMAT

    with H5File(path) as file:
        return file.attributes().text("format") == FORMAT


def open_upright(path: Path) -> PSFMatrix:
    """Return the H of a file, which may hold HT."""
    from lfcal.psf import open_psf

    matrix = open_psf(path)
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


def read_patterns(source: Path, how: Reading, *, quiet: bool) -> tuple[Measured, dict[str, Any]]:
    """Return the patterns to fit, and what is known of their source for the provenance of what is made of them."""
    from lfcal.cli.cameras import tell_assumed
    from lfcal.fit import measured_of

    with ExitStack() as stack:
        if is_matrix(source):
            matrix = stack.enter_context(open_upright(source))
            known: dict[str, Any] = {"source": source.name}
        else:
            matrix, known = _picked(source, how, stack, quiet=quiet)
        camera = how.camera or matrix.camera
        if camera is None:
            raise InputError.expected(str(source), "an H with its camera", "none", "name it with --camera")
        _check_noise(matrix, source, how)
        tell_assumed(matrix.camera if how.camera is None else None, source.name, quiet=quiet)
        return measured_of(matrix, camera, noise=how.noise, most=how.most or None), known


def _check_noise(matrix: PSFMatrix, source: Path, how: Reading) -> None:
    import numpy as np

    if how.noise is not None:
        return
    noise = None if matrix.facts.noise is None else matrix.facts.noise[matrix.recorded > 0]
    if noise is None or not np.isfinite(noise).all():
        raise InputError.expected(
            f"{source}, noise", "a variance of the samples", "none", "state it with --noise CONSTANT,SLOPE"
        )
    # of samples above a black level the variance begins there, and at 0 it would be below nothing
    if (noise[:, 0] < 0).any():
        raise InputError.expected(
            f"{source}, samples", "without their black level", "with it", "name --dark, or --black-level"
        )


def _picked(source: Path, how: Reading, stack: ExitStack, *, quiet: bool) -> tuple[PSFMatrix, dict[str, Any]]:
    """Return the patterns of chosen positions of a folder of frames or a session, corrected and cut out."""
    import numpy as np

    from lfcal.cli.assemble import open_scan
    from lfcal.cli.console import run_work
    from lfcal.cli.listed import report_notes
    from lfcal.cli.orientation import upright
    from lfcal.fit.spread import spread_out
    from lfcal.frames import corrected_view
    from lfcal.frames.colour_scan import colours_of
    from lfcal.psf.picked import iter_pick

    one = "assemble one with lfcal assemble --channel G, and fit that H"
    try:
        frames, plan = open_scan(source, how.plan, orientation=how.orientation)
    except FileFormatError as error:
        # the library's word for it is not an option here
        raise FileFormatError(str(error).replace(' (colour="G")', f": {one}")) from None
    stack.enter_context(frames)
    colours = colours_of(frames, plan)
    if colours:
        raise InputError.expected(str(source), "frames of one colour", f"a mosaic of {', '.join(colours)}", one)
    report_notes(frames.metadata.get("notes", ()))
    view, lie = upright(corrected_view(frames, how.recipe, plan), plan, how.orientation, quiet=quiet)
    if how.camera is not None:
        plan = replace(plan, camera=how.camera)
    index = np.unique(
        np.array([tuple(view.info(k).position) for k in range(len(view))], np.intp).reshape(-1, 3), axis=0
    )
    if how.most and len(index) > how.most:
        index = index[spread_out(index, how.most, plan.period)]
    matrix = run_work(iter_pick(view, plan, index), quiet=quiet)
    known = {"source": source.name, "corrections": view.metadata.get("corrections", {}), **lie}
    return matrix, known
