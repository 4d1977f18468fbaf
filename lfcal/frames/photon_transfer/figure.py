"""The photon-transfer curve as a picture."""

from __future__ import annotations

import os

import numpy as np

from lfcal.base import LINES, figure, save_figure
from lfcal.frames.photon_transfer.result import SensorMeasurement

__all__ = ["save_curve"]


def save_curve(found: SensorMeasurement, path: str | os.PathLike[str]) -> None:
    """Write noise over signal, both logarithmic: the points, the fit, and where it ends."""
    curve = found.curve
    with figure(6.4, 4.4) as fig:
        axes = fig.add_subplot()
        lit = curve.points.x > 0
        for chosen, colour, label in (
            (lit & curve.used, LINES[0], "measured, fitted"),
            (lit & ~curve.used, LINES[5], "measured, not fitted"),
        ):
            x, y = curve.points.x[chosen], np.sqrt(np.maximum(curve.points.y[chosen], 0))
            axes.plot(x, y, "o", ms=3, color=colour, label=label)
        if curve.slope is not None:
            first = max(float(curve.points.x[lit].min()) / 3, 1e-2)
            x = np.geomspace(first, curve.limit, 200)
            axes.plot(
                x, np.sqrt(curve.variance(x)), color=LINES[1], label=f"fit: {found.electrons_per_count} e⁻ per count"
            )
            axes.plot(x, np.sqrt(curve.slope.value * x), ":", color=LINES[6], label="photon noise alone")
        if found.read_noise_counts is not None:
            axes.axhline(found.read_noise_counts.value, ls="--", color=LINES[2], label="read noise")
        if found.saturation is not None:
            axes.axvline(found.saturation.value - found.dark_level.value, color=LINES[3], label="saturation")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("signal above black (counts)")
        axes.set_ylabel("noise, rms (counts)")
        axes.set_title("Photon transfer")
        axes.legend()
        save_figure(fig, path)
