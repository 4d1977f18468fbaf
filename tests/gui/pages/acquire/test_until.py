"""Recording until H is known, in the window: chosen, followed, stopped, gone on with, and fitted."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from lfcal.acquire import Options, SessionFile, record, verify
from lfcal.base import InputError, Progress
from lfcal.campaign import AdaptiveStep, Goal
from lfcal.fit import Fit, ModelError, described_effects
from lfcal.psf import open_psf
from lfcal.simulate.effects.described import Entry, entries_json
from lfcal.tasks import AcquireUntil
from lfcal_gui.context import Context
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.acquire.model import UNTIL, AcquireSettings
from lfcal_gui.pages.acquire.model_folder import FolderState, folder_state
from lfcal_gui.pages.acquire.model_recorder import check_goal, error_curve, until_words
from lfcal_gui.pages.acquire.page import Page
from tests.acquire.rigs import CAREFUL, rig_for
from tests.fit.common import small_plan
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS

PLAN = replace(small_plan(15, (2.2,)), period=(6, 8), settle_s=0.0)
QUICK = {"first": 6, "unknowns": ("geometry",), "candidates": 40}


def step(positions: int, stated: float, squared: float = 0.0, sigma: float = 1e-6) -> AdaptiveStep:
    return AdaptiveStep(positions, stated, ModelError(squared, sigma, stated, 3), 1.0, True, ("geometry",), 0)


def test_settings_say_when_to_end() -> None:
    assert AcquireSettings().goal() is None, "every position, unless it is asked for otherwise"
    assert AcquireSettings(extent="error", until_error=0.002, most=40).goal() == Goal(0.002, most=40)
    errors = ({"until_error": value} for value in (0.0, 1.5, math.nan))
    for wrong in (*errors, {"most": 3}, {"extent": "some"}):
        with pytest.raises(InputError):
            AcquireSettings(**{"extent": "error", **wrong}).usable()
        AcquireSettings.from_dict({"extent": "error", **wrong}).usable()
    (shown,) = (spec for spec in UNTIL if spec.key == "most")
    for most in (None, 0):  # earlier projects store 0
        settings = AcquireSettings.from_dict({"extent": "error", "most": most})
        assert settings.values(PLAN)["most"] is None and shown.empty == "all of the plan"
        assert settings.goal() == Goal(0.005)


def test_curve_and_words_say_what_it_is_at() -> None:
    steps = [step(6, 0.01), step(12, 0.004, squared=4e-4, sigma=4e-5)]
    curve = error_curve(steps, Goal(0.003, most=40))
    assert curve.positions == (6, 12) and curve.stated == pytest.approx((1.0, 0.4)) and curve.wanted == 0.3
    # a limit has no interval; a value has two standard deviations: 2 % ± 2 x 0.1 %
    assert math.isnan(curve.below[0]) and curve.aside[0] == pytest.approx(100 * steps[0].held_out_error.limit)
    assert (curve.aside[1], curve.below[1], curve.above[1]) == pytest.approx((2.0, 0.2, 0.2))
    assert curve.words == "12 positions: estimated error 0.4 %, 2 % at held-out positions"
    assert error_curve([], Goal(0.003)).words == ""
    assert until_words(Progress(3, 6, "record"), [], 3) == ("3 positions, no fit yet", "recording the first 6")
    known, now = until_words(Progress(1, 4, "record"), [step(12, 0.004)], 13)
    assert known == "H from 12 positions, estimated error 0.4 %" and now == "recording 1 of 4 more"
    assert until_words(Progress(1, 4, "coarse, round 1"), [], 6)[1] == "fitting: coarse, round 1"
    assert until_words(Progress(1, 4, "information of patterns"), [], 0)[1] == "choosing the first positions"


def test_what_no_fit_can_tell_is_refused_before_anything_moves(tmp_path: Path) -> None:
    check_goal(PLAN, Options(), FolderState())
    with pytest.raises(InputError, match="enter 1 for Exposures"):
        check_goal(PLAN, Options(bracket=(1.0, 0.5)), FolderState())
    record(tmp_path, replace(PLAN, period=(1, 2)), rig_for(replace(PLAN, period=(1, 2))), CAREFUL)
    with pytest.raises(InputError, match="a scan of every position"):
        check_goal(PLAN, Options(), folder_state(str(tmp_path)))
    camera = replace(PLAN.camera, marks=PLAN.camera.marks.marked(["sensor.read_noise_e"], "assumed"))
    with pytest.raises(InputError, match="in Set up"):
        check_goal(replace(PLAN, camera=camera), Options(), FolderState())


# -- the page ----------------------------------------------------------------------------------------------
@pytest.fixture
def state(tmp_path: Path) -> ProjectState:
    effects = tmp_path / "effects.json"
    effects.write_text(entries_json(Entry(one, one.name, {}, "on") for one in described_effects(PLAN.camera)))
    settings = AcquireSettings(
        device_options=(("optics", "grid"), ("effects", str(effects))), extent="error", until_error=0.0027, darks=2
    )
    project = ProjectState(camera=PLAN.camera, plan=PLAN, recording=str(tmp_path / "s"))
    return replace(project, settings=settings.into(project))


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> Page:
    whole = AcquireUntil.goal.fget

    def quick(task: AcquireUntil) -> Goal:
        return replace(whole(task), **QUICK)  # type: ignore[arg-type, misc]

    monkeypatch.setattr(AcquireUntil, "goal", property(quick))
    made: Page = open_page("acquire", height=640)
    made.entered()
    qtbot.waitUntil(lambda: made.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    made.panel.recording.open()
    made.panel.setCurrentWidget(made.panel.record)
    return made


def press(page: Page, key: str, qtbot: QtBot) -> None:
    qtbot.mouseClick(page.panel.record.buttons[key], Qt.MouseButton.LeftButton)


def ended(page: Page, qtbot: QtBot) -> None:
    qtbot.waitUntil(lambda: not page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: page.record.folder.chosen is not None, timeout=GUARD_MS)


@pytest.mark.long
def test_from_start_to_the_page_fit(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    panel, folder = page.panel.record, tmp_path / "s"
    shown = panel.pictures
    assert shown.third.currentWidget() is shown.error and "estimated" in shown.third_title.text()
    press(page, "start", qtbot)  # connects first
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    recorder = page.record.recorder
    assert recorder is not None and not panel.until.isEnabled() and not panel.extent.isEnabled()
    press(page, "pause", qtbot)
    assert recorder.control.pausing and panel.buttons["pause"].text() == "Resume"
    press(page, "pause", qtbot)
    # stopped before the end: every frame is kept, and the run can continue
    qtbot.waitUntil(lambda: len(recorder.steps) == 1, timeout=GUARD_MS)
    press(page, "stop", qtbot)
    ended(page, qtbot)
    before = folder_state(str(folder))
    assert before.there.sum() >= 6 and not verify(folder).damaged
    assert panel.buttons["start"].text() == "Resume session" and "chosen positions" in panel.folder_words.text()
    press(page, "start", qtbot)
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    ended(page, qtbot)
    assert panel.status.text().startswith("The target error of H is reached")
    steps = page.record.recorder.steps
    curve, session = shown.error.curve, SessionFile.read(folder)
    assert curve.positions == tuple(one.positions for one in steps)
    assert curve.stated[-1] <= 0.27 == curve.wanted and shown.error.wanted.value() == pytest.approx(np.log10(0.27))
    x, y = shown.error.stated.getData()
    np.testing.assert_allclose(10**y, curve.stated)
    assert x.tolist() == list(curve.positions) and len(shown.error.aside.points()) == len(steps)
    assert shown.error.plot.getAxis("left").labelText == "error of H (%)"
    now = folder_state(str(folder))
    assert now.there is not None and now.complete and now.there[before.there].all() and verify(folder).ok
    assert now.there.sum() == curve.positions[-1] == sum(map(len, session.redo))
    # everything recorded becomes an H, and its fit is shown
    assert context.jobs.jobs()[0].result is None, "jobs are remembered: they must not hold a fit"
    sent: list[tuple[str, Any]] = []
    context.made.connect(lambda key, payload: sent.append((key, payload)))
    press(page, "fit", qtbot)
    qtbot.waitUntil(lambda: bool(sent), timeout=GUARD_MS)
    assert sent[0][0] == "h" and isinstance(sent[0][1], Fit) and context.state.psf == str(folder / "H.h5")
    with open_psf(folder / "H.h5") as H:
        assert set(map(tuple, np.argwhere(H.recorded > 0).tolist())) == set(sent[0][1].residuals)


def test_closing_in_the_midst_of_a_fit_loses_nothing(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    page.record.start()
    qtbot.waitUntil(lambda: page.record.recorder is not None, timeout=GUARD_MS)
    recorder = page.record.recorder
    qtbot.waitUntil(lambda: recorder.quality.state().done >= 6, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: "fitting" in page.panel.record.detail.text(), timeout=GUARD_MS)
    page.context.jobs.close()
    there = folder_state(str(tmp_path / "s")).there
    assert there.sum() >= 6 and not verify(tmp_path / "s").damaged


def test_a_whole_scan_is_not_gone_on_with_by_chance(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    few = replace(PLAN, period=(2, 2))
    record(tmp_path / "whole", few, rig_for(few), CAREFUL)
    context.project.update("folder", recording=str(tmp_path / "whole"), plan=few)
    page.record.start()
    qtbot.waitUntil(lambda: "every position" in page.panel.record.detail.text(), timeout=GUARD_MS)
    assert not page.record.recording and page.panel.record.status.text() == "Cannot start."


def test_the_choice_shows_what_it_needs_and_is_undone(page: Page, context: Context) -> None:
    panel = page.panel.record
    page.panel.recording.open()
    assert panel.until.isVisible()
    panel.extent.setCurrentIndex(0)
    assert AcquireSettings.of(context.state).extent == "whole" and not panel.until.isVisible()
    shown = panel.pictures
    assert shown.third.currentWidget() is shown.depth_sum and shown.third_title.text() == "Depth-plane sum"
    context.project.undo()
    assert panel.until.isVisible() and panel.extent.currentData() == "error"
    editor: Any = panel.until.editor("until_error")
    assert editor.text() == "0.27 %"
    editor.setText("0.01%")
    editor.textEdited.emit("0.01%")
    assert "target error of H" in panel.until.error and AcquireSettings.of(context.state).until_error == 0.0027
    editor.setText("0.5%")
    editor.textEdited.emit("0.5%")
    assert AcquireSettings.of(context.state).until_error == pytest.approx(0.005)
    assert shown.error.wanted.value() == pytest.approx(np.log10(0.5))
    panel.show_status("Stopped by a fault.", "long words on what happened " * 20, 0.5)
    assert page.minimumSizeHint().width() <= 1280 - 85, "long words never make the window wider"
