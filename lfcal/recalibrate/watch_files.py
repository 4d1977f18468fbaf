"""Files of a watched series: a table, all numbers, and a plot."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import COLOURS, LINES, InputError, figure, read_text, save_figure, write_text
from lfcal.fit import json_text
from lfcal.recalibrate.watched import DRIFT_NAMES, DriftWatch

__all__ = ["RECALIBRATED", "StoredWatch", "read_watch", "watch_outputs", "write_watch"]

RECALIBRATED = "recalibrated"
"""Name of the folder with the recalibrated camera and its H, next to the file of numbers."""

NAMES = ("watch.csv", "watch.json", "watch.png")


def watch_outputs(folder: Path) -> tuple[Path, ...]:
    """Return the paths of the table, the numbers and the plot that `write_watch` writes to ``folder``."""
    return tuple(folder / name for name in NAMES)


def write_watch(found: DriftWatch, folder: Path, known: Mapping[str, Any]) -> tuple[Path, ...]:
    """Write the table, the numbers and the plot of a watched series to ``folder``, and return their paths.

    ``known`` contains entries to add to the numbers, as plain JSON types. Of them, ``recalibrated`` states whether the
    H in the folder `RECALIBRATED` belongs to this result; without it, it does not.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    table, numbers, plot = watch_outputs(folder)
    write_text(table, _table(found))
    write_text(numbers, json_text(found.to_dict() | {"recalibrated": False} | dict(known)))
    _draw(found, plot)
    return table, numbers, plot


@dataclass(frozen=True)
class StoredWatch:
    """Result of a watched series as read from its file.

    Attributes
    ----------
    file
        Path of the file of numbers.
    psf
        Path of the H whose validity was tested.
    verdict
        Verdict on H, as one sentence.
    first_moved
        Index of the first frame that differs significantly from the calibration; None without a drift.
    frames
        Drift, goodness of fit, alarm and problem of each frame, in the order of the series.
    has_recalibrated
        Whether the H in the folder ``recalibrated`` belongs to this result, and not to an earlier one.
    """

    file: Path
    psf: Path
    verdict: str
    first_moved: int | None
    frames: tuple[Mapping[str, Any], ...]
    has_recalibrated: bool = False

    @property
    def recalibrated(self) -> Path:
        """Folder with the recalibrated camera and its H; of an earlier result unless ``has_recalibrated`` is set."""
        return self.file.with_name(RECALIBRATED)


def read_watch(path: Path) -> StoredWatch:
    """Return the result of a watched series; ``path`` is the file of numbers or its folder.

    Raises
    ------
    StorageError
        If the file cannot be read.
    InputError
        If it is not the result of a watched series.
    """
    file = path / NAMES[1] if path.is_dir() else path
    try:
        said = json.loads(read_text(file))
        moved = said["first_moved"]
        frames = tuple(dict(one) for one in said["frames"])
        psf, verdict, own = Path(said["task"]["psf"]), str(said["verdict"]), said.get("recalibrated") is True
        return StoredWatch(file, psf, verdict, moved and int(moved), frames, own)
    except (KeyError, TypeError, ValueError):
        raise InputError.expected(str(file), "the result of lfcal watch", "another file", "run lfcal watch") from None


def _table(found: DriftWatch) -> str:
    """Return a CSV table with a line for each frame, including the test of the mean that contains the frame."""
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
