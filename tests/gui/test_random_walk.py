from __future__ import annotations

import ctypes
import gc
import shutil
import sys
import threading
import traceback
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import QEvent
from PySide6.QtWidgets import QApplication, QMessageBox
from pytestqt.qtbot import QtBot

from lfcal.camera import preset
from lfcal.psf import PSFMatrix, save
from lfcal_gui.app import make_window, parse
from lfcal_gui.models.project import ProjectState
from lfcal_gui.window import MainWindow
from tests.cli.conftest import small_plan
from tests.gui.random_walk import Walk
from tests.gui.recorded import write_recorded
from tests.gui.waiting import GUARD_MS


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Write files that are good, damaged and missing."""
    plan, session = small_plan(), write_recorded(tmp_path / "recorded")
    good = tmp_path / "H.h5"
    rng = np.random.default_rng(3)
    save(PSFMatrix(rng.random((2, 3, 4, 9, 11), np.float32), depths=plan.depths_um, camera=plan.camera), good)
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(good.read_bytes()[:3000])
    camera = tmp_path / "camera.json"
    camera.write_text(preset("bench").to_json())
    project = tmp_path / "project.lfcal"
    project.write_text(ProjectState("walk", plan.camera, plan, psf=str(good)).to_json())
    broken = tmp_path / "broken.lfcal"
    broken.write_text("{}")
    partly = tmp_path / "partly"
    shutil.copytree(session, partly)
    (partly / "frames" / "z0_y0_x0.png").write_bytes(b"no picture")
    np.save(tmp_path / "array.npy", np.zeros((3, 4)))
    empty = tmp_path / "empty"
    empty.mkdir()
    return [
        session, session / "frames", session / "plan.json", good, damaged, camera, project, broken, partly, empty,
        tmp_path / "array.npy", tmp_path / "missing.h5", tmp_path / "missing",
    ]  # fmt: skip


def walk(window: MainWindow, qtbot: QtBot, files: list[Path], out: Path, seed: int, steps: int) -> None:
    out.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch, qtbot.captureExceptions() as raised:
        patch.chdir(out)  # names that are typed are of files there
        made = Walk(window, seed, files, out, patch)
        for _ in range(steps):
            try:
                made.step()
                wrong = ""
            except AssertionError as error:
                wrong = f"{error}\n{traceback.format_exc()}"
            told = [f"{kind.__name__}: {error}\n{''.join(traceback.format_tb(trace))}" for kind, error, trace in raised]
            if told or wrong:
                print("\n".join(made.trail[-40:]))
            assert not told, "\n".join(told)  # first: what is wrong may come of it
            assert not wrong, wrong
        for job in window.jobs.jobs():
            window.jobs.cancel(job.number)
        qtbot.waitUntil(lambda: not window.jobs.busy, timeout=GUARD_MS)


def test_a_random_walk_meets_no_wrong_state(
    window: MainWindow, qtbot: QtBot, files: list[Path], tmp_path: Path
) -> None:
    walk(window, qtbot, files, tmp_path / "out", seed=1, steps=150)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_a_long_random_walk(window: MainWindow, qtbot: QtBot, files: list[Path], tmp_path: Path, seed: int) -> None:
    """20,000 actions in twenty windows."""
    walk(window, qtbot, files, tmp_path / "out", seed=100 + seed, steps=1000)


def resident() -> int:
    """Return the bytes of this process that are in memory, what is free given back first."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    words = Path("/proc/self/status").read_text().split()
    return 1024 * int(words[words.index("VmRSS:") + 1])


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="memory is read as Linux tells it")
def test_memory_comes_back_and_windows_close(
    qapp: QApplication, qtbot: QtBot, files: list[Path], place: Path, tmp_path: Path
) -> None:
    """A window that was walked in leaves within 20 % what the first one left, and closes when it is asked to.

    The same actions in each: what others load at their first use stays, and should.
    """
    left = []
    for _ in range(3):
        window = make_window(qapp, parse([]), folder=place)
        window.show()
        qtbot.waitExposed(window, timeout=GUARD_MS)
        walk(window, qtbot, files, tmp_path / "out", seed=200, steps=400)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(QMessageBox, "question", lambda *_: QMessageBox.StandardButton.Discard)
            assert window.close() and window.isHidden()
        assert not [thread for thread in threading.enumerate() if "lfcal-job" in thread.name]
        window.deleteLater()
        del window
        QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
        left.append(resident())
    print("left in memory (MB):", [round(bytes_ / 1e6) for bytes_ in left])
    assert left[-1] <= 1.2 * left[0]
