"""Plots of modulators, gains and choices (matplotlib, loaded when drawn)."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lfcal.base import COLOURS, LINES, draw_image, figure, save_figure
from lfcal.multiplex.colour_filters import CFA_PATTERNS
from lfcal.multiplex.gains import GainMap
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.noise import GainCurves
from lfcal.multiplex.quality import FilterTrial
from lfcal.multiplex.search import Frontier

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

__all__ = ["draw_curves", "draw_modulator", "save_filter_choice", "save_frontier", "save_gain_curves", "save_gain_map"]

Path = str | os.PathLike[str]
STYLES = ("-", "--", "-.", ":")
MOST_SHOWN = 64


def draw_curves(axes: Axes, curves: GainCurves, title: str = "") -> None:
    """Draw gain over chi^2 with a marker for each camera (figure 6)."""
    for k, (name, gain) in enumerate(zip(curves.names, curves.gains, strict=True)):
        if np.isfinite(gain).any():
            style = STYLES[k // len(LINES) % len(STYLES)]
            axes.semilogx(curves.chi2, gain, style, color=LINES[k % len(LINES)], label=name.replace("_", " "))
    axes.axhline(0, color=COLOURS["muted"], lw=0.8)
    low, high = float(curves.chi2.min()), float(curves.chi2.max())
    for name, chi2 in curves.cameras.items():
        if low <= chi2 <= high:
            axes.axvline(chi2, color=COLOURS["muted"], lw=0.8, ls=":")
            axes.annotate(
                name,
                (chi2, 0.02),
                xycoords=("data", "axes fraction"),
                rotation=90,
                fontsize=7,
                color=COLOURS["muted"],
                ha="right",
                va="bottom",
            )
    axes.set_xlabel("χ² = photon over additive noise variance (dimensionless)")
    axes.set_ylabel(f"gain of SNR over {curves.reference} (dB)")
    axes.set_title(title)
    axes.legend(loc="best", ncols=2 if len(curves.names) > 4 else 1)


def save_gain_curves(parts: Sequence[tuple[str, GainCurves]], path: Path) -> None:
    """Write figure 6: one plot per title and curves, side by side."""
    with figure(5.2 * len(parts), 4.0) as fig:
        for axes, (title, curves) in zip(np.ravel(fig.subplots(1, len(parts))), parts, strict=True):
            draw_curves(axes, curves, title)
        save_figure(fig, path)


def save_gain_map(found: GainMap, path: Path) -> None:
    """Write the gain of each sample over chi^2 as a picture, no gain in the middle of its colours."""
    gains = np.where(np.isfinite(found.gains), found.gains, np.nan)
    low, high = (math.log10(v) for v in (float(found.chi2[0]), float(found.chi2[-1])))
    with figure(7.0, 4.4) as fig:
        axes = fig.subplots()
        draw_image(
            axes,
            gains,
            title=f"{found.modulator} over {found.reference}",
            unit="gain (dB)",
            signed=True,
            extent=(low, high, len(gains) - 0.5, -0.5),
            xlabel="log10 of χ²",
            ylabel="sample",
        )
        axes.set_aspect("auto")
        shown = np.linspace(0, len(gains) - 1, min(16, len(gains))).astype(int)
        axes.set_yticks(shown, [found.samples[k] for k in shown])
        save_figure(fig, path)


def draw_modulator(modulator: Modulator, path: Path) -> None:
    """Write a modulator as its pattern, the pattern's spectrum, Sigma and Pi."""
    pattern, spectrum = modulator.pattern(), modulator.pattern_spectrum()
    with figure(12.0, 3.2) as fig:
        one, two, three, four = np.ravel(fig.subplots(1, 4))
        if pattern.shape[2] == 3:
            one.imshow(np.clip(pattern / max(1.0, pattern.max()), 0, 1))
            one.grid(False)
            one.set(title=f"{modulator.name}: pattern", xlabel="column (px)", ylabel="row (px)")
        else:
            draw_image(
                one,
                pattern[..., 0],
                title=f"{modulator.name}: pattern",
                unit="transmission",
                xlabel="column (px)",
                ylabel="row (px)",
            )
        rows, columns = modulator.side
        extent = (-(columns // 2) - 0.5, (columns - 1) // 2 + 0.5, (rows - 1) // 2 + 0.5, -(rows // 2) - 0.5)
        weights = spectrum.mean(2)
        levels = np.log10(np.maximum(weights / max(float(weights.max()), 1e-300), 1e-3))
        draw_image(
            two,
            levels,
            title="spectrum",
            unit="log10 of the magnitude, relative",
            extent=extent,
            xlabel="cycles per super-pixel, x",
            ylabel="cycles per super-pixel, y",
        )
        _basis(three, modulator.spatial, "spatial basis Σ", "basis function j", "pixel k of the super-pixel")
        _basis(four, modulator.plenoptic, "plenoptic basis Π", "basis function j", "plenoptic sample")
        save_figure(fig, path)


def _basis(axes: Axes, basis: Any, title: str, xlabel: str, ylabel: str) -> None:
    """Draw the real part of a basis; of a large one its first rows and columns."""
    from matplotlib.ticker import MaxNLocator

    part = np.real(basis[:MOST_SHOWN, :MOST_SHOWN])
    words = " (real part)" if np.iscomplexobj(basis) else ""
    cut = f", first {MOST_SHOWN}" if max(basis.shape) > MOST_SHOWN else ""
    draw_image(
        axes,
        part,
        title=f"{title}{words}{cut}",
        unit="value",
        signed=bool((part < 0).any()),
        xlabel=xlabel,
        ylabel=ylabel,
    )
    axes.set_aspect("auto")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))


def save_frontier(frontier: Frontier, path: Path, *, named: int = 8) -> None:
    """Write the candidates by their gain in both limits, the efficient ones joined, the best at the camera marked."""
    with figure(6.4, 4.4) as fig:
        axes = fig.subplots()
        axes.plot(frontier.photon, frontier.additive, ".", color=COLOURS["muted"], ms=4, label="candidates")
        order = np.flatnonzero(frontier.efficient)
        order = order[np.argsort(frontier.photon[order])]
        axes.step(
            frontier.photon[order],
            frontier.additive[order],
            where="post",
            color=COLOURS["accent"],
            marker="o",
            ms=4,
            label="nothing better in both",
        )
        best = frontier.best_index
        axes.plot(
            frontier.photon[best],
            frontier.additive[best],
            "*",
            ms=13,
            color=LINES[1],
            label=f"best at χ² = {frontier.chi2:.3g}: {frontier.chosen[best]:+.2f} dB",
        )
        _name_points(axes, frontier, order, named)
        axes.set_xlabel(f"gain over {frontier.reference} at χ² = ∞, photon noise (dB)")
        axes.set_ylabel(f"gain over {frontier.reference} at χ² = 0, additive noise (dB)")
        axes.margins(x=0.12)
        axes.legend(loc="best")
        save_figure(fig, path)


def _name_points(axes: Axes, frontier: Frontier, order: NDArray[np.intp], named: int) -> None:
    """Write the names of up to ``named`` candidates; names that would lie on each other are left out."""
    seen: set[tuple[float, float]] = set()
    # known patterns first: a reader looks for these
    for k in sorted(order, key=lambda k: frontier.modulators[k].name not in CFA_PATTERNS):
        place = (round(float(frontier.photon[k]), 1), round(float(frontier.additive[k]), 1))
        if place not in seen and len(seen) < named:
            seen.add(place)
            at = (frontier.photon[k], frontier.additive[k])
            axes.annotate(frontier.modulators[k].name, at, fontsize=7, xytext=(5, -9), textcoords="offset points")


def save_filter_choice(parts: Sequence[tuple[str, Sequence[FilterTrial]]], path: Path) -> None:
    """Write error against seconds for each titled list of trials, side by side."""
    with figure(5.2 * len(parts), 4.0) as fig:
        for axes, (title, trials) in zip(np.ravel(fig.subplots(1, len(parts))), parts, strict=True):
            for k, trial in enumerate(trials):
                marker, fill = "s" if trial.route == "fourier" else "o", None if trial.efficient else "white"
                axes.semilogx(
                    1e3 * trial.seconds,
                    100 * trial.error,
                    marker,
                    color=LINES[k % len(LINES)],
                    mfc=fill,
                    label=trial.name,
                )
            axes.set_ylim(bottom=0)
            axes.set_xlabel("time (ms)")
            axes.set_ylabel("rms error (% of the scene's range)")
            axes.set_title(f"{title} (filled: nothing faster is better)")
            axes.legend(loc="best")
        save_figure(fig, path)
