"""Quality: which fault or metric is looked at, and what is shown of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lfcal_gui.context import Context
from lfcal_gui.models import ATLAS, capital
from lfcal_gui.pages.quality.evidence_view import CONCERNED
from lfcal_gui.pages.quality.inspect_panel import InspectPanel
from lfcal_gui.pages.quality.model import (
    concerned,
    fault_words,
    listed_metrics,
    map_of,
    marked,
    metric_words,
    place_words,
    planes_of,
    title_of,
)

if TYPE_CHECKING:
    from lfcal.judge import FoundFault, Inspection
    from lfcal.judge.quality import Metric

__all__ = ["Showing"]

NO_MAP = "Not known in this plane."
NO_CURVE = "One value for the whole of H: no curve over depth."


class Showing:
    """Follows what is chosen in the tables; nothing of an earlier inspection stays on the screen."""

    def __init__(self, panel: InspectPanel, context: Context) -> None:
        self._panel, self._context = panel, context
        self._found: Inspection | None = None
        self._finding: FoundFault | None = None
        self._metric: Metric | None = None
        self._metrics: tuple[Metric, ...] = ()
        self._z = 0
        panel.fault_chosen.connect(self._fault_chosen)
        panel.metric_chosen.connect(self._metric_chosen)
        panel.fault_asked.connect(lambda name: context.help_asked.emit(ATLAS, name))
        evidence = panel.evidence
        evidence.plane_chosen.connect(self._plane_chosen)
        evidence.plane_asked.connect(lambda: context.go.emit("psf", (self._z, 0, 0)))
        evidence.position_clicked.connect(self._position_clicked)

    def start(self, found: Inspection, *, every: bool = False) -> None:
        """Begin with an inspection, of which ``every`` metric is listed; what is chosen next is of it."""
        self.release()
        self._found, self._metrics = found, listed_metrics(found, every=every)
        self._z = min(self._z, planes_of(found) - 1)
        self._panel.evidence.set_planes(planes_of(found), self._z)

    def release(self) -> None:
        """Forget the inspection."""
        self._found = self._finding = self._metric = None
        self._metrics = ()

    @property
    def chosen(self) -> FoundFault | Metric | None:
        """The fault or metric looked at."""
        return self._finding if self._finding is not None else self._metric

    # -- faults ----------------------------------------------------------------------------------------
    def _fault_chosen(self, row: int) -> None:
        found = self._found
        if found is None or not 0 <= row < len(found.faults):
            return
        self._finding, self._metric = found.faults[row], None
        if len(self._finding.positions):  # the plane that has most of them
            self._z = int(np.bincount(self._finding.positions[:, 0]).argmax())
            self._panel.evidence.set_planes(planes_of(found), self._z)
        self._panel.show_words(fault_words(found, self._finding))
        self._show_picture(self._finding)
        self._show_map()

    def _show_picture(self, finding: FoundFault) -> None:
        evidence, picture = self._panel.evidence, finding.picture
        if picture is None:
            evidence.show_none(capital(finding.title), "There is no picture of this fault.")
            return
        title = capital(picture.title)
        label = picture.unit or "value"
        values = np.asarray(picture.values, float)
        if values.ndim == 2:
            evidence.show_image(title, picture.axes, label, values, picture.origin)
            return
        across = np.arange(len(values), dtype=float) if picture.across is None else picture.across
        evidence.show_curve(title, picture.axes[0], label, np.asarray(across, float), values)

    # -- metrics ---------------------------------------------------------------------------------------
    def _metric_chosen(self, row: int) -> None:
        found = self._found
        if found is None or not 0 <= row < len(self._metrics):
            return
        metric = self._metrics[row]
        self._finding, self._metric = None, metric
        self._panel.show_words(metric_words(found, metric))
        depths, values = found.quality.depths, metric.per_plane
        if values.size > 1 and values.size == len(depths):
            title = title_of(metric)
            label, along = ("depth z (mm)", depths / 1e3) if found.quality.extent else ("plane", np.arange(values.size))
            self._panel.evidence.show_curve("Over depth", label, title, along, values)
        else:
            self._panel.evidence.show_none("Over depth", NO_CURVE)
        self._show_map()

    # -- positions -------------------------------------------------------------------------------------
    def _plane_chosen(self, z: int) -> None:
        self._z = z
        self._show_map()

    def _show_map(self) -> None:
        evidence, z = self._panel.evidence, self._z
        if self._found is None:
            return
        if self._finding is not None:
            image = concerned(self._finding, self._found.quality.shape, z)
            evidence.offer_map(image is not None)
            evidence.show_map("Positions concerned", z, image, self._finding.name, CONCERNED)
            evidence.mark(marked(self._finding.positions, z))
            evidence.say(place_words(self._finding))
        elif self._metric is not None:
            metric = self._metric
            evidence.offer_map(metric.map is not None)
            evidence.show_map(
                "Over the positions of a plane", z, map_of(metric, z), metric.key, title_of(metric), NO_MAP
            )
            evidence.mark(marked(metric.positions, z))

    def _position_clicked(self, y: int, x: int) -> None:
        state = self._context.state
        self._context.go.emit("frames" if state.frames else "psf", (self._z, y, x))
