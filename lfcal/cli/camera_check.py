"""``lfcal camera check``: a camera held against a white image, and the camera as measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.cli.cameras import load_camera
from lfcal.cli.colour_planes import read_white
from lfcal.cli.console import print_json, print_table, report
from lfcal.cli.options import CameraArgument, ForceOption, JsonOption, WorkersOption
from lfcal.cli.outputs import check_output
from lfcal.errors import InputError
from lfcal.files import replace_whole

if TYPE_CHECKING:
    from lfcal.lattice.camera_check import CameraCheck

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add ``check`` to the commands of ``camera``."""
    app.command("check")(command)


def command(
    camera: CameraArgument,
    white: Path = typer.Argument(..., help="White image: TIFF, PNG, NPY or camera RAW."),
    *,
    dark: Path | None = typer.Option(None, help="Dark frame, subtracted."),
    channel: str = typer.Option(
        "", help="Of a colour image: R, G or B; of a mosaic the mean of its colours by default."
    ),
    out: Path | None = typer.Option(None, "-o", "--out", help="Write the camera with the measured lattice as JSON."),
    anyway: bool = typer.Option(False, "--anyway", help="With -o: write also where camera and white image do not fit."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Hold a camera against a white image: what it says, what is measured, and whether the two fit.

    Where they differ -o writes the camera as measured; where they do not fit at all, another camera or another unit
    is likely, and it is written with --anyway alone. Ends with exit code 1 where they part and nothing is written.

    Example: `lfcal camera check camera.json white.tif --dark dark.tif -o measured.json`
    """
    from lfcal.lattice.camera_check import FITS, WRONG, check_camera

    if out is not None:
        check_output(out, camera, white, dark, force=force)
    described = load_camera(camera)
    frame = read_white(white, dark, channel, described.sensor.cfa)
    found = check_camera(described, frame, workers=workers)
    # a camera whose kind or sensor is another one has no measured lattice to write, which is refused
    doubted = found.verdict == WRONG and found.camera is not None and not anyway
    written = None if doubted else _write(found, out)
    _show(found, written, json)
    if found.verdict != FITS and written is None:
        raise typer.Exit(1)


def _write(found: CameraCheck, out: Path | None) -> Path | None:
    if out is None:
        return None
    if found.camera is None:
        line = found.lines[-1]
        raise InputError.expected(
            f"{line.label} of the white image", line.expected, line.measured, "correct the camera"
        )
    text = found.camera.to_json()
    with replace_whole(out) as part:
        part.write_text(text, encoding="utf-8")
    return out


def _show(found: CameraCheck, written: Path | None, json: bool) -> None:
    if json:
        camera = None if found.camera is None else found.camera.to_dict()
        print_json({"verdict": found.verdict, "lines": found.lines, "camera": camera, "written": written})
        return
    rows = [
        [line.label, line.expected, line.measured, "" if line.edge_px is None else f"{line.edge_px:.2f}", line.verdict]
        for line in found.lines
    ]
    print_table(["", "camera", "white image", "off by (px)", ""], rows)
    if found.verdict != "fits" and found.camera is not None and written is None:
        report(
            "note: the camera and the white image part; -o camera.json writes the camera as measured"
            if found.verdict == "differs"
            else "note: nothing written: camera and white image do not fit, as with another camera or unit; correct "
            "it, or have the camera as measured written with -o camera.json --anyway"
        )
    if written is not None:
        typer.echo(f"written: {written}")
