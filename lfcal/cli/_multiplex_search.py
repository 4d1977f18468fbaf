"""``lfcal multiplex search``, ``design``, ``filters`` and ``figures``: find the best modulators, draw pictures."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError
from lfcal.cli._console import print_json, print_result, print_table, print_written, report, run_work
from lfcal.cli._options import Chi2Option, ForceOption, GainOption, JsonOption, PresetOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.multiplex import MATRIX_SUFFIXES, is_whole
from lfcal.tasks import check_output, check_outputs

if TYPE_CHECKING:
    from lfcal.multiplex import Frontier, SearchProgress

__all__ = ["chi2_of", "design", "figures", "filters", "search"]


def chi2_of(
    context: typer.Context, chi2: float | None, camera: str | None, gain: float = 1.0
) -> tuple[float | None, dict[str, float]]:
    """Return chi^2 from the options, and the chi^2 to mark, by the name of the camera."""
    from lfcal.multiplex import camera_chi2
    from lfcal.tasks import OF_NOISE, load_camera

    if camera is None:
        refuse(context, "a --camera", "none", "gain")
        return chi2, {}
    if chi2 is not None:
        raise InputError.expected("chi^2", "one of --chi2 and --camera", "both", "leave one out")
    description = load_camera(camera, only=OF_NOISE)
    value = camera_chi2(description.sensor, gain=gain)
    return value, {description.name: value}


def _needed_chi2(context: typer.Context, chi2: float | None, camera: str | None, gain: float) -> float:
    ratio, _ = chi2_of(context, chi2, camera, gain)
    if ratio is None:
        raise InputError.expected("chi^2", "--chi2 or --camera", "neither", "give one of them")
    return ratio


def search(
    context: typer.Context,
    what: str = typer.Argument(
        "filters", help="What to search for: the word filters, or the size of a mask in pixels, such as 11."
    ),
    *,
    chi2: Chi2Option = None,
    camera: PresetOption = None,
    gain: GainOption = 1.0,
    starts: int = typer.Option(
        6, min=0, help="Number of random starting masks per noise level; for each, the best mask is modified six times."
    ),
    out: Path | None = typer.Option(None, "--out", "-o", help="File for a plot of the gains of all candidates (.png)."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Search for the filter set or mask with the largest gain at a given chi^2, or at that of a camera.

    Example: `lfcal multiplex search 7 --camera r29 -o masks.png`
    """
    from lfcal.multiplex import filter_set_frontier, iter_mask_frontier

    check_output(out, camera, force=force)
    ratio = _needed_chi2(context, chi2, camera, gain)
    if what == "filters":
        refuse(context, "a mask's size", "filters", "starts")
        _show_found(filter_set_frontier(ratio), out, json=json)
        return
    if not is_whole(what):
        raise InputError.expected(
            "search", "filters or a mask's size", repr(what), "write filters, or the size of the mask in pixels: 11"
        )
    kept: deque[SearchProgress] = deque(maxlen=1)
    try:
        frontier = run_work(iter_mask_frontier(int(what), ratio, starts=starts), quiet=json, seen=kept.append)
    except BaseException:  # stopped: still show the best found so far
        if kept and kept[0].done:
            report(f"stopped after {kept[0].count} searches; the best found so far:")
            _show_found(kept[0].found, out, json=json, stopped=True)
        raise
    _show_found(frontier, out, json=json)


def _show_found(found: Frontier, out: Path | None, *, json: bool, stopped: bool = False) -> None:
    """Draw and print the efficient candidates and the best one at the camera's chi^2, also for a stopped search."""
    import numpy as np

    from lfcal.multiplex import save_frontier

    if out is not None:
        save_frontier(found, out)
    best = found.best_index
    order = [int(k) for k in np.argsort(-found.chosen) if found.efficient[k] or k == best]
    keys = ("gain_db", "gain_additive_db", "gain_photon_db")
    gains = np.stack([found.chosen, found.additive, found.photon], axis=1).tolist()
    rows = [(found.modulators[k].name, gains[k]) for k in order]
    facts = {"reference": found.reference, "chi2": found.chi2, "candidates": len(found.modulators)}
    facts["frontier"] = [{"name": name} | dict(zip(keys, row, strict=True)) for name, row in rows]
    facts |= {"best": found.best.matrix, "bound_db": found.bound, "stopped": stopped}
    cells = [[name, *(f"{gain:+.3f}" for gain in row)] for name, row in rows]
    title = (
        f"Gain over {found.reference}: {len(cells)} of {len(found.modulators)} candidates that no other candidate beats"
    )
    headers = ["modulator", f"gain at χ² = {found.chi2:.4g} (dB)", "additive (dB)", "photon (dB)"]
    print_result(facts, headers, cells, title=title, json=json)
    if found.bound is not None and not json:
        left = found.bound - float(found.chosen[best])
        report(f"no mask of this size gains more than {found.bound:+.3f} dB: at most {left:.3f} dB remain to be gained")


def design(
    context: typer.Context,
    what: str = typer.Argument(
        help="What to design: a super-pixel of filters, such as 2x2, or the size of a mask in pixels, such as 5."
    ),
    *,
    chi2: Chi2Option = None,
    camera: PresetOption = None,
    gain: GainOption = 1.0,
    crosstalk: float = typer.Option(0.0, help="Fraction of the light that a pixel loses to its neighbours."),
    letters: str = typer.Option("RGBCMYW", help="Letters of the filters to choose from."),
    kinds: int | None = typer.Option(None, min=1, help="Largest number of different filters."),
    levels: int = typer.Option(
        2, help="Number of transmission levels that can be printed, equally spaced from 0 to 1."
    ),
    least_light: float = typer.Option(0.0, help="Smallest fraction of the light that filters or mask must transmit."),
    most_light: float = typer.Option(1.0, help="Largest fraction of the light that a mask may transmit."),
    starts: int = typer.Option(12, min=0, help="Number of random starts for masks too large for an exhaustive search."),
    out: Path | None = typer.Option(
        None, "--out", "-o", help="File for the design: .json, or .npy for the transmissions only (rows, columns, N)."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Find the filters or the mask with the largest gain among those that can be manufactured, and an upper bound.

    Example: `lfcal multiplex design 2x2 --camera r29 --crosstalk 0.05 --kinds 3`
    """
    from lfcal.multiplex import best_array, best_printed_mask, save_modulator

    if out is not None and out.suffix.lower() not in MATRIX_SUFFIXES:
        raise InputError.expected("output", "a .npy or .json file", out, "change its extension")
    check_output(out, camera, force=force)
    ratio = _needed_chi2(context, chi2, camera, gain)
    rows, _, columns = what.partition("x")
    shared: dict[str, Any] = {"crosstalk": crosstalk, "least_light": least_light}
    if is_whole(rows) and is_whole(columns):
        refuse(context, "a mask's size", what, "levels", "most_light", "starts")
        found = best_array((int(rows), int(columns)), ratio, letters=letters, most_kinds=kinds, **shared)
    elif is_whole(what):
        refuse(context, "a super-pixel of filters", what, "letters", "kinds")
        found = best_printed_mask(int(what), ratio, levels=levels, most_light=most_light, starts=starts, **shared)
    else:
        raise InputError.expected(
            "design", "a super-pixel ROWSxCOLUMNS, or a mask's size", repr(what), "write it in the form 2x2 or 11"
        )
    m = found.modulator
    if out is not None:
        save_modulator(m, out)
    facts = {"name": m.name, "side": m.side, "chi2": ratio, "gain_db": found.gain_db, "bound_db": found.bound_db}
    facts |= {"tried": found.tried, "exhaustive": found.exhaustive, "certificate": found.certificate}
    facts["pattern"] = m.pattern()
    cells = [[m.name, f"{found.gain_db:+.3f}", f"{found.bound_db:+.3f}"]]
    headers = ["design", "gain (dB)", "no more than (dB)"]
    print_result(facts, headers, cells, title=f"χ² = {ratio:.4g}", json=json)
    if not json:
        report(found.certificate)


def filters(
    *,
    size: int = typer.Option(256, min=64, max=4096, help="Side length of the test scenes (px)."),
    out: Path | None = typer.Option(None, "--out", "-o", help="File for a plot of the error against run time (.png)."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Compare reconstruction routes and filters: error, ringing and time on a smooth and on a sharp-edged scene.

    Example: `lfcal multiplex filters -o filters.png`
    """
    from lfcal.multiplex import cfa, colour_edges, measure_filters, save_filter_choice, zone_plate

    check_output(out, force=force)
    scenes = {"smooth zone plate": zone_plate((size, size), 0.2), "sharp edges": colour_edges((size, size))}
    found = {name: measure_filters(scene, cfa("Bayer")) for name, scene in scenes.items()}
    if out is not None:
        save_filter_choice(list(found.items()), out)
    if json:
        print_json(found)
        return
    headers = ["way", "time (ms)", "rms error (%)", "ringing in flat parts (%)", "overshoot (%)", "efficient"]
    for name, trials in found.items():
        rows = []
        for t in trials:
            rings = ("—", "—")
            if t.ringing is not None:
                rings = (f"{100 * t.ringing.flat:.2f}", f"{100 * t.ringing.overshoot:.1f}")
            efficient = "yes" if t.efficient else ""
            rows.append([t.name, f"{1e3 * t.seconds:.1f}", f"{100 * t.error:.2f}", *rings, efficient])
        print_table(headers, rows, title=f"{name}, Bayer, {size} x {size} px; errors in % of the scene's range")


def figures(
    context: typer.Context,
    folder: Path = typer.Argument(help="Folder for the figures."),
    *,
    raw: Path | None = typer.Option(None, help="RAW frame for figure 3, instead of the synthetic scene."),
    camera: str | None = typer.Option(None, help="Preset or camera file to mark in figure 6."),
    seed: int = typer.Option(1, help="Seed of the noise in figure 7."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Draw figures 3, 5, 6 and 7 of Ihrke et al. (CVPR 2010), and the modulators.

    Example: `lfcal multiplex figures pictures/ --camera r29`
    """
    from lfcal.multiplex import figure_files, iter_paper_figures

    check_outputs(figure_files(folder), raw, camera, force=force)
    files = run_work(iter_paper_figures(folder, raw, chi2_of(context, None, camera)[1], seed), quiet=json)
    if json:
        print_json({"files": [str(path) for path in files]})
    else:
        print_written(*files)
