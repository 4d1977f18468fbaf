"""The gain of a code as a picture: a pattern, the gain of its entries both ways, and gain against light."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import COLOURS, LINES, draw_image, figure, save_figure
from lfcal.multiplex._sensor_noise import SensorNoise
from lfcal.multiplex.coding import CodingGain, coding_gain

__all__ = ["save_coding"]

SIGNALS = 25


def save_coding(
    gain: CodingGain, patterns: ArrayLike, code: ArrayLike, noise: SensorNoise, path: str | os.PathLike[str]
) -> None:
    """Write a picture of a code's gain for the middle point, and of all entries over the light of a point."""
    light = np.asarray(patterns, float)
    middle = len(light) // 2
    with figure(12.0, 6.8) as fig:
        grid = fig.subplots(2, 2)
        shown = np.log10(np.maximum(light[middle] / np.nanmax(light), 1e-4))
        draw_image(grid[0, 0], shown, title="pattern of the middle point", unit="log10 of its share of the peak")
        for axes, title, gains in (
            (grid[0, 1], f"equal time, {gain.signal_e:.3g} e⁻ in the brightest pixel", gain.time_db),
            (grid[1, 0], "equal full well", gain.full_well_db),
        ):
            draw_image(axes, gains[middle], title=title, unit="gain of each entry (dB)", signed=True)
        _over_light(grid[1, 1], light, np.asarray(code, float), noise, gain.signal_e)
        fig.suptitle(f"{gain.points} points lit together, {gain.frames} frames, over one at a time", fontsize=10)
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
            ("bright ones", [one.core_db for one in found]),
            ("dark ones", [one.dark_db for one in found]),
        )
    ):
        axes.semilogx(signals, values, color=LINES[k], label=name)
    axes.axhline(0, color=COLOURS["muted"], lw=0.8)
    axes.axvline(signal_e, color=COLOURS["muted"], lw=0.8, ls=":")
    axes.set(xlabel="electrons in a point's brightest pixel, one frame", ylabel="gain at equal time (dB)")
    axes.legend(loc="best")
