"""``lfcal camera sensor``: measure gain, noise and fixed pattern of a sensor from flats and darks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from lfcal.base import InputError, write_text
from lfcal.cli._console import print_json, print_table, print_written, report, run_work
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption
from lfcal.tasks import check_outputs, load_camera

if TYPE_CHECKING:
    from lfcal.camera import Camera
    from lfcal.frames.photon_transfer import SensorMeasurement


PICTURES = (".png", ".pdf", ".svg")


def command(
    flats: Path = typer.Argument(
        ..., help="Flat frames: a file with several pages, a folder, or a folder with a subfolder for each light level."
    ),
    darks: Path = typer.Argument(
        ..., help="Dark frames with the settings of the flats; the dark current requires several exposure times."
    ),
    *,
    camera: str = typer.Option("", "--camera", help="Camera (preset or file) whose sensor is measured."),
    cfa: str = typer.Option(
        "", "--cfa", help="Colour filters in row-major order, such as RGGB; default: from the files or the camera."
    ),
    figure: Path | None = typer.Option(
        None, "--figure", help="File for a plot of the photon-transfer curve (PNG, PDF, SVG)."
    ),
    out: Path | None = typer.Option(
        None, "-o", "--out", help="Write the camera with the measured sensor as JSON; needs --camera."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Measure gain, read noise, full well, linearity and fixed pattern of a sensor by photon transfer.

    Record two or more flats at each light level. A white image through the lenslets also works: pixels of similar
    brightness are compared. Values that cannot be measured stay unknown, and the reason is printed.

    Example: `lfcal camera sensor flats/ darks/ --camera camera.json -o measured.json --figure ptc.png`
    """
    from lfcal.frames.photon_transfer import find_frames, iter_measure_sensor, save_curve

    if out is not None and not camera:
        raise InputError.expected("measured camera", "a camera to write the sensor into", "none", "add --camera")
    if figure is not None and figure.suffix.lower() not in PICTURES:
        raise InputError.expected("figure", f"a name that ends in {', '.join(PICTURES)}", figure.name, "rename it")
    check_outputs([path for path in (out, figure) if path is not None], flats, darks, camera, force=force)
    known = load_camera(camera, only=("sensor.cfa",)) if camera else None
    (lit, facts), (dark, _) = find_frames(flats), find_frames(darks)
    pattern = cfa or str(facts.get("cfa") or (known.sensor.cfa if known is not None else ""))
    found = run_work(iter_measure_sensor(lit, dark, cfa=pattern), quiet=json)
    if figure is not None:
        save_curve(found, figure)
    written = [] if figure is None else [figure]
    refusal = None
    if out is not None and known is not None:
        try:
            write_text(out, found.camera(known).to_json())
            written.append(out)
        except InputError as error:  # doubtful values are shown before they are refused
            refusal = error
    if json:
        print_json(found.to_dict() | {"written": written})
    else:
        _show(found, known, written)
    if refusal is not None:
        raise refusal


def _show(found: SensorMeasurement, known: Camera | None, written: list[Path]) -> None:
    from lfcal.frames.photon_transfer import figures_of, sensor_differences

    rows = [list(figure) for figure in figures_of(found, None if known is None else known.sensor)]
    print_table([f"{found.frames[0]} flats, {found.frames[1]} darks", ""], rows)
    for doubt in found.doubts:
        report(f"warning: {doubt}")
    for note in found.notes:
        report(f"note: {note}")
    for word in () if known is None else sensor_differences(found, known.sensor):
        report(f"warning: {word}")
    print_written(*written)
