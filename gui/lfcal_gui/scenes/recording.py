"""A session recorded with the simulator: devices, live view, measurements, recording, dark lab."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from lfcal.camera import ScanPlan
from lfcal.devices.simulated import DeviceFault
from lfcal.simulate import sample_session
from lfcal_gui.scenes.stage import Capture, Stage

ENOUGH = 800
"""Positions that are recorded before a pause: the second plane is under way."""


def recording(stage: Stage) -> Iterator[Capture]:
    """Set up, record two planes, assemble them."""
    page = _begin(stage)
    yield from _set_up(stage, page)
    yield from _record(stage, page)


def _begin(stage: Stage) -> Any:
    """Start a project with the sample's plan and a new session folder; return the page."""
    window, folder = stage.window, stage.folder / "session"
    shutil.rmtree(folder, ignore_errors=True)
    plan = ScanPlan.from_json((sample_session() / "plan.json").read_text(encoding="utf-8"))
    window.project.update("plan of the sample", plan=replace(plan, settle_s=0.0))
    window.project.update("where to record", camera=plan.camera, recording=str(folder), redo=(), frames="", psf="")
    page = stage.page("acquire")
    stage.until(lambda: page.panel.setup.devices.backend.count() > 0, "the list of devices")
    stage.settle()
    return page


def settle_live(stage: Stage, page: Any) -> None:
    """Wait as `Stage.settle` does, with a camera whose live view never ends."""
    stage.until(lambda: not stage.window.jobs.busy, "a live frame")
    page.setup.live_timer.stop()
    stage.settle()


def _set_up(stage: Stage, page: Any) -> Iterator[Capture]:
    setup = page.panel.setup
    page.panel.setCurrentWidget(setup)
    stage.tidy()
    yield Capture("acquire_setup_unconnected")
    page.setup.connect_devices()
    stage.until(lambda: page.setup.station is not None, "the simulator")
    stage.until(lambda: setup.view.values is not None, "the first live frame")
    setup.overlays["lattice"].setChecked(True)
    stage.turn(40)
    stage.tidy()
    yield Capture("acquire_setup_live")
    settle_live(stage, page)
    for key in ("stage", "exposure", "dark"):
        page.setup.measuring.find(key)
        stage.until(lambda: page.setup.free, key)
        settle_live(stage, page)
    stage.tidy()
    yield Capture("acquire_setup_found")
    page.panel.devices.open()
    setup.devices.options.head.setChecked(True)
    setup.faults.fold.open()
    stage.turn()
    yield Capture("acquire_setup_options")
    setup.devices.options.head.setChecked(False)
    page.panel.devices.head.setChecked(False)


def _record(stage: Stage, page: Any) -> Iterator[Capture]:
    """Record, let the camera fail once, resume, and show H, which is assembled and judged at the end."""
    tab, panel = page.record, page.panel.record
    settle_live(stage, page)
    stage.tidy()
    yield Capture("acquire_record_ready")
    tab.start()
    stage.until(lambda: tab.recorder is not None and tab.recorder.taken > ENOUGH, "a part of the recording")
    tab.pause()
    stage.until(lambda: "paused" in panel.detail.text(), "the pause")
    stage.turn(60)
    yield Capture("acquire_record_paused")
    page.panel.setCurrentWidget(panel)
    stage.turn(20)
    yield Capture("acquire_record_session")
    yield from _dark_lab(stage, page)
    page.setup.station.inject(DeviceFault("vanishes", 40, 1))
    tab.pause()
    stage.until(lambda: not tab.recording, "the camera to be unplugged")
    settle_live(stage, page)
    yield Capture("acquire_record_failed")
    page.setup.disconnect_devices()
    settle_live(stage, page)
    tab.start()
    stage.until(lambda: tab.recording, "the recording to resume")
    stage.until(lambda: not tab.recording, "the end of the recording")
    settle_live(stage, page)
    stage.page("acquire")  # H was made meanwhile, and is in front
    stage.tidy()
    yield Capture("acquire_record_complete")
    panel.extent.setCurrentIndex(panel.extent.findData("error"))
    page.panel.recording.open()
    settle_live(stage, page)
    page.panel.inspector.ensureWidgetVisible(panel.until)
    yield Capture("acquire_record_error")
    page.panel.recording.head.setChecked(False)
    stage.page("h")
    stage.until(lambda: stage.window.leading.sitting.verdict is not None, "a verdict on H")
    stage.tidy()
    yield Capture("h_recorded")


def _dark_lab(stage: Stage, page: Any) -> Iterator[Capture]:
    page.lab.toggle.setChecked(True)
    stage.turn(20)
    yield Capture("acquire_lab", theme="night")
    page.lab.toggle.setChecked(False)
