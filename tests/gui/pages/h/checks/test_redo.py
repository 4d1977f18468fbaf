"""Bad positions are recorded again with one click, which ends at the H before and after in the place H."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal.acquire import Options, record
from lfcal.base import drain
from lfcal.camera import ScanPlan
from lfcal.devices import open_rig
from lfcal.devices.protocols import Point
from lfcal.simulate import sample_session
from lfcal.tasks import Assemble
from lfcal_gui.window import MainWindow
from tests.acquire.rigs import Deceived
from tests.gui.waiting import GUARD_MS, idle

BAD = ((0, 3, 4), (0, 9, 20), (0, 15, 7))


@pytest.fixture
def plan() -> ScanPlan:
    """Return a plane of the sample, with light enough for dark frames of a simulated camera."""
    sample = ScanPlan.from_json((sample_session() / "plan.json").read_text(encoding="utf-8"))
    return replace(sample, depths_um=sample.depths_um[:1], exposure_s=4 * sample.exposures[0], settle_s=0.0)


@pytest.fixture
def session(plan: ScanPlan, tmp_path: Path) -> Path:
    """Record with a stage that is displaced at a few positions, which its encoder does not see."""
    bad = plan.stage_um(np.array(BAD))

    def true(_: int, target: Point) -> Point:
        off = float(np.abs(bad - target).max(axis=1).min()) < 1.0
        return (target[0] + 60.0, target[1] + 40.0, target[2]) if off else target

    folder = tmp_path / "session"
    with open_rig(plan, "sim", {}) as rig:
        deceived = replace(rig, stage=Deceived(rig.stage, true))
        record(folder, plan, deceived, Options(reference_every=0, check_stage=False))
    drain(Assemble(frames=folder, out=folder / "H.h5").work())[0].report.matrix.close()
    return folder


@pytest.mark.long
def test_bad_positions_are_recorded_again_with_one_click(
    window: MainWindow, qtbot: QtBot, plan: ScanPlan, session: Path
) -> None:
    first = session / "H.h5"
    window.project.update("bad", plan=plan, camera=plan.camera, recording=str(session), psf=str(first))
    window.go("acquire")
    acquire: Any = window.page("acquire")
    qtbot.waitUntil(lambda: acquire.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    acquire.setup.connect_devices()
    qtbot.waitUntil(lambda: acquire.setup.station is not None, timeout=GUARD_MS)
    window.go("h", "checks")
    psf: Any = window.page("h")
    checking = psf.checking
    qtbot.waitUntil(lambda: checking.inspection is not None, timeout=GUARD_MS)
    before, button = checking.inspection, checking.view.redo
    assert {place for place, _ in before.redo()} == set(BAD) and before.merit != "good"
    kept = first.read_bytes()
    assert button.text() == "Record 3 positions again"
    qtbot.mouseClick(button, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: window.project.state.psf == str(session / "H-2.h5"), timeout=GUARD_MS)
    qtbot.waitUntil(lambda: psf.plane is not None and psf.reference_plane is not None, timeout=GUARD_MS)
    assert window.stack.currentWidget() is psf
    assert (psf.intent.z, psf.intent.y, psf.intent.x) in BAD and psf.intent.view == "difference"
    qtbot.waitUntil(lambda: checking.inspection is not None and not checking._job, timeout=GUARD_MS)
    assert checking.inspection.merit == "good" and not checking.inspection.redo() and button.isHidden()
    assert first.read_bytes() == kept and window.project.state.reference == str(first)
    idle(window.jobs, qtbot)
