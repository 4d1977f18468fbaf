"""``lfcal multiplex demosaic``, ``recover`` and ``views``: recover samples from frames recorded behind modulators."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from lfcal.base import InputError, check_choice, format_pixels, map_npy, write_tiff
from lfcal.cli._console import print_json, print_written, run_work
from lfcal.cli._options import (
    ExposureOption,
    ForceOption,
    GainOption,
    JsonOption,
    MaskOption,
    PageOption,
    WorkersOption,
)
from lfcal.cli._usage import refuse
from lfcal.multiplex import GRAMMAR, dark_level, modulator_of
from lfcal.tasks import check_outputs

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.lattice import FrameLattice
    from lfcal.multiplex import Modulator

__all__ = ["demosaic", "recover", "views"]

ROUTES = ("spatial", "fourier", "both")

WithoutOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--mask",
        help="Pixels to leave out: an image that is not 0 at these pixels, or a list with one ROW,COLUMN per line. "
        "NaN is always left out.",
    ),
]
DeviationOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--deviation",
        help="File for the standard deviation of each sample, in counts; in units of the noise of one pixel if no "
        "camera or sensor gives the weights.",
    ),
]


def demosaic(
    context: typer.Context,
    frame: Path = typer.Argument(help="Frame of a colour mosaic: RAW, TIFF, PNG, NPY …"),
    *,
    out: Path = typer.Option(..., "--out", "-o", help="File for red, green and blue (float32 TIFF)."),
    pattern: str | None = typer.Option(None, help="Colour filter pattern, such as GRBG; default: from the RAW file."),
    route: str = typer.Option(
        "spatial", help="Method: spatial (interpolates each channel) or fourier (crops tiles of the spectrum)."
    ),
    filter: str | None = typer.Option(
        None,
        help="Filter of the spatial route: directional, lmmse, nearest, linear, cubic, lanczos, sinc or bilateral; "
        "default directional.",
    ),
    dark: float | None = typer.Option(None, help="Black level (counts); default: from the RAW file, else 0."),
    mask: MaskOption = None,
    page: PageOption = 0,
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Demosaic a frame by the spatial or the Fourier route.

    Example: `lfcal multiplex demosaic shot.dng -o shot.tif`
    """
    from lfcal.multiplex import cfa, demultiplex, interpolated, read_recorded, without_black_level

    if route == "fourier":
        refuse(context, "--route spatial", route, "filter")
    check_outputs((out,), frame, mask, force=force)
    recorded = read_recorded(frame, page)
    mosaic = pattern or recorded.filters
    if not mosaic:
        raise InputError.expected(f"colour filters of {frame}", "a pattern", "none", "give --pattern, such as GRBG")
    level, array = recorded.level(dark), cfa(mosaic)
    _check_recovered(array)
    light = interpolated(without_black_level(recorded.raw, level), frame, mask, cfa=mosaic)
    planes = demultiplex(light, array, route=route, filter=filter)
    _write(out, planes)
    if not json:
        print_written(out)
        return
    facts = {"file": str(out), "pattern": mosaic, "route": route, "black_level": level}
    print_json({**facts, "samples": array.sample_names, "shape": planes.shape})


def recover(
    context: typer.Context,
    frame: Path = typer.Argument(help="Frame recorded behind the modulator."),
    *,
    modulator: str | None = typer.Option(None, help=f"Modulator, such as {GRAMMAR}."),
    transmissions: Path | None = typer.Option(
        None,
        help="Instead of --modulator: array (.npy; N, rows, columns) of the fraction of each sample that each pixel "
        "receives. The samples are then found iteratively.",
    ),
    out: Path = typer.Option(..., "--out", "-o", help="File to write: float32 TIFF, one page per sample."),
    route: str = typer.Option(
        "spatial",
        help="Route for super-pixels: spatial, fourier, or both (the Fourier result goes to OUT_fourier.tif).",
    ),
    filter: str | None = typer.Option(
        None,
        help="Interpolation filter, such as cubic (see `multiplex filters`); default: linear, the only filter for"
        " pixels with weights.",
    ),
    camera: str | None = typer.Option(
        None, help="Preset or camera file whose noise and saturation give the weights of pixels."
    ),
    gain: GainOption = 1.0,
    exposure: ExposureOption = 0.0,
    mask: WithoutOption = None,
    deviation: DeviationOption = None,
    dark: float | None = typer.Option(
        None, help="Black level (counts); default: from the file, else from --camera, else 0."
    ),
    spacing: float | None = typer.Option(
        None,
        help="Solve iteratively on a grid of nodes at this distance (px); default with --transmissions: the square "
        "root of the number of samples.",
    ),
    smoothness: float = typer.Option(
        1e-4,
        min=0,
        help="Weight of differences between adjacent grid nodes in the iterative solution, relative to the weight of "
        "the pixels.",
    ),
    iterations: int = typer.Option(400, min=1, help="Largest number of iterations."),
    page: PageOption = 0,
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Recover the samples behind any modulator; --camera and --mask leave out saturated and dead pixels.

    Example: `lfcal multiplex recover hdr.tif --modulator nd:1,0.25/0.25,0.0625 --camera r29 -o radiance.tif`
    """
    import numpy as np

    from lfcal.multiplex import iter_demultiplex_generally, read_recorded, without_black_level
    from lfcal.tasks import OF_WEIGHTS, load_camera

    check_choice("route", route, ROUTES)
    outputs = (out, _fourier_file(out) if route == "both" else None, deviation)
    check_outputs(outputs, frame, transmissions, camera, mask, force=force)
    if (modulator is None) == (transmissions is None):
        got = "neither" if modulator is None else "both"
        raise InputError.expected("modulator", "--modulator or --transmissions", got, "give one of them")
    if camera is None:
        refuse(context, "a --camera", "none", "gain", "exposure")
    by_iterations = spacing is not None or transmissions is not None
    if not by_iterations:
        refuse(context, "--spacing or --transmissions", "neither", "iterations", "smoothness")
    sensor = None if camera is None else load_camera(camera, only=OF_WEIGHTS).sensor
    recorded = read_recorded(frame, page)
    level = recorded.level(dark, sensor)
    weights = recorded.weights(level, sensor, mask, gain=gain, exposure_s=exposure)
    light = without_black_level(recorded.filled.astype(float), level)
    shares: Any = modulator_of(modulator) if modulator else map_npy(str(transmissions))
    if by_iterations:
        others = {"deviation": deviation, "filter": filter, "route": None if route == "spatial" else route}
        for name, value in others.items():
            if value is not None:
                remedy = f"leave --{name} out, or --spacing and --transmissions"
                raise InputError.expected(name, "none for an iterative solution", value, remedy)
        known = np.ones(light.shape) if weights is None else weights
        # by default, as many nodes as pixels
        step = math.sqrt(shares.count if modulator else len(shares)) if spacing is None else spacing
        how: dict[str, Any] = {"weights": known, "smoothness": smoothness, "most": iterations}
        found = run_work(iter_demultiplex_generally(light, shares, step, **how), quiet=json)
        _write(out, found.samples)
        facts: dict[str, Any] = {name: getattr(found, name) for name in ("iterations", "residual", "operations")}
    else:
        facts = _by_super_pixels(light, shares, weights, route, filter, out=out, deviation=deviation)
    if json:
        print_json(facts | {"black_level": level})
        return
    for key, value in facts.items():
        shown = (
            ", ".join(value) if isinstance(value, list) else format(value, ".4g" if isinstance(value, float) else "")
        )
        typer.echo(f"{key.replace('_', ' ')}: {shown}")
    print_written(*outputs)


def _by_super_pixels(
    light: NDArray[Any],
    modulator: Modulator,
    weights: NDArray[Any] | None,
    route: str,
    filter: str | None,
    *,
    out: Path,
    deviation: Path | None,
) -> dict[str, Any]:
    import numpy as np

    from lfcal.multiplex import demultiplex, demultiplex_weighted

    _check_recovered(modulator)
    facts: dict[str, Any] = {"samples": list(modulator.sample_names)[:16]}
    if route != "fourier" and (weights is not None or filter is None):
        if filter not in (None, "linear"):
            wanted = "linear, because pixels have weights (--camera, --mask, or NaN in the frame)"
            raise InputError.expected("--filter", wanted, filter, "leave --filter out")
        known = np.ones(light.shape) if weights is None else weights
        found = demultiplex_weighted(light, modulator, known)
        lost = float(np.isinf(found.deviation).any(0).mean())
        if lost == 1:
            wanted = "pixels that measure all samples somewhere"
            remedy = "reduce the exposure if pixels are saturated, or check --mask and --camera"
            raise InputError.expected(f"frame behind {modulator.name}", wanted, "none", remedy)
        _write(out, found.samples)
        if deviation is not None:
            _write(deviation, found.deviation)
        facts |= {"pixels_left_out": float((known == 0).mean()), "places_not_recovered": lost}
    elif deviation is not None:
        raise InputError.expected("--deviation", "the filter linear", filter or route, "leave --filter out")
    elif route != "fourier":
        _write(out, demultiplex(light, modulator, filter=filter))
    elif weights is not None:
        wanted = "spatial or both, because pixels have weights (--camera, --mask, or NaN in the frame)"
        raise InputError.expected("--route", wanted, "fourier", "give --route spatial")
    if route != "spatial":
        target = out if route == "fourier" else _fourier_file(out)
        _write(target, demultiplex(light, modulator, route="fourier"))
    return facts


def views(
    context: typer.Context,
    frame: Path = typer.Argument(help="Light-field frame."),
    *,
    white: Path | None = typer.Option(
        None, help="White image of the same camera, or a folder of them, from which the lattice is measured."
    ),
    lattice: Path | None = typer.Option(None, help="lattice.json of `lfcal white`, instead of --white."),
    camera: str | None = typer.Option(None, help="Preset or camera file that states the lattice, instead of --white."),
    out: Path = typer.Option(..., "--out", "-o", help="File to write: float32 TIFF, one page per view, by rows."),
    size: int = typer.Option(
        0, min=0, help="Number of views along each axis; 0: the largest odd number that fits into the pitch."
    ),
    dark: Path | None = typer.Option(
        None,
        help="Dark frame, or a folder of them to average, to subtract from frame and white image; default: the black "
        "level stated by the file, else by --sensor, is subtracted from the frame.",
    ),
    route: str = typer.Option(
        "spatial",
        help="Method: spatial; with --modulator also fourier, or both (the Fourier result goes to OUT_fourier.tif).",
    ),
    filter: str | None = typer.Option(
        None,
        help="Filter: nearest, linear or cubic; with --modulator also sinc. Default: linear if pixels have weights, "
        "else cubic.",
    ),
    modulator: str | None = typer.Option(None, help="Mask used instead of lenslets, such as MURA:11."),
    axes: str = typer.Option(
        "lattice",
        help="Direction of the pixel rows in each view: lattice (views are rotated with the lattice) or frame "
        "(views are upright).",
    ),
    sensor: str | None = typer.Option(
        None,
        help="Preset or camera file whose sensor gives the weights: saturated pixels are left out, others weighted "
        "by noise.",
    ),
    gain: GainOption = 1.0,
    exposure: ExposureOption = 0.0,
    mask: WithoutOption = None,
    deviation: DeviationOption = None,
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Demultiplex the views of a light field on a measured lattice of any pitch.

    Example: `lfcal multiplex views field.tif --white white.tif -o views.tif`
    """
    from lfcal.multiplex import channel_grid, demultiplex_lattice, read_recorded, without_black_level
    from lfcal.tasks import OF_WEIGHTS, load_camera

    check_choice("route", route, ROUTES)
    outputs = (out, _fourier_file(out) if route == "both" else None, deviation)
    check_outputs(outputs, frame, white, lattice, camera, dark, sensor, mask, force=force)
    if modulator is not None and size:  # the super-pixel of a mask fixes the number of views
        raise InputError.expected("views", "one of --size and --modulator", "both", "leave one out")
    if modulator is None and route != "spatial":
        raise InputError.expected("route", "spatial for lenslets", repr(route), "give the mask as --modulator")
    fit = _lattice_of(white, lattice, camera, dark)
    if sensor is None:
        refuse(context, "a --sensor", "none", "gain", "exposure")
    described = None if sensor is None else load_camera(sensor, only=OF_WEIGHTS).sensor
    recorded = read_recorded(frame)
    if recorded.raw.shape != fit.shape:
        wanted = f"{format_pixels(fit.shape)}, as the lattice has"
        raise InputError.expected(
            str(frame), wanted, format_pixels(recorded.raw.shape), "use the lattice of the camera that recorded it"
        )
    level = recorded.level(sensor=described)
    weights = recorded.weights(level, described, mask, gain=gain, exposure_s=exposure)
    if weights is None and deviation is not None:
        raise InputError.expected(
            "--deviation", "pixels with weights", "none", "give --sensor or --mask, or leave --deviation out"
        )
    raw = recorded.filled
    light = without_black_level(raw, level) if dark is None else _without_dark(raw, dark)
    if modulator is None:
        # an odd number of views includes one through the centre of the pupil
        cells: Any = size or max(1, (int(min(fit.pitch_px, fit.row_pitch_px)) - 1) // 2 * 2 + 1)
        grid = channel_grid(light.shape, fit, cells, axes=axes)
    else:
        cells = modulator_of(modulator)
        grid = channel_grid(light.shape, fit, cells.side, spacing_px=None, axes=axes)
    if weights is not None and (route == "fourier" or filter not in (None, "linear")):
        wanted = "spatial or both with linear, because pixels have weights (--sensor, --mask, or NaN in the frame)"
        got = f"{route} with {filter or 'linear'}"
        raise InputError.expected("--route and --filter", wanted, got, "leave both options out")
    if route != "fourier":
        found, spread = _views(light, weights, fit, cells, filter, axes=axes)
        _write(out, found)
        if deviation is not None and spread is not None:
            _write(deviation, spread)
    if route != "spatial":
        # this route weights all pixels equally, also the 0 of missing ones
        found = demultiplex_lattice(light, fit, cells, route="fourier", axes=axes)
        _write(out if route == "fourier" else _fourier_file(out), found)
    count = cells**2 if modulator is None else cells.count
    if json:
        facts = {"file": str(out), "views": count, "rows_columns": grid.shape}
        facts |= {name: getattr(grid, name) for name in ("corner_px", "step_px", "rotation_rad", "kept")}
        left = 0.0 if weights is None else float((weights == 0).mean())
        print_json(facts | {"black_level": None if dark else level, "pixels_left_out": left})
        return
    typer.echo(f"{count} views: {grid.described()}")


def _lattice_of(white: Path | None, lattice: Path | None, camera: str | None, dark: Path | None) -> FrameLattice:
    """Return the lattice from a file, from the white image, or from a camera."""
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
        return lattice_of(load_camera(camera, light=False))
    seen = read_average(Path(str(white)))
    return fit_lattice(seen if dark is None else _without_dark(seen, dark))


def _views(
    light: NDArray[Any], weights: NDArray[Any] | None, fit: FrameLattice, cells: Any, filter: str | None, *, axes: str
) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return the views and, for pixels with weights, their deviation.

    ``cells`` is the number of views along a side, or the mask that is used instead of lenslets.
    """
    from lfcal import multiplex as m

    through_mask = isinstance(cells, m.Modulator)
    if weights is None:
        alike = m.demultiplex_lattice if through_mask else m.lattice_channels
        return alike(light, fit, cells, filter=filter or "cubic", axes=axes), None
    weighted = m.demultiplex_lattice_weighted if through_mask else m.lattice_channels_weighted
    found = weighted(light, fit, cells, weights, axes=axes)
    return found.samples, found.deviation


def _fourier_file(out: Path) -> Path:
    """Return the path for samples of the Fourier route if both routes are requested: ``views_fourier.tif``."""
    return out.with_name(f"{out.stem}_fourier{out.suffix}")


def _without_dark(frame: NDArray[Any], dark: Path) -> NDArray[Any]:
    import numpy as np

    dimmed: NDArray[Any] = frame.astype(np.float32) - dark_level(dark, frame.shape)
    return dimmed


def _check_recovered(modulator: Modulator) -> None:
    """Raise `InputError` if some sample cannot be recovered anywhere: it would be written as 0, or as a guess."""
    lost = [name for name, share in zip(modulator.sample_names, modulator.lost(), strict=True) if share > 1e-9]
    if lost:
        got = f"none for {', '.join(lost[:4])}" + (f" and {len(lost) - 4} more" if len(lost) > 4 else "")
        remedy = "correct the pattern or matrix; `lfcal multiplex compare` shows what is lost"
        raise InputError.expected(f"pixels of {modulator.name}", "some that measure every sample", got, remedy)


def _write(path: Path, samples: NDArray[Any]) -> None:
    """Write the samples as float32 TIFF, one page for each."""
    import numpy as np

    write_tiff(path, samples.reshape(-1, *samples.shape[-2:]).astype(np.float32), metadata=None)
