"""``lfcal multiplex recover``: any modulator's samples from a frame, without saturated and dead pixels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli import multiplex_figures as pictures
from lfcal.cli.console import print_json, run_work
from lfcal.cli.options import ForceOption, GainOption, JsonOption, WorkersOption
from lfcal.cli.outputs import check_output
from lfcal.errors import InputError
from lfcal.multiplex.naming import GRAMMAR, modulator_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.multiplex import Modulator

__all__ = ["recover"]


def recover(
    frame: Path = typer.Argument(help="Frame recorded behind the modulator."),
    *,
    modulator: str | None = typer.Option(None, help=f"Such as {GRAMMAR}."),
    transmissions: Path | None = typer.Option(
        None, help="Instead: .npy (N, rows, columns), what every pixel takes of each sample; solved by iterations."
    ),
    out: Path = typer.Option(..., "--out", "-o", help="float32 TIFF, one page per sample."),
    camera: str | None = typer.Option(None, help="Preset or camera file: weights by its noise and saturation."),
    gain: GainOption = 1.0,
    exposure: float = typer.Option(0.0, min=0, help="Seconds in which dark current gathers."),
    dead: Path | None = typer.Option(None, help="Image of dead pixels, not zero where dead."),
    deviation: Path | None = typer.Option(None, help="Also write each sample's standard deviation as float32 TIFF."),
    dark: float = typer.Option(0.0, help="Level of no light; with --camera the sensor's black level by default."),
    spacing: float | None = typer.Option(None, help="Solve by iterations on a grid of this many pixels per sample."),
    smoothness: float = typer.Option(1e-4, min=0, help="Of the iterations: weight of differences between nodes."),
    iterations: int = typer.Option(400, min=1, help="Iterations at most."),
    page: int = typer.Option(0, min=0, help="Page of a file of many frames."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Recover the samples of any modulator; saturated and dead pixels have no say, the others by their noise.

    Example: `lfcal multiplex recover hdr.tif --modulator nd:1,0.25/0.25,0.0625 --camera r29 -o radiance.tif`
    """
    from lfcal.frames import read_image
    from lfcal.npy import map_npy

    check_output(out, frame, transmissions, camera, dead, force=force)
    if deviation is not None:
        check_output(deviation, frame, transmissions, camera, dead, out, force=force)
    if (modulator is None) == (transmissions is None):
        got = "neither" if modulator is None else "both"
        raise InputError.expected("modulator", "--modulator or --transmissions", got, "give one of them")
    raw = _page(frame, page)
    weights, level = _weights(raw, camera, gain, exposure, None if dead is None else read_image(dead), dark)
    light = raw.astype(float) - level
    if spacing is not None or transmissions is not None:
        if deviation is not None:
            raise InputError.expected("deviation", "none by iterations", deviation, "leave --spacing out, or this")
        shares: Any = modulator_of(modulator) if modulator else map_npy(str(transmissions))
        told = _by_iterations(light, shares, weights, spacing, smoothness, iterations, out, quiet=json)
    else:
        told = _by_channels(light, modulator_of(str(modulator)), weights, out, deviation)
    if json:
        print_json(told)
        return
    typer.echo(", ".join(f"{key.replace('_', ' ')} {value}" for key, value in told.items()))


def _page(path: Path, page: int) -> NDArray[Any]:
    from lfcal.frames import open_image

    image = open_image(path)
    try:
        frame: NDArray[Any] = image.read(page)
        return frame
    finally:
        image.close()


def _weights(
    raw: NDArray[Any], camera: str | None, gain: float, exposure: float, dead: NDArray[Any] | None, dark: float
) -> tuple[NDArray[Any], float]:
    """Return the weights of the pixels and the level of no light."""
    import numpy as np

    from lfcal.cli.cameras import load_camera
    from lfcal.multiplex import pixel_weights

    if camera is None:
        if dead is not None and dead.shape != raw.shape:
            raise InputError.expected("dead pixels", f"{raw.shape} px", dead.shape, "use the frame's own camera's")
        return np.ones(raw.shape) if dead is None else (dead == 0).astype(float), dark
    sensor = load_camera(camera).sensor
    return pixel_weights(raw, sensor, dead=dead, gain=gain, exposure_s=exposure), dark or sensor.black_level


def _by_channels(
    light: NDArray[Any], modulator: Modulator, weights: NDArray[Any], out: Path, deviation: Path | None
) -> dict[str, Any]:
    import numpy as np

    from lfcal.multiplex import demultiplex_weighted

    found = demultiplex_weighted(light, modulator, weights)
    pictures.write_tiff(out, found.samples)
    if deviation is not None:
        pictures.write_tiff(deviation, found.deviation)
    lost = float(np.isinf(found.deviation).any(0).mean())
    left = float((weights == 0).mean())
    return {"samples": list(modulator.sample_names)[:16], "pixels_left_out": left, "places_not_recovered": lost}


def _by_iterations(
    light: NDArray[Any],
    shares: Any,
    weights: NDArray[Any],
    spacing: float | None,
    smoothness: float,
    most: int,
    out: Path,
    *,
    quiet: bool,
) -> dict[str, Any]:
    import math

    from lfcal.multiplex import Modulator
    from lfcal.multiplex.general import iter_demultiplex_generally

    # as many nodes as pixels measure, where nothing else is asked for
    step = spacing or math.sqrt(shares.count if isinstance(shares, Modulator) else len(shares))
    work = iter_demultiplex_generally(light, shares, step, weights=weights, smoothness=smoothness, most=most)
    found = run_work(work, quiet=quiet)
    pictures.write_tiff(out, found.samples)
    return {"iterations": found.iterations, "residual": found.residual, "operations": found.operations}
