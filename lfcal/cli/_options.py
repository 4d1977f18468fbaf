"""Options that several commands share, each described once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from lfcal.base import InputError, bounded_threads
from lfcal.cli._completing import complete_camera, complete_compression, complete_mat_order

__all__ = [
    "CameraArgument",
    "Chi2Option",
    "CompressionOption",
    "CutoutOption",
    "DepthsOption",
    "FolderOption",
    "ForceOption",
    "GainOption",
    "JsonOption",
    "MatOrderOption",
    "MatrixArgument",
    "OriginOption",
    "PresetOption",
    "ResumeOption",
    "VirtualDepthsOption",
    "WorkersOption",
    "parse_groups",
]


def _bound(context: typer.Context, workers: int | None) -> int | None:
    """Bound the threads until the command ends; the value goes on to the command."""
    if workers is not None:
        context.with_resource(bounded_threads(workers))
    return workers


FolderOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--folder", exists=True, file_okay=False, help="Where to write; the temporary files' by default."),
]
"""Disk that a benchmark writes to and cleans up."""

JsonOption: TypeAlias = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
"""Plain values for other programs in place of text."""

WorkersOption: TypeAlias = Annotated[
    int | None,
    typer.Option("--workers", min=1, callback=_bound, help="Threads; LFCAL_WORKERS or every processor by default."),
]
"""Threads of everything a command computes: its own, and those of the libraries it calls."""

ResumeOption: TypeAlias = Annotated[
    bool, typer.Option("--resume", help="Go on with what an earlier run left, after a kill or a power cut.")
]
"""What is done is not done again."""

ForceOption: TypeAlias = Annotated[bool, typer.Option("--force", help="Replace what exists.")]
"""Without it a command that would replace a file ends before its work begins; see `lfcal.cli.outputs`."""

CompressionOption: TypeAlias = Annotated[
    str, typer.Option("--compression", autocompletion=complete_compression, help="gzip, zstd or none.")
]
"""How the chunks of an H file are compressed."""

MatrixArgument: TypeAlias = Annotated[
    Path, typer.Argument(help="H file (.h5), another code's file (.mat v7.3, .lfc of napari-LF), or .npy array.")
]
"""H in any form that `lfcal.psf.open_psf` reads."""

MatOrderOption: TypeAlias = Annotated[
    str,
    typer.Option(
        "--mat-order",
        autocompletion=complete_mat_order,
        help="Axes of H in a .mat file that does not state them: rows-first, H(t,s,y,x,z), or columns-first, "
        "H(s,t,x,y,z). By default inferred from its variables.",
    ),
]
"""See `lfcal.psf.mat_import`."""

CameraArgument: TypeAlias = Annotated[
    str,
    typer.Argument(
        autocompletion=complete_camera,
        help="Preset, or camera file: camera.json, Raytrix XML, oLaF yaml, napari-LF metadata …",
    ),
]
"""A described camera."""

OriginOption: TypeAlias = Annotated[
    str,
    typer.Option(
        "--origin",
        metavar="ROW,COLUMN",
        help="Sensor row and column of the first pixel, of frames that are a part of it.",
    ),
]
"""Where on the sensor frames lie that are a camera's region of interest."""

DepthsOption: TypeAlias = Annotated[
    str,
    typer.Option("--depths", help="Planes in µm (or mm), away from the camera: a,b,c or start:stop:step."),
]
"""Planes by where they lie."""

VirtualDepthsOption: TypeAlias = Annotated[
    str, typer.Option("--virtual-depths", help="Planes as virtual depths v = a/B.")
]
"""Planes by where their images lie behind the main lens."""

CutoutOption: TypeAlias = Annotated[
    str, typer.Option("--cutout", help="Pixels kept, odd: 181 or ROWS,COLUMNS; by default by geometry.")
]
"""Pixels of a point source's image."""

Chi2Option: TypeAlias = Annotated[
    float | None, typer.Option("--chi2", min=0, help="Photon over additive noise variance of the camera.")
]
"""The noise that decides which modulator is best."""

PresetOption: TypeAlias = Annotated[
    str | None,
    typer.Option("--camera", help="Preset or camera file in place of --chi2, which is taken from full well and noise."),
]
"""A camera that chi^2 is computed for."""

GainOption: TypeAlias = Annotated[float, typer.Option("--gain", help="Amplifier gain of the camera.")]
"""Gain at which the full well and the read noise of ``--camera`` are compared."""


def parse_groups(text: str, *, automatic: bool = True) -> tuple[str, ...]:
    """Return the groups of unknowns named in ``--unknowns A,B,C``, each one known.

    ``automatic`` says whether the command has ``auto`` as well, which is not read here.
    """
    from lfcal.fit import GROUPS

    names = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    known = GROUPS.names()
    wrong = [name for name in names if name not in known]
    if wrong or not names:
        got = wrong[0] if wrong else repr(text)
        wanted = ("auto or " if automatic else "") + "groups of unknowns"
        raise InputError.expected("--unknowns", wanted, got, f"groups are {', '.join(known)}")
    return names
