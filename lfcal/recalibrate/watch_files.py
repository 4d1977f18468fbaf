"""Files of a watched series: a table, all numbers, and a plot."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np

from lfcal.base import COLOURS, LINES, figure, save_figure, write_text
from lfcal.fit import json_text
from lfcal.recalibrate.watched import DRIFT_NAMES, DriftWatch

__all__ = ["watch_outputs", "write_watch"]

NAMES = ("watch.csv", "watch.json", "watch.png")


def watch_outputs(folder: Path) -> tuple[Path, ...]:
    """Return the paths of the table, the numbers and the plot that `write_watch` writes to ``folder``."""
    return tuple(folder / name for name in NAMES)


def write_watch(found: DriftWatch, folder: Path) -> tuple[Path, ...]:
    """Write the table, the numbers and the plot of a watched series to ``folder``, and return their paths.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    table, numbers, plot = watch_outputs(folder)
    write_text(table, _table(found))
    write_text(numbers, json_text(found.to_dict()))
    _draw(found, plot)
    return table, numbers, plot


def _table(found: DriftWatch) -> str:
    """Return a line for each frame, with the test of the mean that contains it."""
    tests = {name: one for one in found.means for name in one.frames}
    text = io.StringIO()
    values = [column for name in DRIFT_NAMES for column in (name, f"{name}_sigma")]
    columns = ["frame", "when", *values, "goodness", "t_squared", "threshold", "alarm", "problem"]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for one in found.frames:
        when = "" if one.when is None else one.when.isoformat(timespec="seconds")
        pairs = [v for pair in zip(one.values, one.sigmas, strict=True) for v in pair]
        ratio = "" if one.goodness is None else f"{one.goodness.ratio:.4f}"
        test = tests.get(one.name)
        tested = ["", "", ""] if test is None else [f"{test.t_squared:.4g}", f"{found.threshold:.4g}", int(test.alarm)]
        said = ["" if math.isnan(v) else f"{v:.5f}" for v in pairs]
        writer.writerow([one.name, when, *said, ratio, *tested, one.problem])
    return text.getvalue()


def _draw(found: DriftWatch, path: Path) -> None:
    """Draw the three drifts and T² against the number of the frame; means above the threshold are marked."""
    number = {one.name: k for k, one in enumerate(found.frames, 1)}
    at = np.array([np.mean([number[name] for name in one.frames]) for one in found.means])
    alarm = np.array([one.alarm for one in found.means], bool)
    with figure(7.0, 7.0) as fig:
        panels = fig.subplots(4, 1, sharex=True)
        values, sigmas = (np.array([getattr(one, name) for one in found.means]) for name in ("values", "sigmas"))
        for k, (panel, title) in enumerate(zip(panels, DRIFT_NAMES.values(), strict=False)):
            panel.axhline(0, color=COLOURS["muted"], linewidth=0.8)
            for some, colour in ((~alarm, LINES[0]), (alarm, COLOURS["bad"])):
                if some.any():
                    panel.errorbar(at[some], values[some, k], sigmas[some, k], fmt="o", color=colour, markersize=4)
            panel.set_ylabel(title)
        panels[3].axhline(found.threshold, color=COLOURS["bad"], linestyle="--", label="threshold")
        for some, colour in ((~alarm, LINES[0]), (alarm, COLOURS["bad"])):
            squares = np.array([one.t_squared for one in found.means])
            panels[3].plot(at[some], squares[some], "o", color=colour, markersize=4)
        panels[3].set_yscale("log")
        panels[3].set_ylabel("T²")
        panels[3].set_xlabel("frame")
        panels[3].legend(loc="upper left")
        panels[0].set_title(found.verdict.partition(":")[0])
        save_figure(fig, path)
