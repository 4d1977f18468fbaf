"""Measure stage axes, optical axis and exposures with a few moves, and record white and dark frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QObject, Signal
from PySide6.QtWidgets import QFileDialog, QMessageBox

from lfcal.acquire import iter_stills, still_files
from lfcal.acquire.setup import OpticalAxis, StageFit, check_stage
from lfcal.base import InputError, format_length, format_seconds
from lfcal.camera import ScanPlan
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_station import Station
from lfcal_gui.pages.acquire.setup_panel import FINDINGS, STILLS, SetupPanel
from lfcal_gui.saving import may_replace

MEASURING = "measuring …"

ASKED = {
    "white": "Place a uniform light or a diffuser in front of the lens. Keep the iris as in the "
    "session.\nThe live view should be bright everywhere and saturated nowhere. If it is "
    "not, change the exposure.",
    "dark": "Cover the lens, and do not change the exposure.",
}
"""Instructions for the user before these frames are recorded."""


class SetupMeasuring(QObject):
    """Run the measurements of a `SetupPanel`, and store their results.

    Parameters
    ----------
    context, panel
        Context for jobs, and panel that shows the results.
    station
        Function that returns the devices; None if they are not connected or in use.
    """

    changed = Signal()
    """The devices were reserved or released."""

    def __init__(
        self, context: Context, panel: SetupPanel, station: Callable[[], Station | None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self.context, self.panel, self._station = context, panel, station
        self.found: dict[str, Any] = {}
        self._job = 0
        self._scene: Any = None
        panel.find_asked.connect(self.find)
        context.jobs.finished.connect(self._job_finished)

    @property
    def busy(self) -> bool:
        """Whether a measurement is running."""
        return bool(self._job)

    def forget(self, *keys: str) -> None:
        """Discard results."""
        for key in keys:
            self.found.pop(key, None)
            self.panel.show_result(key, "")

    def follow(self, plan: ScanPlan) -> None:
        """Discard results for other optics or planes; the axes of the stage remain valid."""
        scene = _scene(plan)
        if self._scene not in (None, scene):
            self.forget("axis", "exposure")
        self._scene = scene

    def find(self, key: str) -> None:
        """Measure one of `FINDINGS` as a job, or record white or dark frames."""
        if key in ASKED:
            self.take_stills(key)
            return
        from lfcal.acquire import setup as library

        station, plan = self._station(), self.context.state.plan
        if station is None or plan is None:
            return
        options, z = AcquireSettings.of(self.context.state).options(), min(self.panel.z, len(plan.depths_um) - 1)
        works: dict[str, Callable[[], Any]] = {
            "stage": lambda: library.iter_stage_fit(station.rig, plan, z=z, options=options),
            "axis": lambda: library.iter_optical_axis(station.rig, plan, options=options),
            "exposure": lambda: library.iter_exposures(station.rig, plan, options=options),
        }
        self._start(key, lambda: station.use(works[key]()), lambda found: self._found(key, found, plan))

    def _start(self, key: str, work: Callable[[], Any], done: Callable[[Any], None]) -> None:
        """Run a job with the devices; its result is shown below the button of the measurement."""
        title = {name: text for name, text, _ in (*FINDINGS, *STILLS)}[key]
        self.panel.show_result(key, MEASURING)
        self._job = self.context.jobs.start(
            title,
            "acquire",
            work,
            done,
            lambda job: self.panel.show_result(key, f"<b>{job.error}</b>", good=False),
            at_once=True,
        )
        self.changed.emit()

    def take_stills(self, kind: str) -> None:
        """Record white or dark frames in the session's folder, after the user has prepared the light for them."""
        station, plan, folder = self._station(), self.context.state.plan, self.context.state.recording
        if station is None or plan is None:
            return
        folder = folder or QFileDialog.getExistingDirectory(self.panel, "Folder of the session")
        if not folder or not may_replace(self.panel, still_files(Path(folder), kind)):
            return
        by_hand = station.name != "sim" and (kind == "white" or station.rig.light is None)
        buttons = QMessageBox.StandardButton
        if by_hand and buttons.Ok != QMessageBox.information(
            self.panel, "Before the frames", ASKED[kind], buttons.Ok | buttons.Cancel
        ):
            return
        self.context.project.update("session folder", recording=folder)
        exposure = self.panel.exposure.value() / 1e3
        self._start(
            kind,
            lambda: iter_stills(
                still_taker(station, plan, exposure, kind), plan, Path(folder), kind, light=station.rig.light
            ),
            lambda found: self.panel.show_result(kind, found.words(), done=True),
        )

    def _found(self, key: str, found: Any, asked: ScanPlan) -> None:
        plan = self.context.state.plan
        if plan is None or _scene(plan) != _scene(asked):
            self.panel.show_result(key, "The camera or the planes changed in the meantime; measure again.")
            return
        self.found[key] = found
        if key == "stage":
            words, good = fit_words(found, plan)
            taken = ""
            if found.axes != plan.stage:
                taken = self._take("stage axes as measured", replace(plan, stage=found.axes))
            self.panel.show_result(key, words + taken, good=good, done=True)
            self.context.attention.emit("acquire", not (good or taken))
        elif key == "axis":
            self.panel.show_result(key, axis_words(found, plan), done=True)
        else:
            words = exposure_words(found, plan)
            words += self._take("exposures as measured", replace(plan, exposure_s=found))
            self.panel.show_result(key, words, done=True)

    def _take(self, what: str, plan: ScanPlan) -> str:
        """Use the result in the plan, and return a sentence that states this; empty if nothing changed."""
        taken = self.context.project.update(what, plan=plan)
        return "<br>The plan now uses these values; undo (Ctrl+Z) restores the previous ones." if taken else ""

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._job = 0
        if job.state is JobState.CANCELLED:
            for key, label in self.panel.results.items():
                if label.text() == MEASURING:
                    self.panel.show_result(key, "")
        self.changed.emit()


def _scene(plan: ScanPlan) -> tuple[Any, ...]:
    """Return the data for which exposures and optical axis are valid."""
    return plan.camera, plan.depths_um


def still_taker(station: Station, plan: ScanPlan, exposure_s: float, kind: str) -> Callable[[int], NDArray[Any]]:
    """Return a function that records frame ``k``, or that simulates a white scene with the simulated devices."""
    if station.name == "sim" and kind == "white":
        from lfcal.simulate import SimulatedCamera

        scene = SimulatedCamera(plan, ())
        return lambda k: np.rint(scene.white_frame(k)).astype(np.uint16)

    def take(_: int) -> NDArray[Any]:
        look = station.look(exposure_s, plan)
        if look.frame is None or look.state.trouble:
            raise InputError.expected("frame", "one", look.state.trouble or "none", "check the camera")
        return np.array(look.frame.data)

    return take


def fit_words(fit: StageFit, plan: ScanPlan) -> tuple[str, bool]:
    """Return the fit of the stage as rich text, and whether the plan agrees with it."""
    try:
        check_stage(fit, plan)
        verdict, good = "<b>The stage moves the image as planned.</b>", True
    except InputError as error:
        verdict, good = f"<b>{error}</b>", False
    right, down = fit.scale
    axes = fit.axes
    return (
        f"{verdict}<br>scale right {right:.4f}, down {down:.4f} (1: as planned); rotation "
        f"{math.degrees(fit.rotation_rad):+.2f}°; residual {fit.residual_px:.3f} px rms<br>image right is stage "
        f"{axes.right}, down {axes.down}"
    ), good


def axis_words(axis: OpticalAxis, plan: ScanPlan) -> str:
    """Return where the optical axis is, as rich text."""
    right, down = axis.object_um
    row, column = axis.image_px
    off = [p - c for p, c in zip(axis.image_px, plan.camera.sensor.centre_px, strict=True)]
    return (
        f"<b>Optical axis</b> at right {format_length(right)}, down {format_length(down)} from the plan's origin; "
        f"image at row {row:.1f}, column {column:.1f} px ({off[0]:+.1f}, {off[1]:+.1f} px from the sensor's centre); "
        f"residual {axis.residual_px:.2f} px rms"
    )


def exposure_words(found: tuple[float, ...], plan: ScanPlan) -> str:
    """Return the exposure of each plane as rich text."""
    rows = "".join(
        f"<tr><td style='padding-right:10px'>{format_length(z)}</td><td><b>{format_seconds(t)}</b></td>"
        f"<td style='padding-left:10px'>was {format_seconds(old)}</td></tr>"
        for z, t, old in zip(plan.depths_um, found, plan.exposures, strict=True)
    )
    return f"<b>Exposure for 70 % of the range</b><table>{rows}</table>"
