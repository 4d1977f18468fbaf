"""Numbers and curves of a modulator on the Multiplexing page, and the search for a better one. No Qt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lfcal.base import Clock, InputError, Work
from lfcal.camera import Sensor
from lfcal.multiplex import (
    Design,
    GainCurves,
    Modulator,
    ModulatorNumbers,
    best_array,
    best_printed_mask,
    camera_chi2,
    describe,
    gain_curves,
    merits,
    sensor_noise,
)
from lfcal_gui.models import minus
from lfcal_gui.pages.multiplex.model import TYPED, MultiplexSettings

MAX_SEEN = 1000
"""Largest product of pixels and samples for which the MTF is computed; more would take seconds."""


@dataclass(frozen=True, eq=False)
class ModulatorComparison:
    """Key figures of the chosen modulator, and gain curves of all compared modulators.

    Attributes
    ----------
    rows
        Name, value with unit, and meaning of each figure.
    curves
        Gains as functions of χ²; the first is that of the chosen modulator.
    left_out
        Names of modulators that do not recover every sample.
    chi2
        χ² of the user's camera.
    reason
        Why there are no curves; empty if there are some.
    """

    rows: tuple[tuple[str, str, str], ...]
    curves: GainCurves | None
    left_out: tuple[str, ...]
    chi2: float
    reason: str = ""


def compare(settings: MultiplexSettings, sensor: Sensor, camera: str = "camera") -> ModulatorComparison:
    """Return key figures of the chosen modulator, and gain curves of all compared modulators, for a camera."""
    modulator, reference = settings.modulator(), settings.reference()
    chi2 = camera_chi2(sensor, gain=settings.gain)
    try:
        numbers, reason = describe(modulator, reference, chi2), ""
    except InputError as error:
        numbers, reason = describe(modulator), str(error)
    curves, left_out = None, []
    if not reason:
        drawn = {m.name: m for m in (modulator, *settings.others())}
        high = 4.0 if math.isinf(chi2) or chi2 <= 0 else max(4.0, math.ceil(math.log10(chi2) + 0.5))
        curves = gain_curves(list(drawn.values()), reference, np.logspace(-4, high, 161), cameras={camera: chi2})
        left_out = [n for n, gains in zip(curves.names, curves.gains, strict=True) if not np.isfinite(gains).all()]
    rows = (*_rows(numbers, reference.name, chi2), *_merits(settings, modulator, reference, sensor))
    return ModulatorComparison(rows, curves, tuple(left_out), chi2, reason)


def _merits(
    settings: MultiplexSettings, modulator: Modulator, reference: Modulator, sensor: Sensor
) -> tuple[tuple[str, str, str], ...]:
    """Return figures of merit of the modulator: gain for the camera's noise, MTF, colour error."""
    pattern = (settings.pattern if settings.cfa == TYPED else settings.cfa) if settings.family == "cfa" else ""
    noise = sensor_noise(sensor, gain=settings.gain)
    how: dict[str, Any] = {"pattern": pattern, "most_entries": MAX_SEEN}
    try:
        found = merits(modulator, noise, reference, **how)
    except InputError:  # unlike samples, or some that the reference loses, have no gain
        found = merits(modulator, noise, **how)
    rows = []
    for name, key, gain in (
        ("Gain, plain", "plain", found.gain_plain_db),
        ("Gain, optimal", "optimal", found.gain_optimal_db),
    ):
        if gain is not None:
            tip = (
                f"Relative to {reference.name}, with the read, dark, quantisation and shot noise of each "
                f"pixel; {key} decorrelation"
            )
            rows.append((name, number(gain, "+.2f", "dB"), tip))
    if found.mtf_low is not None:
        tip = "Mean over samples: contrast at 0.1 and 0.25 cycles per pixel, and false detail at 0.25 cycles per pixel"
        rows.append(("MTF", f"{found.mtf_low:.2f}, {found.mtf_high:.2f}; false {found.false_detail:.2f}", tip))
    if found.delta_e is not None:
        tip = (
            "CIEDE2000 of 100 smooth reflectances in D65, with the built-in model filters; then the "
            "contribution of noise"
        )
        rows.append(("Colour error", f"{found.delta_e:.1f} ΔE, noise {number(found.delta_e_noise, '.1f')}", tip))
    return tuple(rows)


def number(value: float | None, form: str = ".4g", unit: str = "") -> str:
    """Return a number as text; ∞ for infinite and a dash for missing ones."""
    if value is None:
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    value = 0.0 if abs(value) < 1e-9 else value  # no sign for rounding errors
    return minus(f"{value:{form}} {unit}".strip())


def _rows(n: ModulatorNumbers, reference: str, chi2: float) -> tuple[tuple[str, str, str], ...]:
    return (
        ("Super-pixel", f"{n.side[1]} × {n.side[0]} px", "Size; its K pixels measure the same samples"),
        ("Samples N", str(n.samples), "Number of colours, views, or both that are multiplexed"),
        ("Rank", f"{n.rank} of {n.samples}", "Number of independent combinations of samples that are measured"),
        ("Condition number", number(n.condition), "Ratio of the largest to the smallest singular value of A = Σ Πᵀ"),
        ("Transmission τ", number(n.transmission), "Mean fraction of the light that reaches the sensor (equation 12)"),
        (
            "Amplification α",
            number(n.amplification),
            "Ratio of the rms noise of a sample to that of a pixel (equation 13)",
        ),
        (
            f"Gain at χ² = {number(chi2, '.3g')}",
            number(n.gain_db, "+.2f", "dB"),
            f"Signal-to-noise ratio relative to {reference} for the project's camera (equation 14), 10 log₁₀",
        ),
        ("Gain, additive noise", number(n.gain_additive_db, "+.2f", "dB"), f"Relative to {reference} at χ² = 0"),
        ("Gain, photon noise", number(n.gain_photon_db, "+.2f", "dB"), f"Relative to {reference} at χ² = ∞"),
        (
            "Not recoverable",
            _lost(n.lost),
            "Samples that are not fully measured; the missing part is reconstructed as zero",
        ),
    )


def _lost(lost: Mapping[str, float]) -> str:
    if not lost:
        return "nothing"
    named = [f"{name} {100 * share:.3g} %" for name, share in list(lost.items())[:4]]
    return ", ".join(named) + (f" and {len(lost) - 4} more" if len(lost) > 4 else "")


@dataclass(frozen=True, eq=False)
class FoundDesign:
    """Result of a search: the design, the χ² for which it is optimal, and rows of name and value as text."""

    design: Design
    chi2: float
    words: tuple[tuple[str, str], ...]


def iter_search(settings: MultiplexSettings, sensor: Sensor) -> Work[FoundDesign]:
    """Search for the design with the largest gain, as a job."""
    clock = Clock("search", 1)
    yield clock.at(0, settings.sought)
    chi2 = camera_chi2(sensor, gain=settings.gain)
    if settings.sought == "mask":
        found = best_printed_mask(
            settings.search_size,
            chi2,
            levels=settings.levels,
            crosstalk=settings.crosstalk,
            least_light=settings.least_light,
            starts=4,
        )
    else:
        side = (2, 3) if settings.sought.endswith("3") else (2, 2)
        letters = "RGBCMYW" if settings.crosstalk == 0 or side == (2, 2) else "RGBCMY"
        found = best_array(
            side,
            chi2,
            letters=letters,
            crosstalk=settings.crosstalk,
            most_kinds=settings.kinds,
            least_light=settings.least_light,
        )
    yield clock.at(1)
    return FoundDesign(found, chi2, _words(found, settings, chi2))


def _words(found: Design, settings: MultiplexSettings, chi2: float) -> tuple[tuple[str, str], ...]:
    over = "a pinhole" if settings.sought == "mask" else "Bayer"
    light = float(found.modulator.matrix.mean(0).mean())
    return (
        ("Best", found.modulator.name.replace("_", " ")),
        (f"Gain over {over}", f"{found.gain_db:+.3f} dB at χ² = {chi2:.4g}"),
        ("Certainty", found.certificate),
        ("Tried", f"{found.tried}"),
        ("Transmission τ", f"{light:.4g}"),
    )
