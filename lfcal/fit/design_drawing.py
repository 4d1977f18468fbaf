"""Expected error of H against positions and time, as a picture."""

from __future__ import annotations

import os

from lfcal.base import LINES, figure, save_figure
from lfcal.fit.design import PositionDesign

__all__ = ["draw_design"]


def draw_design(design: PositionDesign, path: str | os.PathLike[str], positions: int, hours: float) -> None:
    """Draw the expected error of H from chosen positions and from as many spread evenly.

    Parameters
    ----------
    design
        What was chosen.
    path
        The picture.
    positions, hours
        Of the whole scan, whose patterns each have their own noise.
    """
    with figure(9.6, 4.0) as fig:
        left, right = fig.subplots(1, 2, sharey=True)
        counts = [point.positions for point in design.curve]
        minutes = [60 * point.hours for point in design.curve]
        chosen = [100 * point.error for point in design.curve]
        spread = [100 * point.spread_error for point in design.curve]
        left.plot(counts, chosen, "o-", color=LINES[0], label="chosen")
        left.plot(counts, spread, "s--", color=LINES[1], label="spread evenly")
        left.plot([positions], [100 * design.pattern_error], "D", color=LINES[6], label="whole scan, noise of each")
        left.set(xlabel="positions recorded", ylabel="expected error of H (%, relative L2)")
        right.plot(minutes, chosen, "o-", color=LINES[0])
        right.plot([60 * hours], [100 * design.pattern_error], "D", color=LINES[6])
        right.set(xlabel="time on the stage (min)")
        if design.start_error is not None:
            for panel in (left, right):
                panel.axhline(100 * design.start_error, color=LINES[2], lw=1, ls=":", label="by the earlier fit")
        for panel in (left, right):
            panel.set(xscale="log", yscale="log")
            for axis in (panel.xaxis, panel.yaxis):
                for which in (axis.set_major_formatter, axis.set_minor_formatter):
                    which(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "125" else "")
        left.legend()
        save_figure(fig, path)
