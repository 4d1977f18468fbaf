"""``lfcal multiplex recover``: any modulator's samples from a frame, without saturated and dead pixels."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from lfcal.base import InputError, check_choice
from lfcal.cli._console import print_json, run_work
from lfcal.cli._multiplex_frames import ROUTES, Weighing, check_told, fourier_file, level_of, read_frame, write_tiff
from lfcal.cli._options import ForceOption, GainOption, JsonOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.multiplex import GRAMMAR, modulator_of
from lfcal.tasks import check_output

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.multiplex import Modulator

__all__ = ["recover"]


def recover(
    context: typer.Context,
    frame: Path = typer.Argument(help="Frame recorded behind the modulator."),
    *,
    modulator: str | None = typer.Option(None, help=f"Such as {GRAMMAR}."),
    transmissions: Path | None = typer.Option(
        None, help="Instead: .npy (N, rows, columns), what every pixel takes of each sample; solved by iterations."
    ),
    out: Path = typer.Option(..., "--out", "-o", help="float32 TIFF, one page per sample."),
    route: str = typer.Option(
        "spatial", help="Of super-pixels: spatial, fourier, or both; then Fourier's go to OUT_fourier.tif."
    ),
    filter: str | None = typer.Option(
        None, help="Of super-pixels without weights, such as cubic (`multiplex filters`); by default linear."
    ),
    camera: str | None = typer.Option(None, help="Preset or camera file: weights by its noise and saturation."),
    gain: GainOption = 1.0,
    exposure: float = typer.Option(0.0, min=0, help="Seconds in which dark current gathers."),
    dead: Path | None = typer.Option(None, help="Image of dead pixels, not zero where dead."),
    deviation: Path | None = typer.Option(
        None, help="Also write each sample's standard deviation; without --camera in units of a pixel's noise."
    ),
    dark: float | None = typer.Option(
        None, help="Level of no light; by default what the file states, else --camera's, else 0."
    ),
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
    import numpy as np

    from lfcal.base import map_npy
    from lfcal.multiplex import without_black_level
    from lfcal.tasks import load_camera

    check_output(out, frame, transmissions, camera, dead, force=force)
    check_choice("route", route, ROUTES)
    if route == "both":
        check_output(fourier_file(out), frame, transmissions, camera, dead, out, force=force)
    if deviation is not None:
        check_output(deviation, frame, transmissions, camera, dead, out, force=force)
    if (modulator is None) == (transmissions is None):
        got = "neither" if modulator is None else "both"
        raise InputError.expected("modulator", "--modulator or --transmissions", got, "give one of them")
    if camera is None:
        refuse(context, "a --camera", "none", "gain", "exposure")
    if spacing is None and transmissions is None:
        refuse(context, "--spacing or --transmissions", "neither", "iterations", "smoothness")
    sensor = None if camera is None else load_camera(camera).sensor
    recorded = read_frame(frame, page)
    level = level_of(recorded, dark, sensor)
    weights = Weighing(sensor, dead, gain, exposure).weights(recorded.raw, level)
    light = without_black_level(recorded.raw.astype(float), level)
    if spacing is not None or transmissions is not None:
        for name, value in (
            ("deviation", deviation),
            ("filter", filter),
            ("route", None if route == "spatial" else route),
        ):
            if value is not None:
                remedy = f"leave --{name} out, or --spacing and --transmissions"
                raise InputError.expected(name, "none by iterations", value, remedy)
        known = np.ones(recorded.raw.shape) if weights is None else weights
        shares: Any = modulator_of(modulator) if modulator else map_npy(str(transmissions))
        told = _by_iterations(light, shares, known, spacing, smoothness, iterations, out=out, quiet=json)
    else:
        way = _Way(route, filter, out, deviation)
        told = _by_super_pixels(light, modulator_of(str(modulator)), weights, way)
    if json:
        print_json(told | {"black_level": level})
        return
    typer.echo(", ".join(f"{key.replace('_', ' ')} {value}" for key, value in told.items()))


class _Way(NamedTuple):
    """Route, filter, and where samples and their deviation are written."""

    route: str
    filter: str | None
    out: Path
    deviation: Path | None


def _by_super_pixels(
    light: NDArray[Any], modulator: Modulator, weights: NDArray[Any] | None, way: _Way
) -> dict[str, Any]:
    import numpy as np

    from lfcal.multiplex import demultiplex, demultiplex_weighted

    check_told(modulator)
    told: dict[str, Any] = {"samples": list(modulator.sample_names)[:16]}
    if way.route != "fourier" and (weights is not None or way.filter is None):
        if way.filter not in (None, "linear"):
            raise InputError.expected("filter with weights", "linear", way.filter, "leave --filter out")
        known = np.ones(light.shape) if weights is None else weights
        found = demultiplex_weighted(light, modulator, known)
        lost = float(np.isinf(found.deviation).any(0).mean())
        if lost == 1:
            wanted = "pixels that tell all samples somewhere"
            raise InputError.expected(
                f"frame behind {modulator.name}",
                wanted,
                "none",
                "expose for less saturation, or see --dead and --camera",
            )
        write_tiff(way.out, found.samples)
        if way.deviation is not None:
            write_tiff(way.deviation, found.deviation)
        told["pixels_left_out"] = float((known == 0).mean())
        told["places_not_recovered"] = lost
    elif way.deviation is not None:
        raise InputError.expected("deviation", "the filter linear", way.filter or way.route, "leave --filter out")
    elif way.route != "fourier":
        write_tiff(way.out, demultiplex(light, modulator, filter=way.filter))
    elif weights is not None:
        raise InputError.expected("route with weights", "spatial or both", "fourier", "it takes every pixel alike")
    if way.route != "spatial":
        whole = np.where(np.isfinite(light), light, 0.0) if weights is not None else light
        target = way.out if way.route == "fourier" else fourier_file(way.out)
        write_tiff(target, demultiplex(whole, modulator, route="fourier"))
    return told


def _by_iterations(
    light: NDArray[Any],
    shares: Any,
    weights: NDArray[Any],
    spacing: float | None,
    smoothness: float,
    most: int,
    *,
    out: Path,
    quiet: bool,
) -> dict[str, Any]:
    import math

    from lfcal.multiplex import Modulator, iter_demultiplex_generally

    # as many nodes as pixels measure, where nothing else is asked for
    samples = shares.count if isinstance(shares, Modulator) else len(shares)
    step = math.sqrt(samples) if spacing is None else spacing
    work = iter_demultiplex_generally(light, shares, step, weights=weights, smoothness=smoothness, most=most)
    found = run_work(work, quiet=quiet)
    write_tiff(out, found.samples)
    return {"iterations": found.iterations, "residual": found.residual, "operations": found.operations}
