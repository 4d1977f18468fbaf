"""``lfcal multiplex``: plenoptic multiplexing: compare modulators, demultiplex frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from lfcal.cli._console import print_json, print_result, print_written
from lfcal.cli._docstrings import docstring
from lfcal.cli._multiplex_coding import coding
from lfcal.cli._multiplex_frames import demosaic, recover, views
from lfcal.cli._multiplex_search import chi2_of, design, figures, filters, search
from lfcal.cli._options import (
    Chi2Option,
    ExposureOption,
    ForceOption,
    GainOption,
    JsonOption,
    PresetOption,
    UncorrectedOption,
    WorkersOption,
)
from lfcal.multiplex import GRAMMAR, modulator_of
from lfcal.tasks import check_output

if TYPE_CHECKING:
    from lfcal.multiplex import Modulator, ModulatorNumbers

__all__ = ["register"]

SHOWN_CHI2 = (1e-4, 1e-2, 1.0, 1e2, 1e4)

MERITS = {
    "gain_plain_db": "gain, plain (dB)",
    "gain_optimal_db": "gain, least noise (dB)",
    "worst_noise_percent": "worst sample, noise (% of light)",
    "mtf_0.1": "MTF at 0.1 c/px",
    "mtf_0.25": "MTF at 0.25 c/px",
    "false_detail_0.25": "false detail at 0.25 c/px",
    "delta_e_mean": "ΔE00, mean",
    "delta_e_noise": "ΔE00, noise",
}
"""Figures of merit of a modulator, and their headings."""

ModulatorArgument: TypeAlias = Annotated[str, typer.Argument(help=f"Modulator, such as {GRAMMAR}.")]
ModulatorsArgument: TypeAlias = Annotated[list[str], typer.Argument(help=f"Modulators, such as {GRAMMAR}.")]
ReferenceOption: TypeAlias = Annotated[
    str | None, typer.Option("--reference", help="Modulator that gains are relative to; default: the first.")
]


def register(app: typer.Typer) -> None:
    """Add ``multiplex`` with its subcommands to ``app``."""
    group = typer.Typer(
        help="Plenoptic multiplexing: compare modulators, demultiplex frames.",
        epilog="Example: `lfcal multiplex demosaic shot.dng -o shot.tif`",
        no_args_is_help=True,
    )
    commands = (compare, show, demosaic, views, search, filters, figures, merits, map, design, recover, coding)
    for command in commands:
        group.command(command.__name__, help=docstring(command))(command)
    app.add_typer(group, name="multiplex")


def _text(value: float | None, form: str = ".4g") -> str:
    return "—" if value is None else ("∞" if value > 0 else "-∞") if math.isinf(value) else format(value, form)


def compare(
    context: typer.Context,
    modulators: ModulatorsArgument,
    *,
    reference: ReferenceOption = None,
    chi2: Chi2Option = None,
    camera: PresetOption = None,
    gain: GainOption = 1.0,
    monte_carlo: int = typer.Option(
        0, min=0, help="Number of simulated super-pixels on which the gain is also measured; 0: none."
    ),
    out: Path | None = typer.Option(
        None, "--out", "-o", help="File for a plot of the gain as a function of chi^2 (.png)."
    ),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Show transmission, noise amplification, rank and gain of modulators.

    Example: `lfcal multiplex compare Bayer CYMG RGBW X-Trans --camera r29 -o gain.png`
    """
    from lfcal.multiplex import describe, gain_curves, save_gain_curves

    check_output(out, camera, force=force)
    chosen, base = _modulators(modulators, reference)
    ratio, marks = chi2_of(context, chi2, camera, gain)
    found = [describe(m, base, ratio) for m in chosen]
    measured = [_measured(m, base, monte_carlo) for m in chosen] if monte_carlo else []
    if out is not None:
        save_gain_curves([("", gain_curves(chosen, base, cameras=marks))], out)
    columns: dict[str, Callable[[ModulatorNumbers], str]] = {
        "modulator": lambda n: n.name,
        "super-pixel (px)": lambda n: f"{n.side[0]} x {n.side[1]}",
        "K": lambda n: str(n.pixels),
        "N": lambda n: str(n.samples),
        "rank": lambda n: str(n.rank),
        "condition": lambda n: _text(n.condition),
        "τ": lambda n: _text(n.transmission),
        "α": lambda n: _text(n.amplification),
        "gain, additive (dB)": lambda n: _text(n.gain_additive_db, "+.3f"),
        "gain, photon (dB)": lambda n: _text(n.gain_photon_db, "+.3f"),
        f"gain at χ² = {_text(ratio)} (dB)": lambda n: _text(n.gain_db, "+.3f"),
        "not fully recovered": lambda n: _lost(n.lost),
    }
    rows = [[cell(numbers) for cell in columns.values()] for numbers in found]
    headers = list(columns)
    if measured:
        headers += ["measured, additive (dB)", "measured, photon (dB)"]
        rows = [row + [_text(g, "+.3f") for g in pair] for row, pair in zip(rows, measured, strict=True)]
    facts = {"reference": base.name, "chi2": ratio, "modulators": found, "monte_carlo_gain_db": measured}
    title = f"Gain of SNR over {base.name}; additive χ² = 0, photon χ² = ∞"
    print_result(facts, headers, rows, title=title, json=json)


def _modulators(names: list[str], reference: str | None) -> tuple[list[Modulator], Modulator]:
    """Return the modulators, and the reference of the gains."""
    chosen = [modulator_of(name) for name in names]
    return chosen, modulator_of(reference) if reference else chosen[0]


def _measured(modulator: Modulator, base: Modulator, trials: int) -> tuple[float | None, ...]:
    """Return the gain measured with additive and with photon noise; None if a channel cannot be recovered."""
    import numpy as np

    from lfcal.multiplex import monte_carlo_gain

    # gains are ratios of noise: both must recover all channels, and the same number
    if not modulator.rank() == modulator.count == base.count:
        return None, None
    # the same seed for every modulator, so that differences are not random
    return tuple(
        monte_carlo_gain(modulator, base, chi2, rng=np.random.default_rng(1), trials=trials) for chi2 in (0.0, math.inf)
    )


def _lost(lost: dict[str, float]) -> str:
    names = [f"{name} ({100 * share:.0f} %)" for name, share in list(lost.items())[:3]]
    return (", ".join(names) + (f" and {len(lost) - 3} more" if len(lost) > 3 else "")) or "—"


def show(
    modulator: ModulatorArgument,
    *,
    out: Path = typer.Option(
        ..., "--out", "-o", help="File for the figure of pattern, spectrum, and bases Sigma and Pi (.png)."
    ),
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Draw a modulator: its pattern, its spectrum, and the matrices Sigma and Pi.

    Example: `lfcal multiplex show MURA:11 -o mura.png`
    """
    from lfcal.multiplex import draw_modulator

    check_output(out, force=force)
    made = modulator_of(modulator)
    draw_modulator(made, out)
    if not json:
        print_written(out)
        return
    facts = {"file": str(out), "modulator": made.name, "side_px": made.side, "samples": made.sample_names}
    print_json({**facts, "rank": made.rank(), "matrix": made.matrix})


def merits(
    modulators: ModulatorsArgument,
    *,
    camera: str = typer.Option(..., help="Preset or camera file whose sensor noise to use."),
    reference: ReferenceOption = None,
    gain: GainOption = 1.0,
    exposure: ExposureOption = 0.0,
    uncorrected: UncorrectedOption = False,
    filter: str | None = typer.Option(
        None,
        help="Reconstruction filter for the MTF, such as cubic (see `multiplex filters`); default: directional for "
        "colour filters, else cubic.",
    ),
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Show the merits of modulators for a camera: gain at its noise, MTF and colour error.

    Example: `lfcal multiplex merits Bayer CYMG "RGBW 4x4" --camera r29 --exposure 0.02`
    """
    from lfcal.multiplex import merits as merits_of
    from lfcal.multiplex import sensor_noise
    from lfcal.tasks import OF_NOISE, OF_RAW_NOISE, load_camera

    chosen, base = _modulators(modulators, reference)
    described = load_camera(camera, only=OF_RAW_NOISE if uncorrected else OF_NOISE)
    noise = sensor_noise(described.sensor, gain=gain, exposure_s=exposure, flat_corrected=not uncorrected)
    found = [merits_of(m, noise, base, pattern=n, filter=filter) for m, n in zip(chosen, modulators, strict=True)]
    rows = [{"name": m.name, **dict(zip(MERITS, one, strict=True))} for m, one in zip(chosen, found, strict=True)]
    cells = [[m.name, *(_text(value, ".3g") for value in one)] for m, one in zip(chosen, found, strict=True)]
    facts = {"reference": base.name, "chi2": noise.chi2, "modulators": rows}
    title = f"Over {base.name}, χ² = {noise.chi2:.4g} at full scale"
    print_result(facts, ["modulator", *MERITS.values()], cells, title=title, json=json)


def map(
    modulator: ModulatorArgument,
    *,
    reference: str = typer.Option(..., help="Modulator to which gains are relative; it must have the same samples."),
    out: Path | None = typer.Option(None, "--out", "-o", help="File for the map (.png)."),
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Show the gain of each sample (band, colour or view) as a function of chi^2.

    Example: `lfcal multiplex map bands:CM/YG:3 --reference bands:RG/GB:3 -o map.png`
    """
    from lfcal.multiplex import gain_map, save_gain_map

    check_output(out, modulator, reference, force=force)
    one, two = modulator_of(modulator), modulator_of(reference)
    if out is not None:
        save_gain_map(gain_map(one, two), out)
    found = gain_map(one, two, SHOWN_CHI2)
    gains: list[list[float]] = found.gains.tolist()
    rows = [[name, *(_text(g, ".3g") for g in row)] for name, row in zip(found.samples, gains, strict=True)]
    title = f"Gain of each sample of {found.modulator} over {found.reference}"
    print_result(found, ["sample", *(f"χ² = {c:g} (dB)" for c in SHOWN_CHI2)], rows, title=title, json=json)
