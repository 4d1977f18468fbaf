"""``lfcal multiplex merits``, ``map`` and ``design``: what modulators are worth to a camera, and which can be made."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base import InputError
from lfcal.cli._console import print_json, print_table, report
from lfcal.cli._options import Chi2Option, ForceOption, GainOption, JsonOption, PresetOption, WorkersOption
from lfcal.cli._usage import refuse
from lfcal.multiplex import GRAMMAR, MATRIX_SUFFIXES, is_whole, modulator_of
from lfcal.tasks import check_output

if TYPE_CHECKING:
    from lfcal.multiplex import Design, Modulator, SensorNoise

__all__ = ["design", "gain_map_command", "merits"]

MOST_ENTRIES = 40_000
"""Pixels times samples of a modulator up to which its MTF is measured: masks of 13 x 13 px."""

SHOWN_CHI2 = (1e-4, 1e-2, 1.0, 1e2, 1e4)


def merits(
    modulators: list[str] = typer.Argument(help=f"Such as {GRAMMAR}."),
    *,
    camera: str = typer.Option(..., help="Preset or camera file whose sensor's noise is taken."),
    reference: str | None = typer.Option(None, help="Gains are over this one; the first by default."),
    gain: GainOption = 1.0,
    exposure: float = typer.Option(0.0, min=0, help="Seconds in which dark current gathers."),
    uncorrected: bool = typer.Option(False, "--uncorrected", help="Frames are not divided by a white image."),
    filter: str | None = typer.Option(
        None, help="Of the reconstruction whose MTF is shown; default: that of demosaic."
    ),
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Show what modulators are worth to a camera: gain by its own noise, MTF and colour error.

    Example: `lfcal multiplex merits Bayer CYMG "RGBW 4x4" --camera r29 --exposure 0.02`
    """
    from lfcal.multiplex import sensor_noise
    from lfcal.tasks import load_camera

    chosen = [modulator_of(name) for name in modulators]
    base = modulator_of(reference) if reference else chosen[0]
    noise = sensor_noise(load_camera(camera).sensor, gain=gain, exposure_s=exposure, flat_corrected=not uncorrected)
    rows = [_merits(m, name, base, noise, filter) for m, name in zip(chosen, modulators, strict=True)]
    if json:
        print_json({"reference": base.name, "chi2": noise.chi2, "modulators": rows})
        return
    headers = ["modulator", "gain, plain (dB)", "gain, least noise (dB)", "worst sample, noise (% of light)"]
    headers += ["MTF at 0.1 c/px", "MTF at 0.25 c/px", "false detail at 0.25 c/px", "ΔE00, mean", "ΔE00, noise"]
    title = f"Over {base.name}, χ² = {noise.chi2:.4g} at full scale"
    print_table(headers, [[row["name"], *(_told(v) for v in list(row.values())[1:])] for row in rows], title=title)


def _told(value: float | None) -> str:
    return "—" if value is None else "∞" if value == math.inf else "-∞" if value == -math.inf else f"{value:.3g}"


def _merits(m: Modulator, name: str, base: Modulator, noise: SensorNoise, filter: str | None) -> dict[str, Any]:
    from lfcal.multiplex import modulation_transfer, sample_deviation, sensor_gain

    gains = [sensor_gain(m, base, noise, decorrelation=d) for d in ("plain", "optimal")]
    # waves over many super-pixels of many samples take minutes and gigabytes
    seen = modulation_transfer(m, [0.1, 0.25], filter=filter) if m.count * m.pixels <= MOST_ENTRIES else None
    colour = _colour(m, name, noise)
    return {
        "name": m.name,
        "gain_plain_db": gains[0],
        "gain_optimal_db": gains[1],
        "worst_noise_percent": 100 * float(sample_deviation(m, noise).max()),
        "mtf_0.1": None if seen is None else float(seen.transfer[:, 0].mean()),
        "mtf_0.25": None if seen is None else float(seen.transfer[:, 1].mean()),
        "false_detail_0.25": None if seen is None else float(seen.aliased[:, 1].mean()),
        "delta_e_mean": None if colour is None else colour[0],
        "delta_e_noise": None if colour is None else colour[1],
    }


def _colour(m: Modulator, name: str, noise: SensorNoise) -> tuple[float, float | None] | None:
    """Return the colour error of patterns of filters that ship; other modulators have no curves."""
    from lfcal.multiplex import colour_error, parse_pattern, shipped_spectra

    if m.colours != ("R", "G", "B") or m.views != (1, 1):
        return None
    try:
        pattern = "/".join(parse_pattern(name))
        found = colour_error(pattern, efficiency=shipped_spectra("silicon"), noise=noise)
    except InputError:  # a matrix of one's own, or emerald
        return None
    return found.mean, found.noise


def gain_map_command(
    modulator: str = typer.Argument(help=f"Such as {GRAMMAR}."),
    *,
    reference: str = typer.Option(..., help="Gains are over this one, of the same samples."),
    out: Path | None = typer.Option(None, "--out", "-o", help="Draw the map as PNG."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Show the gain of each sample (band, colour, view) over chi^2.

    Example: `lfcal multiplex map bands:CM/YG:3 --reference bands:RG/GB:3 -o map.png`
    """
    from lfcal.multiplex import gain_map

    if out is not None:
        check_output(out, modulator, reference, force=force)
    one, two = modulator_of(modulator), modulator_of(reference)
    if out is not None:
        from lfcal.multiplex import save_gain_map

        save_gain_map(gain_map(one, two), out)
    found = gain_map(one, two, SHOWN_CHI2)
    if json:
        print_json(found)
        return
    rows = [[name, *(_told(float(g)) for g in gains)] for name, gains in zip(found.samples, found.gains, strict=True)]
    headers = ["sample", *(f"χ² = {c:g} (dB)" for c in SHOWN_CHI2)]
    print_table(headers, rows, title=f"Gain of each sample of {found.modulator} over {found.reference}")


def design(
    context: typer.Context,
    what: str = typer.Argument(help="Super-pixel of filters such as 2x2, or a mask's size such as 5."),
    *,
    chi2: Chi2Option = None,
    camera: PresetOption = None,
    gain: GainOption = 1.0,
    crosstalk: float = typer.Option(0.0, help="Share of the light that pixels lose to their neighbours."),
    letters: str = typer.Option("RGBCMYW", help="Filters to choose from."),
    kinds: int | None = typer.Option(None, min=1, help="Kinds of filters at most."),
    levels: int = typer.Option(2, help="Transmissions of a mask that can be printed."),
    least_light: float = typer.Option(0.0, help="Share of the light that must pass."),
    most_light: float = typer.Option(1.0, help="Share of the light that a mask may let through."),
    starts: int = typer.Option(12, min=0, help="Random starts of masks that are too large to try all."),
    out: Path | None = typer.Option(
        None, "--out", "-o", help="Write it: .npy, transmissions (rows, columns, N); .json, with its views."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Find the filters or the mask of most gain that can be made, and say how sure that is.

    Example: `lfcal multiplex design 2x2 --camera r29 --crosstalk 0.05 --kinds 3`
    """
    from lfcal.multiplex import best_array, best_printed_mask

    if out is not None:
        if out.suffix.lower() not in MATRIX_SUFFIXES:
            raise InputError.expected("output", "a file .npy or .json", out, "name it so")
        check_output(out, camera, force=force)
    ratio = _ratio(chi2, camera, gain)
    if camera is None:
        refuse(context, "a --camera", "none", "gain")
    rows, _, columns = what.partition("x")
    if is_whole(rows) and is_whole(columns):
        refuse(context, "a mask's size", what, "levels", "most_light", "starts")
        side = (int(rows), int(columns))
        found = best_array(side, ratio, letters=letters, crosstalk=crosstalk, most_kinds=kinds, least_light=least_light)
    elif is_whole(what):
        refuse(context, "a super-pixel of filters", what, "letters", "kinds")
        found = best_printed_mask(
            int(what),
            ratio,
            levels=levels,
            crosstalk=crosstalk,
            least_light=least_light,
            most_light=most_light,
            starts=starts,
        )
    else:
        raise InputError.expected("design", "a super-pixel such as 2x2, or a mask's size", repr(what), "correct it")
    _show_design(found, ratio, out, json=json)


def _ratio(chi2: float | None, camera: str | None, gain: float) -> float:
    from lfcal.multiplex import camera_chi2
    from lfcal.tasks import load_camera

    if (chi2 is None) == (camera is None):
        got = "neither" if chi2 is None else "both"
        raise InputError.expected("chi^2", "one of --chi2 and --camera", got, "say for which camera to search")
    return chi2 if chi2 is not None else camera_chi2(load_camera(str(camera)).sensor, gain=gain)


def _show_design(found: Design, chi2: float, out: Path | None, *, json: bool) -> None:
    m = found.modulator
    if out is not None:
        from lfcal.multiplex import save_modulator

        save_modulator(m, out)
    if json:
        told = {"name": m.name, "side": m.side, "chi2": chi2, "gain_db": found.gain_db, "bound_db": found.bound_db}
        told |= {"tried": found.tried, "exhaustive": found.exhaustive, "certificate": found.certificate}
        print_json(told | {"pattern": m.pattern()})
        return
    print_table(
        ["design", "gain (dB)", "no more than (dB)"],
        [[m.name, f"{found.gain_db:+.3f}", f"{found.bound_db:+.3f}"]],
        title=f"χ² = {chi2:.4g}",
    )
    report(found.certificate)
