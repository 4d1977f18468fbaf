"""``lfcal multiplex views``: the views of a light field on a lattice of any pitch, behind lenslets or a mask."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from lfcal.base import InputError, check_choice
from lfcal.cli._console import print_json
from lfcal.cli._multiplex_frames import (
    ROUTES,
    Weighing,
    fourier_file,
    level_of,
    read_frame,
    without_dark_frame,
    write_tiff,
)
from lfcal.cli._options import ForceOption, GainOption, JsonOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.multiplex import modulator_of
from lfcal.tasks import check_output

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.lattice import FrameLattice, ViewGrid
    from lfcal.multiplex import Modulator

__all__ = ["views"]


class _Way(NamedTuple):
    """How views are found: filter, axes, views along a side of lenslets, or the mask in their place."""

    filter: str
    axes: str
    size: int
    mask: Modulator | None


def views(
    context: typer.Context,
    frame: Path = typer.Argument(help="Light-field frame."),
    *,
    white: Path | None = typer.Option(
        None, help="White image of the same camera (or a folder): the lattice is measured on it."
    ),
    lattice: Path | None = typer.Option(None, help="lattice.json of `lfcal white`, instead of --white."),
    camera: str | None = typer.Option(None, help="Preset or camera file, instead of --white: the lattice it states."),
    out: Path = typer.Option(..., "--out", "-o", help="float32 TIFF, one page per view by rows."),
    size: int = typer.Option(0, min=0, help="Views along a side; as many as fit the pitch by default."),
    dark: Path | None = typer.Option(None, help="Dark frame, subtracted; else the level of no light the file states."),
    route: str = typer.Option("spatial", help="spatial; with --modulator also fourier, or both (OUT_fourier.tif)."),
    filter: str | None = typer.Option(
        None, help="nearest, linear or cubic; with --modulator also sinc. By default cubic, with weights linear."
    ),
    modulator: str | None = typer.Option(None, help="Mask in place of lenslets, such as MURA:11."),
    axes: str = typer.Option("lattice", help="Rows run along the lattice's or the frame's."),
    sensor: str | None = typer.Option(
        None, help="Preset or camera file whose sensor weighs the pixels: saturated ones have no say, others by noise."
    ),
    gain: GainOption = 1.0,
    exposure: float = typer.Option(0.0, min=0, help="With --sensor: seconds in which dark current gathers."),
    dead: Path | None = typer.Option(None, help="Image of dead pixels, not zero where dead: they have no say."),
    deviation: Path | None = typer.Option(
        None, help="Also write each sample's standard deviation; without --sensor in units of a pixel's noise."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Demultiplex the views of a light field on a measured lattice of any pitch.

    Example: `lfcal multiplex views field.tif --white white.tif -o views.tif`
    """
    from lfcal.tasks import load_camera

    check_choice("route", route, ROUTES)
    read = (frame, white, lattice, camera, dark, sensor, dead)
    check_output(out, *read, force=force)
    if route == "both":
        check_output(fourier_file(out), *read, out, force=force)
    if deviation is not None:
        check_output(deviation, *read, out, force=force)
    if modulator is not None and size:  # a mask has as many views as its super-pixel
        raise InputError.expected("views", "one of --size and --modulator", "both", "leave one out")
    if modulator is None and route != "spatial":
        raise InputError.expected("route", "spatial for lenslets", repr(route), "give the mask as --modulator")
    fit = _lattice_of(white, lattice, camera, dark)
    if sensor is None:
        refuse(context, "a --sensor", "none", "gain", "exposure")
    described = None if sensor is None else load_camera(sensor).sensor
    recorded = read_frame(frame)
    if recorded.raw.shape != fit.shape:
        wanted = f"the {fit.shape} px of the lattice"
        raise InputError.expected(str(frame), wanted, recorded.raw.shape, "use its own camera's")
    level = level_of(recorded, None, described)
    weights = Weighing(described, dead, gain, exposure).weights(recorded.raw, level)
    if weights is None and deviation is not None:
        raise InputError.expected(
            "deviation", "pixels with weights", "none", "give --sensor or --dead, or leave it out"
        )
    mask = None if modulator is None else modulator_of(modulator)
    way = _Way(filter or ("cubic" if weights is None else "linear"), axes, size or _fitting(fit), mask)
    light = _light(recorded.raw, dark, level)
    found, spread, grid = (
        _plain(light, fit, way, route) if weights is None else _weighted(light, weights, fit, way, route)
    )
    for path, planes in ((out, found), (deviation, spread)):
        if path is not None and planes is not None:
            write_tiff(path, planes)
    if route == "both":
        assert mask is not None  # there is one route for lenslets
        write_tiff(fourier_file(out), _fourier(light, fit, mask, axes))
    if json:
        told = {"file": str(out), "views": len(found), "rows_columns": grid.shape, "corner_px": grid.corner_px}
        told |= {"step_px": grid.step_px, "rotation_rad": grid.rotation_rad, "kept": grid.kept}
        left = 0.0 if weights is None else float((weights == 0).mean())
        print_json(told | {"black_level": None if dark else level, "pixels_left_out": left})
        return
    typer.echo(f"{len(found)} views of {grid.described()}")


def _light(raw: NDArray[Any], dark: Path | None, level: Any) -> NDArray[Any]:
    from lfcal.multiplex import without_black_level

    return without_black_level(raw, level) if dark is None else without_dark_frame(raw, dark)


def _fitting(fit: FrameLattice) -> int:
    # an odd number of views has one in the middle, through the centre of the pupil.
    return max(1, (int(min(fit.pitch_px, fit.row_pitch_px)) - 1) // 2 * 2 + 1)


def _plain(
    light: NDArray[Any], fit: FrameLattice, way: _Way, route: str
) -> tuple[NDArray[Any], NDArray[Any] | None, ViewGrid]:
    """Return the views where all pixels count alike, and no deviation."""
    from lfcal.multiplex import channel_grid, demultiplex_lattice, lattice_channels

    if way.mask is None:
        found = lattice_channels(light, fit, way.size, filter=way.filter, axes=way.axes)
        return _by_rows(found), None, channel_grid(light.shape, fit, way.size, axes=way.axes)
    grid = channel_grid(light.shape, fit, way.mask.side, spacing_px=None, axes=way.axes)
    if route == "fourier":
        return _fourier(light, fit, way.mask, way.axes), None, grid
    return demultiplex_lattice(light, fit, way.mask, filter=way.filter, axes=way.axes), None, grid


def _weighted(
    light: NDArray[Any], weights: NDArray[Any], fit: FrameLattice, way: _Way, route: str
) -> tuple[NDArray[Any], NDArray[Any] | None, ViewGrid]:
    """Return the views from the pixels with weight, and their deviation."""
    from lfcal.multiplex import channel_grid, demultiplex_lattice_weighted, lattice_channels_weighted

    if route == "fourier" or way.filter != "linear":
        got = f"{route}, {way.filter}"
        raise InputError.expected("route with weights", "spatial, linear", got, "leave --route and --filter out")
    if way.mask is not None:
        seen = demultiplex_lattice_weighted(light, fit, way.mask, weights, axes=way.axes)
        grid = channel_grid(light.shape, fit, way.mask.side, spacing_px=None, axes=way.axes)
        return seen.samples, seen.deviation, grid
    seen = lattice_channels_weighted(light, fit, way.size, weights, axes=way.axes)
    grid = channel_grid(light.shape, fit, way.size, axes=way.axes)
    return _by_rows(seen.samples), _by_rows(seen.deviation), grid


def _fourier(light: NDArray[Any], fit: FrameLattice, mask: Modulator, axes: str) -> NDArray[Any]:
    """Return the views by the Fourier route, which takes every pixel alike; what is no number is 0."""
    import numpy as np

    from lfcal.multiplex import demultiplex_lattice

    return demultiplex_lattice(np.nan_to_num(light, posinf=0.0, neginf=0.0), fit, mask, route="fourier", axes=axes)


def _by_rows(channels: NDArray[Any]) -> NDArray[Any]:
    return channels.reshape(-1, *channels.shape[2:])


def _lattice_of(white: Path | None, lattice: Path | None, camera: str | None, dark: Path | None) -> FrameLattice:
    """Return the lattice measured before, the one in the white image, or the one that a camera states."""
    from lfcal.frames.corrections import read_average
    from lfcal.lattice import fit_lattice, lattice_of, load_lattice
    from lfcal.tasks import load_camera

    given = [name for name, value in (("--white", white), ("--lattice", lattice), ("--camera", camera)) if value]
    if len(given) != 1:
        got = " and ".join(given) or "none of them"
        raise InputError.expected("lattice", "--white, --lattice or --camera", got, "give one of them")
    if lattice is not None:
        return load_lattice(lattice)
    if camera is not None:
        return lattice_of(load_camera(camera))
    seen = read_average(Path(str(white)))
    return fit_lattice(seen if dark is None else without_dark_frame(seen, dark))
