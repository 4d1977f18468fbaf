"""The figures of the paper, and the map of gains: computed where they are looked at."""

from __future__ import annotations

from typing import Any

import numpy as np

from lfcal.multiplex import camera_chi2, gain_map, paper_figure
from lfcal_gui.context import Context
from lfcal_gui.pages.multiplex.figures_view import MAP, FiguresView
from lfcal_gui.pages.multiplex.model import MultiplexSettings

__all__ = ["Drawing"]

MODULATORS = ("family", "cfa", "pattern", "mask", "size", "written")
MODULATORS += ("reference_cfa", "reference_mask", "reference_written")
"""Settings that change the modulator or its reference."""


class Drawing:
    """Draws the figure that is chosen, once."""

    def __init__(self, context: Context, view: FiguresView) -> None:
        self.context, self.view = context, view
        self._asked: tuple[Any, ...] = ()

    def forget(self) -> None:
        """Draw anew: a file may hold something else."""
        self._asked = ()

    def draw(self) -> None:
        """Draw the chosen figure, unless it is there or under way."""
        settings, camera = MultiplexSettings.of(self.context.state), self.context.state.camera
        own = settings.own_camera or settings.figure == 6
        chi2 = camera_chi2(camera.sensor, gain=settings.gain) if own else None
        asked: tuple[Any, ...] = (settings.figure, chi2, camera.name if own else "")
        if settings.figure == MAP:
            asked = (MAP, *(getattr(settings, key) for key in MODULATORS))
        if asked == self._asked:
            return
        self._asked = asked
        self.view.show_status("computing …")
        if settings.figure == MAP:
            chi2s = 10.0 ** np.arange(-4, 5)
            self.context.jobs.compute(
                "multiplex figure",
                lambda: gain_map(settings.modulator(), settings.reference(), chi2s),
                lambda found: self.view.show_map(found) if asked == self._asked else None,
                self.view.show_refusal,
            )
            return
        self.context.jobs.compute(
            "multiplex figure",
            lambda: paper_figure(settings.figure, camera=camera.name, chi2=chi2),
            lambda found: self.view.show_figure(found) if asked == self._asked else None,
            self.view.show_refusal,
        )
