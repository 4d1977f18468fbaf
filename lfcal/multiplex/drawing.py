"""Plots of modulators, gains, candidates, codes and reconstructions (matplotlib is imported when a plot is drawn)."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import COLOURS, LINES, draw_image, figure, save_figure
from lfcal.multiplex._sensor_noise import SensorNoise
from lfcal.multiplex.coding import CodingGain, coding_gain
from lfcal.multiplex.colour_filters import CFA_PATTERNS
from lfcal.multiplex.demultiplexing import demultiplex
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.noise import GainCurves, GainMap
from lfcal.multiplex.quality import FilterTrial
from lfcal.multiplex.search import Frontier

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

__all__ = [
    "colour_picture",
    "draw_modulator",
    "log_spectrum",
    "mosaic_picture",
    "save_coding",
    "save_colour_routes",
    "save_filter_choice",
    "save_frontier",
    "save_gain_curves",
    "save_gain_map",
    "upsampled_views",
]

Path = str | os.PathLike[str]
STYLES = ("-", "--", "-.", ":")
MOST_SHOWN = 64


def draw_curves(axes: Axes, curves: GainCurves, title: str = "") -> None:
    """Draw the gain of each modulator as a function of chi^2, marking the cameras in this range (Ihrke et al., fig. 6).

    Modulators without a finite gain are omitted.
    """
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
    axes.set_ylabel(f"SNR gain relative to {curves.reference} (dB)")
    axes.set_title(title)
    axes.legend(loc="best", ncols=2 if len(curves.names) > 4 else 1)


def save_gain_curves(parts: Sequence[tuple[str, GainCurves]], path: Path) -> None:
    """Write figure 6 of Ihrke et al.: one plot for each pair of title and curves, side by side."""
    with figure(5.2 * len(parts), 4.0) as fig:
        for axes, (title, curves) in zip(np.ravel(fig.subplots(1, len(parts))), parts, strict=True):
            draw_curves(axes, curves, title)
        save_figure(fig, path)


def save_gain_map(found: GainMap, path: Path) -> None:
    """Write an image of the gain of each sample as a function of chi^2; the middle of the colour scale is 0 dB."""
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
    """Write a figure of a modulator: its pattern, the pattern's spectrum, and its basis matrices Sigma and Pi."""
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
    """Draw the real part of a basis; only the first rows and columns of a large one."""
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
    """Write a plot of the candidates' gains for photon and additive noise, with the efficient ones marked.

    The candidate with the largest gain at ``frontier.chi2`` is also marked, and up to ``named`` efficient candidates
    are labelled.
    """
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
            label="Pareto front",
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
    """Write the names of up to ``named`` candidates; names that would overlap are omitted."""
    seen: set[tuple[float, float]] = set()
    # known patterns first, because readers look for these
    for k in sorted(order, key=lambda k: frontier.modulators[k].name not in CFA_PATTERNS):
        place = (round(float(frontier.photon[k]), 1), round(float(frontier.additive[k]), 1))
        if place not in seen and len(seen) < named:
            seen.add(place)
            at = (frontier.photon[k], frontier.additive[k])
            axes.annotate(frontier.modulators[k].name, at, fontsize=7, xytext=(5, -9), textcoords="offset points")


def save_filter_choice(parts: Sequence[tuple[str, Sequence[FilterTrial]]], path: Path) -> None:
    """Write plots of reconstruction error against time, side by side, one for each pair of title and trials."""
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
            axes.set_title(f"{title} (filled: no faster method is better)")
            axes.legend(loc="best")
        save_figure(fig, path)


Image = NDArray[Any]


def colour_picture(samples: ArrayLike, *, top: float | None = None, gains: Sequence[float] = (1, 1, 1)) -> Image:
    """Return three colour samples ``(3, rows, columns)`` as float ``(rows, columns, 3)`` in 0 … 1 for display.

    The colours are first multiplied by ``gains``. The value ``top`` appears white; by default, this is the 99.8th
    percentile. Values are encoded with a gamma of 1/2.2.
    """
    light = np.asarray(samples, float) * np.asarray(gains, float)[:, None, None]
    # a percentile, so that single hot pixels do not darken everything else
    white = float(np.percentile(light, 99.8)) if top is None else top
    shown: Image = np.clip(light / max(white, 1e-30), 0, 1).transpose(1, 2, 0) ** (1 / 2.2)
    return shown


def mosaic_picture(frame: ArrayLike, modulator: Modulator) -> Image:
    """Return a raw frame as an image ``(rows, columns, 3)`` in 0 … 1, with each pixel in its filter's colour.

    The colour is scaled by the pixel's value, with a gamma of 1/2.2; values at or above the 99.8th percentile have full
    brightness. Modulators without three colours are shown in grey.
    """
    image = np.asarray(frame, float)
    pattern = modulator.pattern()
    shares = pattern if pattern.shape[2] == 3 else np.repeat(pattern, 3, 2)
    tiles = [-(-n // s) for n, s in zip(image.shape, modulator.side, strict=True)]
    colours = np.tile(shares / max(1.0, float(shares.max())), (*tiles, 1))[: image.shape[0], : image.shape[1]]
    white = max(float(np.percentile(image, 99.8)), 1e-30)
    shown: Image = np.clip(image / white, 0, 1)[..., None] ** (1 / 2.2) * colours
    return shown


def log_spectrum(frame: ArrayLike) -> Image:
    """Return log10 of a frame's amplitude spectrum relative to its peak, with zero frequency in the middle.

    The frame is multiplied by a Hann window. Values are at least -6.
    """
    image = np.asarray(frame, float)
    # a window, because the frame's edges would draw a bright cross through the spectrum
    window = np.hanning(image.shape[0])[:, None] * np.hanning(image.shape[1])
    spectrum = np.abs(np.fft.fftshift(np.fft.fft2(image * window)))
    shown: Image = np.log10(np.maximum(spectrum / max(float(spectrum.max()), 1e-300), 1e-6))
    return shown


def save_colour_routes(
    frame: ArrayLike,
    modulator: Modulator,
    path: Path,
    *,
    zoom: tuple[slice, slice],
    others: Sequence[tuple[str, Image]] = (),
    ways: Sequence[tuple[str, str]] = (("spatial", "cubic"), ("fourier", "sinc")),
    gains: Sequence[float] = (1, 1, 1),
) -> None:
    """Write figure 3 of Ihrke et al., which compares reconstructions of a raw frame.

    It shows a magnified part of the raw frame, the spectrum of the frame, and each reconstruction, both complete and
    magnified.

    Parameters
    ----------
    frame, modulator
        A mosaic ``(rows, columns)`` after background subtraction, and its colour filter array.
    path
        File to write; its suffix determines the format.
    zoom
        Slices of the rows and columns to magnify.
    others
        Title and colours ``(3, rows, columns)`` of further reconstructions.
    ways
        Pairs of route and filter.
    gains
        Factors of red, green and blue for display.
    """
    image = np.asarray(frame, float)
    results = [
        (
            f"{route}, {name}" if route == "spatial" else "Fourier",
            demultiplex(image, modulator, route=route, filter=name),
        )
        for route, name in ways
    ] + list(others)
    # one white for all results, so that their brightness can be compared
    top = float(np.percentile(results[0][1] * np.asarray(gains)[:, None, None], 99.8))
    with figure(3.6 * (1 + len(results)), 5.6, dpi=150) as fig:
        grid = fig.subplots(2, 1 + len(results), squeeze=False)
        _show(grid[0, 0], mosaic_picture(image, modulator)[zoom], "raw frame, magnified", zoom)
        draw_image(
            grid[1, 0],
            log_spectrum(image),
            title="spectrum of the raw frame",
            unit="log10, relative",
            extent=(-0.5, 0.5, 0.5, -0.5),
            xlabel="cycles per pixel, x",
            ylabel="cycles per pixel, y",
        )
        for k, (title, colours) in enumerate(results, 1):
            picture = colour_picture(colours, top=top, gains=gains)
            _show(grid[0, k], picture, title)
            _show(grid[1, k], picture[zoom], f"{title}, magnified", zoom)
        save_figure(fig, path)


def _show(axes: Any, picture: Image, title: str, zoom: tuple[slice, slice] | None = None) -> None:
    extent = None
    if zoom is not None:
        rows, columns = zoom
        extent = (columns.start - 0.5, columns.stop - 0.5, rows.stop - 0.5, rows.start - 0.5)
    axes.imshow(np.clip(picture, 0, 1), extent=extent, interpolation="nearest")
    axes.grid(False)
    axes.set(title=title, xlabel="column (px)", ylabel="row (px)")


def upsampled_views(frame: ArrayLike, modulator: Modulator, factor: int = 3) -> list[tuple[str, Image]]:
    """Return pairs of a title and the views ``(N, rows, columns)`` of a frame, upsampled in three ways.

    The views have ``factor`` samples per super-pixel along each axis. The three ways (Ihrke et al., figure 5) are:
    zero-padded Fourier reconstruction; Fourier reconstruction with one sample per super-pixel, then bicubic
    interpolation; bicubic interpolation of the measurement channels, then decorrelation.
    """
    from lfcal.base import cv2

    image = np.asarray(frame, float)
    small = demultiplex(image, modulator, route="fourier", samples=1)
    size = (small.shape[2] * factor, small.shape[1] * factor)
    bicubic = np.stack([cv2.resize(view, size, interpolation=cv2.INTER_CUBIC) for view in small])
    return [
        ("zero-padded Fourier", demultiplex(image, modulator, route="fourier", samples=factor)),
        ("Fourier, then bicubic", bicubic),
        ("bicubic channels, then decorrelation", demultiplex(image, modulator, filter="cubic", samples=factor)),
    ]


SIGNALS = 25


def save_coding(
    gain: CodingGain, patterns: ArrayLike, code: ArrayLike, noise: SensorNoise, path: str | os.PathLike[str]
) -> None:
    """Write plots of the middle point's pattern, a code's gain at each of its pixels, and gains as functions of signal.

    ``patterns``, ``code`` and ``noise`` are the arguments of `coding_gain` that returned ``gain``.
    """
    light = np.asarray(patterns, float)
    middle = len(light) // 2
    with figure(12.0, 6.8) as fig:
        grid = fig.subplots(2, 2)
        shown = np.log10(np.maximum(light[middle] / np.nanmax(light), 1e-4))
        draw_image(
            grid[0, 0], shown, title="pattern of the middle point", unit="log10 of the value relative to the peak"
        )
        for axes, title, gains in (
            (grid[0, 1], f"equal time, {gain.signal_e:.3g} e⁻ in the brightest pixel", gain.time_db),
            (grid[1, 0], "equal full well", gain.full_well_db),
        ):
            draw_image(axes, gains[middle], title=title, unit="gain of each entry (dB)", signed=True)
        _over_light(grid[1, 1], light, np.asarray(code, float), noise, gain.signal_e)
        fig.suptitle(
            f"{gain.points} points lit together in {gain.frames} frames, compared with one at a time", fontsize=10
        )
        save_figure(fig, path)


def _over_light(
    axes: object, light: NDArray[np.float64], code: NDArray[np.float64], noise: SensorNoise, signal_e: float
) -> None:
    from matplotlib.axes import Axes

    assert isinstance(axes, Axes)
    signals = np.geomspace(min(1.0, noise.full_e / 100), noise.full_e, SIGNALS)
    found = [coding_gain(light, code, noise, signal_e=float(e)).time for e in signals]
    for k, (name, values) in enumerate(
        (
            ("all entries, rms", [one.rms_db for one in found]),
            ("bright entries", [one.core_db for one in found]),
            ("dark entries", [one.dark_db for one in found]),
        )
    ):
        axes.semilogx(signals, values, color=LINES[k], label=name)
    axes.axhline(0, color=COLOURS["muted"], lw=0.8)
    axes.axvline(signal_e, color=COLOURS["muted"], lw=0.8, ls=":")
    axes.set(xlabel="electrons in a point's brightest pixel, one frame", ylabel="gain at equal time (dB)")
    axes.legend(loc="best")
