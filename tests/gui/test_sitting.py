"""A whole sitting through the window, from the camera to the volume, ending in a PSF that inspection accepts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtWidgets import QMessageBox
from pytestqt.qtbot import QtBot

from lfcal.acquire.session_file import SessionFile
from lfcal.camera import ScanPlan
from lfcal.psf import open_psf
from lfcal.simulate import sample_session
from lfcal_gui.jobs import JobState
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, idle


def done(window: MainWindow, qtbot: QtBot) -> None:
    """Wait until nothing is at work, and look that no job failed."""
    idle(window.jobs, qtbot)
    failed = [job for job in window.jobs.jobs() if job.state is JobState.FAILED]
    assert not failed, f"{failed[0].title}: {failed[0].error}"


@pytest.mark.long
def test_from_the_camera_to_the_volume(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(QMessageBox, "question", lambda *_: QMessageBox.StandardButton.Yes)
    sample = ScanPlan.from_json((sample_session() / "plan.json").read_text(encoding="utf-8"))
    session, state = tmp_path / "session", window.context

    # camera and plan: from files, then one plane of it
    (tmp_path / "camera.json").write_text(sample.camera.to_json())
    (tmp_path / "plan.json").write_text(sample.to_json())
    window.go("setup")
    window.page("setup").import_file(str(tmp_path / "camera.json"))  # type: ignore[attr-defined]
    done(window, qtbot)
    assert state.state.camera == sample.camera
    plan_page: Any = window.page("setup")
    plan_page.open_plan(str(tmp_path / "plan.json"))
    done(window, qtbot)
    plan_page._scan_edited("depths", sample.depths_um[:1])
    plan_page._scan_edited("settle", 0.0)
    plan = state.state.plan
    assert plan is not None and plan.shape == (1, *sample.shape[1:])

    # white and dark, then the recording, by the simulator's own plenoptic image
    window.go("acquire")
    acquire: Any = window.page("acquire")
    qtbot.waitUntil(lambda: acquire.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    window.project.update("folder", recording=str(session))
    acquire.setup.connect_devices()
    qtbot.waitUntil(lambda: acquire.setup.station is not None, timeout=GUARD_MS)
    done(window, qtbot)
    for kind in ("white", "dark"):
        acquire.setup.measuring.take_stills(kind)
        qtbot.waitUntil(lambda: acquire.setup.free, timeout=GUARD_MS)
        assert f"8 {kind} frames" in acquire.panel.setup.results[kind].text()
    acquire.record.start()
    qtbot.waitUntil(lambda: acquire.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: not acquire.record.recording, timeout=GUARD_MS)
    done(window, qtbot)
    assert acquire.record.folder.complete

    # H, and what inspection says of it
    acquire.record.after.assemble(str(session / "H.h5"))
    done(window, qtbot)
    assert state.state.psf == str(session / "H.h5")
    assert window.shown.spec.key == "h"
    judge(window, qtbot)

    # two positions again
    window.project.update("positions to record again", redo=((0, 3, 4), (0, 9, 20)))
    window.go("acquire")
    assert acquire.panel.record.buttons["redo"].text() == "Record again (2)"
    acquire.record.start(redo=True)
    qtbot.waitUntil(lambda: acquire.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: not acquire.record.recording, timeout=GUARD_MS)
    done(window, qtbot)
    assert state.state.redo == () and len(SessionFile.read(session).recordings) == 2
    acquire.record.after.assemble(str(session / "H.h5"))
    done(window, qtbot)
    judge(window, qtbot)

    # the camera retrieved from it, an H simulated, both compared
    psf: Any = window.page("h")
    window.go("h", "fit")
    done(window, qtbot)
    psf.fitting._edited("positions", 12)
    psf.fitting.begin()
    done(window, qtbot)
    assert psf.fitting.found is not None, psf.notice.label.text()
    window.go("simulate")
    simulate: Any = window.page("simulate")
    done(window, qtbot)
    simulate.simulate(str(tmp_path / "simulated.h5"))
    done(window, qtbot)
    assert state.state.reference == str(tmp_path / "simulated.h5")
    window.go("h", "compare")
    psf.comparing.compare()
    done(window, qtbot)
    assert psf.comparing.found is not None

    # export and a volume
    window.go("reconstruct")
    reconstruct: Any = window.page("reconstruct")
    done(window, qtbot)
    reconstruct.exporting.start(str(tmp_path / "H.mat"))
    done(window, qtbot)
    assert (tmp_path / "H.mat").stat().st_size > 1e6
    reconstruct.make_light_field("points", str(tmp_path / "points.tif"))
    done(window, qtbot)
    reconstruct.panel.form.set_values({"iterations": 3})
    reconstruct.start()
    done(window, qtbot)
    assert reconstruct.solving is not None and np.isfinite(reconstruct.solving.history[-1].residual)
    with open_psf(session / "H.h5") as H:
        assert H.recorded.all()
    assert AcquireSettings.of(state.state).backend == "sim"


def judge(window: MainWindow, qtbot: QtBot) -> None:
    """Inspect H, which must be usable."""
    window.go("h", "checks")
    checking = window.page("h").checking  # type: ignore[attr-defined]
    done(window, qtbot)
    found = checking.inspection
    assert found is not None and not found.bad, found.verdict
