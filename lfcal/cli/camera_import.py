"""``lfcal camera import``: convert a camera description of a manufacturer or another program to a camera file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from lfcal.camera import ImportOptions
from lfcal.cli._camera_values import with_values
from lfcal.cli._console import report
from lfcal.cli._options import ForceOption, JsonOption
from lfcal.cli._usage import refuse
from lfcal.tasks import check_output, load_file


@with_values
def command(
    context: typer.Context,
    file: Path = typer.Argument(
        ...,
        help="Camera description: Raytrix XML, oLaF YAML, napari-LF or Micro-Manager metadata, Micro-Manager .cfg, or "
        "camera.json.",
    ),
    *,
    name: str = typer.Option("", help="Name of the camera; default: the name in the file."),
    frame: Path | None = typer.Option(None, help="Frame of the camera, from which the size of the sensor is read."),
    values: dict[str, Any],
    resolution: str = typer.Option("", help="Resolution preset, if a Micro-Manager configuration has several."),
    out: Path | None = typer.Option(None, "-o", "--out", help="Write the camera as JSON."),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Convert a camera description of a manufacturer or another program; options state values that it lacks.

    Example: `lfcal camera import calib.xml --sensor 4384x6576,5.5 --lens 200,4,1000 -o camera.json`
    """
    from lfcal.cli.camera import save_camera

    if file.suffix.lower() != ".cfg":
        refuse(context, "a Micro-Manager configuration (.cfg)", file.name, "resolution")
    if out is not None:
        check_output(out, file, frame, force=force)
    if frame is not None:
        values["sensor.shape"] = frame_shape(frame)
    camera, notes = load_file(str(file), ImportOptions(values, resolution))
    camera = replace(camera, name=name) if name else camera
    for note in notes:
        report(f"note: {file.name}: {note}")
    save_camera(camera, out, file, frame, force=force, json=json)


def frame_shape(path: Path) -> tuple[int, int]:
    """Return the shape (rows, columns) of the image in a file (px)."""
    from lfcal.frames import open_image

    image = open_image(path)
    try:
        return image.shape
    finally:
        image.close()
