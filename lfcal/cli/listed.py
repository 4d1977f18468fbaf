"""What the commands share of lists of frames that other programs wrote."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from lfcal.cli.console import report

if TYPE_CHECKING:
    from lfcal.camera import Camera, ScanPlan, StageAxes

__all__ = ["ColumnsOption", "plan_from_list", "report_notes", "tell_size"]

ColumnsOption: TypeAlias = Annotated[
    str,
    typer.Option("--columns", help="What columns of a list hold: file=Name,y_um=PosY,x_um=PosX,exposure_ms=Exp."),
]
"""Which column is what, where their names do not tell."""


def report_notes(notes: Iterable[str]) -> None:
    """Print what was guessed, a line each."""
    for note in notes:
        report(f"note: {note}")


def tell_size(shape: tuple[int, int], camera: Camera, *, folder: str = "the frames", channel: str = "") -> None:
    """Warn where frames are no whole pictures of the camera's sensor, upright, turned or one colour of a mosaic."""
    sizes = {shape, shape[::-1]}
    if channel:
        sizes |= {(-(-rows // 2), -(-columns // 2)) for rows, columns in sizes}
    if camera.sensor.shape in sizes:
        return
    (rows, columns), (tall, wide) = shape, camera.sensor.shape
    what = f"{folder}: frames of {rows} x {columns} px, the camera's sensor has {tall} x {wide}"
    times = next((n for n in range(2, 9) if any(_binned(camera.sensor.shape, n, one) for one in sizes)), 0)
    if times:
        sensor = f"{tall // times}x{wide // times},{camera.sensor.pixel_um * times:g}"
        report(
            f"warning: {what}, as if {times} x {times} pixels were one; if so make the camera of these: "
            f"lfcal camera import CAMERA --sensor {sensor} --pitch {camera.lattice.pitch_um:g}um -o BINNED; "
            "its array is measured by lfcal camera check BINNED WHITE"
        )
        return
    report(
        f"warning: {what}, from whose middle micro-images are counted; state its size with lfcal camera import CAMERA "
        "--frame FRAME"
    )


def _binned(sensor: tuple[int, int], times: int, shape: tuple[int, int]) -> bool:
    """Return whether frames of ``shape`` are those of the sensor, ``times`` pixels joined along each side."""
    return all(side // times <= length <= -(-side // times) for side, length in zip(sensor, shape, strict=True))


def plan_from_list(
    listed: Path,
    camera: Camera,
    *,
    folder: Path | None,
    columns: str,
    orientation: str,
    stage: StageAxes | None,
    **settings: Any,
) -> ScanPlan:
    """Return the plan of the scan that a list was written of; frames that are found show where the light goes."""
    from lfcal.errors import StorageError
    from lfcal.frames import named_orientation
    from lfcal.frames.lists.derived import plan_of_list
    from lfcal.frames.lists.entries import located
    from lfcal.frames.lists.open_table import any_listing, reader, sample_of

    turn = named_orientation(orientation)
    listing = any_listing(listed, columns)
    root = folder or listed.parent
    try:
        listing = located(listing, root)
        shape, colour = sample_of(listing, root)
        read = reader(listing, root, colour, turn)
    except StorageError as error:
        if folder is not None:
            raise
        report(f"note: the frames are not there to be looked at ({error}); --frames names their folder")
        read = None
    else:
        tell_size(shape, camera, folder=str(root))
        if colour is not None:
            report(f"note: light: of the {colour} of colour pictures; lfcal assemble takes one with --channel")
    plan, notes = plan_of_list(listing, camera, read=read, stage=stage, **settings)
    report_notes(notes)
    return plan
