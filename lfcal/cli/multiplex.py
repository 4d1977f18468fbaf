"""``lfcal multiplex``: plenoptic multiplexing: compare modulators, demultiplex frames."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError
from lfcal.cli import _multiplex_figures as pictures
from lfcal.cli._console import print_json, print_table, report, run_work
from lfcal.cli._multiplex_coding import coding
from lfcal.cli._multiplex_frames import check_told, level_of, read_frame, write_tiff
from lfcal.cli._multiplex_merits import design, gain_map_command, merits
from lfcal.cli._multiplex_recover import recover
from lfcal.cli._multiplex_views import views
from lfcal.cli._options import Chi2Option, ForceOption, GainOption, JsonOption, PresetOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.multiplex import GRAMMAR, is_whole, modulator_of
from lfcal.tasks import check_output, check_outputs

if TYPE_CHECKING:
    from lfcal.base import Work
    from lfcal.multiplex import Frontier, Modulator, ModulatorNumbers, SearchProgress

__all__ = ["register"]


def register(app: typer.Typer) -> None:
    """Add ``multiplex`` with its sub-commands."""
    group = typer.Typer(
        help="Plenoptic multiplexing: compare modulators, demultiplex frames.",
        epilog="Example: `lfcal multiplex demosaic shot.dng -o shot.tif`",
        no_args_is_help=True,
    )
    for name, function in (
        ("compare", compare),
        ("show", show),
        ("demosaic", demosaic),
        ("views", views),
        ("search", search),
        ("filters", filters),
        ("figures", figures),
        ("merits", merits),
        ("map", gain_map_command),
        ("design", design),
        ("recover", recover),
        ("coding", coding),
    ):
        group.command(name)(function)
    app.add_typer(group, name="multiplex")


def _chi2(
    context: typer.Context, chi2: float | None, camera: str | None, gain: float
) -> tuple[float | None, dict[str, float]]:
    """Return chi^2 from the options, and the camera to mark."""
    if camera is None:
        refuse(context, "a --camera", "none", "gain")
        return chi2, {}
    from lfcal.multiplex import camera_chi2
    from lfcal.tasks import load_camera

    if chi2 is not None:
        raise InputError.expected("chi^2", "one of --chi2 and --camera", "both", "leave one out")
    description = load_camera(camera)
    value = camera_chi2(description.sensor, gain=gain)
    return value, {description.name: value}


def _text(value: float | None, form: str = ".4g") -> str:
    return "—" if value is None else ("∞" if value > 0 else "-∞") if math.isinf(value) else format(value, form)


def compare(
    context: typer.Context,
    modulators: list[str] = typer.Argument(help=f"Such as {GRAMMAR}."),
    *,
    reference: str | None = typer.Option(None, help="Gains are over this one; the first by default."),
    chi2: Chi2Option = None,
    camera: PresetOption = None,
    gain: GainOption = 1.0,
    monte_carlo: int = typer.Option(0, min=0, help="Also measure the gain on this many simulated super-pixels."),
    out: Path | None = typer.Option(None, "--out", "-o", help="Draw the gain over chi^2 as PNG."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Show transmission, noise amplification, rank and gain of modulators.

    Example: `lfcal multiplex compare Bayer CYMG RGBW X-Trans --camera r29 -o gain.png`
    """
    from lfcal.multiplex import describe, gain_curves

    if out is not None:
        check_output(out, camera, force=force)
    chosen = [modulator_of(name) for name in modulators]
    base = modulator_of(reference) if reference else chosen[0]
    ratio, marks = _chi2(context, chi2, camera, gain)
    found = [describe(m, base, ratio) for m in chosen]
    measured = [_measured(m, base, monte_carlo) for m in chosen] if monte_carlo else []
    if out is not None:
        pictures.gains(chosen, base, marks, out, gain_curves)
    if json:
        print_json({"reference": base.name, "chi2": ratio, "modulators": found, "monte_carlo_gain_db": measured})
        return
    _print_numbers(found, measured, base.name, ratio)


def _measured(modulator: Modulator, base: Modulator, trials: int) -> list[float | None]:
    """Return the gain measured at additive and at photon noise; None where not all is recovered."""
    import numpy as np

    from lfcal.multiplex import monte_carlo_gain

    # gains are ratios of noise: both must recover all channels, and as many.
    if not modulator.rank() == modulator.count == base.count:
        return [None, None]
    return [
        # the same seed for every modulator: differences between them are not those of the draw.
        monte_carlo_gain(modulator, base, chi2, rng=np.random.default_rng(1), trials=trials)
        for chi2 in (0.0, math.inf)
    ]


def _print_numbers(
    found: list[ModulatorNumbers], measured: list[list[float | None]], base: str, chi2: float | None
) -> None:
    headers = [
        "modulator",
        "super-pixel (px)",
        "K",
        "N",
        "rank",
        "condition",
        "τ",
        "α",
        "gain, additive (dB)",
        "gain, photon (dB)",
        f"gain at χ² = {_text(chi2)} (dB)",
        "not recovered whole",
    ]
    rows = [_row(numbers) for numbers in found]
    if measured:
        headers += ["measured, additive (dB)", "measured, photon (dB)"]
        rows = [row + [_text(g, "+.3f") for g in pair] for row, pair in zip(rows, measured, strict=True)]
    print_table(headers, rows, title=f"Gain of SNR over {base}; additive χ² = 0, photon χ² = ∞")


def _row(numbers: ModulatorNumbers) -> list[str]:
    return [
        numbers.name,
        f"{numbers.side[0]} x {numbers.side[1]}",
        str(numbers.pixels),
        str(numbers.samples),
        str(numbers.rank),
        _text(numbers.condition),
        _text(numbers.transmission),
        _text(numbers.amplification),
        *(_text(g, "+.3f") for g in (numbers.gain_additive_db, numbers.gain_photon_db, numbers.gain_db)),
        _lost(numbers.lost),
    ]


def _lost(lost: dict[str, float]) -> str:
    if not lost:
        return "—"
    names = [f"{name} ({100 * share:.0f} %)" for name, share in list(lost.items())[:3]]
    return ", ".join(names) + (f" and {len(lost) - 3} more" if len(lost) > 3 else "")


def show(
    modulator: str = typer.Argument(help=f"Such as {GRAMMAR}."),
    *,
    out: Path = typer.Option(..., "--out", "-o", help="PNG with pattern, spectrum, Sigma and Pi."),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Draw a modulator: its pattern, spectrum and both bases.

    Example: `lfcal multiplex show MURA:11 -o mura.png`
    """
    from lfcal.multiplex import draw_modulator

    check_output(out, force=force)
    made = modulator_of(modulator)
    draw_modulator(made, out)
    if json:
        print_json(
            {
                "file": str(out),
                "modulator": made.name,
                "side_px": made.side,
                "samples": made.sample_names,
                "rank": made.rank(),
                "matrix": made.matrix,
            }
        )


def demosaic(
    context: typer.Context,
    frame: Path = typer.Argument(help="RAW, TIFF, PNG, NPY … of a colour mosaic."),
    *,
    out: Path = typer.Option(..., "--out", "-o", help="float32 TIFF of red, green and blue."),
    pattern: str | None = typer.Option(None, help="Filters, e.g. GRBG; RAW files know theirs."),
    route: str = typer.Option("spatial", help="spatial or fourier."),
    filter: str | None = typer.Option(
        None,
        help="Of the spatial route: directional, lmmse, nearest, linear, cubic, lanczos, sinc or bilateral; "
        "by default directional.",
    ),
    dark: float | None = typer.Option(None, help="Level of no light; RAW files state theirs."),
    page: int = typer.Option(0, min=0, help="Page of a file of many frames."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Demosaic a frame by the spatial or the Fourier route.

    Example: `lfcal multiplex demosaic shot.dng -o shot.tif`
    """
    from lfcal.multiplex import cfa, demultiplex, without_black_level

    if route == "fourier":
        refuse(context, "--route spatial", route, "filter")
    check_output(out, frame, force=force)
    recorded = read_frame(frame, page)
    mosaic = pattern or recorded.filters
    if not mosaic:
        raise InputError.expected(f"colour filters of {frame}", "a pattern", "none", "give --pattern, e.g. GRBG")
    levels = level_of(recorded, dark)
    light = without_black_level(recorded.raw, levels)
    array = cfa(mosaic)
    check_told(array)
    planes = demultiplex(light, array, route=route, filter=filter)
    write_tiff(out, planes)
    if json:
        told = {"file": str(out), "pattern": mosaic, "route": route, "black_level": levels}
        print_json({**told, "samples": array.sample_names, "shape": planes.shape})


def search(
    context: typer.Context,
    what: str = typer.Argument("filters", help="filters, or a mask's size such as 11."),
    *,
    chi2: Chi2Option = None,
    camera: PresetOption = None,
    gain: GainOption = 1.0,
    starts: int = typer.Option(6, min=0, help="Random masks per noise; six changed ones follow each."),
    out: Path | None = typer.Option(None, "--out", "-o", help="Draw the frontier as PNG."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Search filter sets or masks for the best gain at a camera's chi^2.

    Example: `lfcal multiplex search 7 --camera r29 -o masks.png`
    """
    from lfcal.multiplex import filter_set_frontier, iter_mask_frontier

    if out is not None:
        check_output(out, camera, force=force)
    ratio = _chi2(context, chi2, camera, gain)[0]
    if ratio is None:
        raise InputError.expected("chi^2", "--chi2 or --camera", "neither", "say for which camera to search")
    if what != "filters" and not is_whole(what):
        raise InputError.expected("search", "filters or a mask's size", repr(what), "for example 11")
    if what == "filters":
        refuse(context, "a mask's size", "filters", "starts")
        _show_found(filter_set_frontier(ratio), out, json=json)
        return
    kept: list[SearchProgress] = []
    try:
        frontier = run_work(_kept(iter_mask_frontier(int(what), ratio, starts=starts), kept), quiet=json)
    except BaseException:  # stopped: the best so far is what it was run for
        if kept and kept[-1].done:
            report(f"stopped after {kept[-1].count} searches; the best found so far:")
            _show_found(kept[-1].found, out, json=json, stopped=True)
        raise
    _show_found(frontier, out, json=json)


def _kept(work: Work[Frontier], kept: list[SearchProgress]) -> Work[Frontier]:
    """Pass on a search, and keep its newest record."""
    try:
        while True:
            record: Any = next(work)
            kept[:] = [record]
            yield record
    except StopIteration as end:
        found: Frontier = end.value
        return found
    finally:
        work.close()


def _show_found(frontier: Frontier, out: Path | None, *, json: bool, stopped: bool = False) -> None:
    if out is not None:
        from lfcal.multiplex import save_frontier

        save_frontier(frontier, out)
    pictures.show_frontier(frontier, json=json, stopped=stopped)


def filters(
    *,
    size: int = typer.Option(256, min=64, max=4096, help="Pixels along a side of the scenes."),
    out: Path | None = typer.Option(None, "--out", "-o", help="Draw error against time as PNG."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Compare reconstruction routes and filters: error, ringing and time on a smooth and on a sharp-edged scene.

    Example: `lfcal multiplex filters -o filters.png`
    """
    if out is not None:
        check_output(out, force=force)
    pictures.filter_choice(size, out, json=json)


def figures(
    context: typer.Context,
    folder: Path = typer.Argument(help="Folder for the pictures."),
    *,
    raw: Path | None = typer.Option(None, help="RAW frame for figure 3 in place of the drawn scene."),
    camera: str | None = typer.Option(None, help="Preset or camera file to mark in figure 6."),
    seed: int = typer.Option(1, help="Seed of the noise in figure 7."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Draw figures 3, 5, 6 and 7 of the paper, and the modulators.

    Example: `lfcal multiplex figures pictures/ --camera r29`
    """
    check_outputs(pictures.figure_files(folder), raw, camera, force=force)
    files = run_work(pictures.iter_paper_figures(folder, raw, _chi2(context, None, camera, 1.0)[1], seed), quiet=json)
    if json:
        print_json({"files": [str(path) for path in files]})
