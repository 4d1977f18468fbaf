"""``lfcal camera check``: compare a camera with a white image, and write the measured camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.base import InputError, write_text
from lfcal.cli._console import print_json, print_table, print_written, report, show_judgement
from lfcal.cli._options import CameraArgument, ForceOption, JsonOption, MaskOption, OriginOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.multiplex import read_white
from lfcal.tasks import check_output, load_camera

if TYPE_CHECKING:
    from lfcal.frames import TurnedWhite
    from lfcal.lattice import CameraCheck


def command(
    context: typer.Context,
    camera: CameraArgument,
    white: Path = typer.Argument(
        ..., help="White image: TIFF, PNG, NPY or camera RAW; or a folder of them to average."
    ),
    *,
    dark: Path | None = typer.Option(None, help="Dark frame to subtract, or a folder of them to average."),
    channel: str = typer.Option(
        "", help="Channel of a colour image: R, G or B; default for a mosaic: the mean of its colours."
    ),
    orientation: str = typer.Option(
        "as-is",
        "--orientation",
        help="How to turn the white image upright: as-is, rot90, rot180, rot270 (anticlockwise), mirror-x (left to "
        "right), mirror-y, transpose, anti-transpose.",
    ),
    origin: OriginOption = "",
    mask: MaskOption = None,
    out: Path | None = typer.Option(None, "-o", "--out", help="Write the camera with the measured lattice as JSON."),
    anyway: bool = typer.Option(
        False, "--anyway", help="With -o: write the camera even if it does not match the white image."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Compare the description of a camera with a white image.

    The table lists each value as described and as measured, and whether the two match. If they differ slightly, -o
    writes the camera with the measured lattice. If they do not match at all, the white image is probably from another
    camera, the description is in other units, or the frames are mirrored. The camera is then written only with
    --anyway. The exit code is 1 if the two differ and nothing is written.

    Example: `lfcal camera check camera.json white.tif --dark dark.tif -o measured.json`
    """
    from lfcal.frames import AS_IS, cfa_from, compared_orientations, named_orientation, parse_origin
    from lfcal.lattice import FITS, WRONG, check_camera

    if out is None:
        refuse(context, "-o to write the camera", "none", "anyway")
    else:
        check_output(out, camera, white, dark, mask, force=force)
    described = load_camera(camera, light=False, without_lattice=())
    if not described.has_lattice:
        remedy = f"measure its lenslets with lfcal white {white.name} --camera {Path(camera).name} -o FOLDER"
        raise InputError.expected("camera", "a periodic lenslet array", "a Fourier light-field microscope", remedy)
    place, turn, cfa = parse_origin(origin), named_orientation(orientation), described.sensor.cfa
    if turn.name != AS_IS and (cfa or place is not None):
        # both refer to the sensor as delivered, but the camera is described upright
        what = "a colour filter" if cfa else "--origin"
        raise InputError.expected("--orientation", f"as-is with {what}", orientation, "turn the white image itself")
    pattern = cfa if place is None else cfa_from(cfa, place)
    frame = turn.apply(read_white(white, dark, channel, pattern, mask=mask, origin=place))
    found, turned = compared_orientations(check_camera(described, frame, origin=place, workers=workers), described)
    # a camera of another kind or with another sensor has no measured lattice to write, and is refused
    doubted = found.verdict == WRONG and found.camera is not None and not anyway
    written = None if doubted else _write(found, out)
    _show(found, turned, written, json)
    if found.verdict != FITS and written is None:
        raise typer.Exit(1)


def _write(found: CameraCheck, out: Path | None) -> Path | None:
    if out is None:
        return None
    if found.camera is None:
        line, remedy = found.lines[-1], "correct the camera"
        if line.label == "sensor":
            remedy += "; if the white image shows a part of the sensor, state its position with --origin ROW,COLUMN"
        raise InputError.expected(f"{line.label} of the white image", line.expected, line.measured, remedy)
    write_text(out, found.camera.to_json())
    return out


def _show(found: CameraCheck, turned: TurnedWhite | None, written: Path | None, json: bool) -> None:
    from lfcal.judge import judgement_of

    if json:
        camera = None if found.camera is None else found.camera.to_dict()
        turns = None if turned is None else [turn.option for turn in turned.turns]
        facts = {"answer": found.verdict, "lines": found.lines, "turned": turns} | judgement_of(found).to_dict()
        print_json(facts | {"camera": camera, "written": written})
        return
    rows = [
        [line.label, line.expected, line.measured, "" if line.edge_px is None else f"{line.edge_px:.2f}", line.verdict]
        for line in found.lines
    ]
    print_table(["", "camera", "white image", "off by (px)", ""], rows)
    show_judgement(judgement_of(found))
    if turned is not None:
        report(
            f"note: the frames are {turned.words}, relative to the camera; if the camera is described correctly, "
            "turn the white "
            f"image and the frames with {turned.options}, here, in lfcal plan and in lfcal assemble"
        )
    if found.verdict != "fits" and found.camera is not None and written is None:
        report(
            "note: the camera and the white image differ; -o camera.json writes the measured camera"
            if found.verdict == "differs"
            else "note: nothing written: camera and white image do not match; check camera, units and orientation, "
            "or write the measured camera with -o camera.json --anyway"
        )
    print_written(written)
