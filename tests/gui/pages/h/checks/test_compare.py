"""Another H to compare with: chosen, compared, looked at; nothing of an earlier pair stays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import QLocale
from pytestqt.qtbot import QtBot

from lfcal.base import Work, drain
from lfcal.judge import pair
from lfcal.psf import PSFMatrix, save
from lfcal_gui.models import ProjectState, both_at, plane_of_row, stamp_of
from lfcal_gui.pages.h.model_checks import InspectionRequest, InspectionRun, QualitySettings, asked_of, iter_judge
from lfcal_gui.pages.h.page import Page
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle
from tests.judge.test_comparison import moved

DEPTHS = (-2000.0, -1000.0)


def written(path: Path, values: np.ndarray, depths: tuple[float, ...] = DEPTHS) -> str:
    save(PSFMatrix(values.astype(np.float32), depths=depths), path)
    return str(path)


METRICS_ALONE = QualitySettings(seconds=0)
"""No time for the camera."""


def one_far_off() -> np.ndarray:
    """Return an H in which one position is far off."""
    values = 2 * moved((0.3, -0.2))
    values[1, 2, 3] = np.roll(values[1, 2, 3], 5, 0)
    return values


@pytest.fixture
def state(tmp_path: Path) -> ProjectState:
    state = replace(ProjectState(), psf=written(tmp_path / "H.h5", one_far_off()))
    return replace(state, settings=METRICS_ALONE.into(state))


@pytest.fixture(scope="module")
def judged_once(tmp_path_factory: pytest.TempPathFactory) -> InspectionRun:
    """Return what this H is found to be."""
    stamp, kept = stamp_of(written(tmp_path_factory.mktemp("judged") / "H.h5", one_far_off())), InspectionRun()
    assert stamp is not None
    drain(iter_judge(asked_of(stamp, METRICS_ALONE, None), kept))
    return kept


@pytest.fixture
def page(
    open_page: OpenPage, state: ProjectState, judged_once: InspectionRun, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> Page:
    first = stamp_of(state.psf)

    def at_once(asked: InspectionRequest, kept: InspectionRun) -> Work[None]:
        if asked.stamp == first and not asked.seconds:
            kept.report, kept.depths, kept.inspection = judged_once.report, judged_once.depths, judged_once.inspection
        else:
            yield from iter_judge(asked, kept)

    monkeypatch.setattr("lfcal_gui.pages.h.model_checks.iter_judge", at_once)
    made: Page = open_page("h")
    idle(made.context.jobs, qtbot)
    made.look_into("compare")
    return made


def place_of(page: Page) -> tuple[int, int, int]:
    return page.intent.z, page.intent.y, page.intent.x


def compared(page: Page, qtbot: QtBot, path: str) -> None:
    page.comparing.choose(path)
    idle(page.context.jobs, qtbot)


def test_a_second_h_is_chosen_and_compared(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    panel, comparing = page.comparing.view, page.comparing
    assert "Choose a second H" in panel.message.text() and not panel.compare_button.isEnabled()
    compared(page, qtbot, written(tmp_path / "earlier.h5", moved()))
    assert comparing.found is not None and panel.stack.currentIndex() == 1
    assert page.context.state.reference.endswith("earlier.h5") and "earlier.h5" in panel.second.text()
    assert "%" in panel.verdict.text() and "24 positions of 2 planes" in panel.notes.text()
    assert panel.table.rowCount() == 3, "all, and each plane"
    cells = [panel.table.item(1, k).text() for k in range(6)]
    drawn = panel.table.itemDelegate().displayText(cells[0], QLocale())
    assert drawn == "0: −2 mm" and "0: -2 mm" in panel.table.text(), "drawn with a minus sign, copied with a hyphen"
    assert cells[4] == "+0.300, -0.200"
    # where they differ most is shown first, both at the light of the plane of H
    assert panel.worst.itemData(0) == (1, 2, 3) and place_of(page) == (1, 2, 3)
    page.panel.view_buttons["Difference"].click()
    first, apart = (view.values for view in (page.panel.main_view, page.panel.linked_view))
    assert first is not None and apart is not None and page.reference_plane is not None
    np.testing.assert_array_equal(first, page.plane.values[2, 3])
    scaled = page.reference_plane.scale * page.reference_plane.values[2, 3]
    np.testing.assert_allclose(apart, first - scaled, atol=1e-4)
    assert page.panel.map_title.text().startswith("Difference")
    assert page.panel.rows["compare"].state.text().startswith("difference ")


def test_positions_and_planes_are_chosen_in_map_and_table(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    compared(page, qtbot, written(tmp_path / "earlier.h5", moved()))
    panel = page.comparing.view
    assert page.comparing.found is not None
    assert [plane_of_row(page.comparing.found, row) for row in range(3)] == [None, 0, 1]
    panel.table.selectRow(1)
    idle(page.context.jobs, qtbot)
    assert place_of(page) == (0, 2, 3)
    page.panel.map.chosen.emit(1, 0)
    assert place_of(page) == (0, 1, 0)
    panel.worst.activated.emit(0)
    idle(page.context.jobs, qtbot)
    assert place_of(page) == (1, 2, 3)


def test_what_cannot_be_compared_is_named_with_a_remedy(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    panel = page.comparing.view
    for name, values, depths, remedy in (
        ("other.h5", moved()[:, :2], DEPTHS, "; compare H with the same array and sampling"),
        ("far.h5", moved(), (-9000.0, -5000.0), "; compare the planes by their numbers"),
    ):
        compared(page, qtbot, written(tmp_path / name, values, depths))
        words = panel.message.text()
        assert page.comparing.found is None and f"{name} (the second H)" in words and words.endswith(remedy)
    assert "expected at least one of -2 mm" in panel.message.text()
    panel.pairing.setCurrentIndex(1)
    assert QualitySettings.of(page.context.state).by_number
    page.comparing.begin()
    idle(page.context.jobs, qtbot)
    assert page.comparing.found is not None and "differ in depth" in panel.notes.text()
    (tmp_path / "bad.h5").write_bytes(b"no hdf5")
    compared(page, qtbot, str(tmp_path / "bad.h5"))
    assert "HDF5" in panel.message.text() and page.context.state.reference.endswith("far.h5"), "the good one stays"
    assert "bad.h5" in panel.message.text() and "The second H is far.h5 as before" in panel.message.text()


@pytest.mark.long
def test_blink_shows_both_and_another_file_ends_the_comparison(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    compared(page, qtbot, written(tmp_path / "earlier.h5", moved()))
    idle(page.context.jobs, qtbot)
    comparing, shown, main = page.comparing, page.comparing.shown, page.panel.main_view
    before = main.values
    shown.setCurrentIndex(shown.findData("blink"))
    qtbot.waitUntil(lambda: main.shot.caption.startswith("Other H: H"), timeout=GUARD_MS)
    assert main.values is not before
    qtbot.waitUntil(lambda: main.shot.caption.startswith("H, "), timeout=GUARD_MS)
    shown.setCurrentIndex(shown.findData("reference"))
    assert main.shot.caption.startswith("Other H") and not comparing.blinking.isActive()
    page.context.project.update("open", psf=written(tmp_path / "new.h5", moved((0.1, 0.0))))
    assert comparing.found is None and comparing.view.stack.currentIndex() == 0
    idle(page.context.jobs, qtbot)
    comparing.begin()
    idle(page.context.jobs, qtbot)
    assert comparing.found is not None
    page.context.project.undo()
    assert comparing.found is None


def test_where_nothing_was_compared_no_number_stands(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    dark = moved()
    dark[1] = 0
    dark[0, 1, 2] = 0
    compared(page, qtbot, written(tmp_path / "dark.h5", dark))
    panel = page.comparing.view
    cells = [panel.table.item(2, k).text() for k in range(1, 6)]
    assert cells == ["–"] * 5 and "Plane 1 of the first H: not compared" in panel.notes.text()
    panel.table.selectRow(1)
    idle(page.context.jobs, qtbot)
    shown = page.panel.map
    assert [[1, 2]] in [marks.points.tolist() for marks in shown.overlays], "crossed out"
    panel.table.selectRow(2)
    idle(page.context.jobs, qtbot)
    assert shown.values is not None and np.isnan(shown.values).all() and page.panel.map_range.text() == "%"
    assert place_of(page)[0] == 1, "both patterns are there to be seen"
    compared(page, qtbot, written(tmp_path / "none.h5", np.zeros_like(dark)))
    assert panel.verdict.text().startswith("Nothing could be compared") and not panel.worst.isEnabled()
    compared(page, qtbot, written(tmp_path / "earlier.h5", moved()))
    assert np.isfinite(shown.values).any() and panel.worst.isEnabled()


def test_stopping_says_so(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    page.context.project.update("second H", reference=written(tmp_path / "earlier.h5", moved()))
    page.comparing.begin()
    assert page.stop_button.isEnabled()
    page.stop()
    idle(page.context.jobs, qtbot)
    assert page.comparing.found is None and page.comparing.view.message.text().startswith("Stopped")
    assert not page.stop_button.isEnabled() and page.comparing.view.compare_button.isEnabled()


def test_a_position_of_both_is_at_the_light_of_the_first() -> None:
    both = both_at(pair(3 * moved(), moved()), (1, 0, 2))
    np.testing.assert_allclose(both.first, both.second)
    assert both.levels[0] == 0 and np.abs(both.difference).max() < 1e-12


def test_the_comparison_is_written_as_a_page(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    panel = page.comparing.view
    assert not panel.report_button.isEnabled()
    compared(page, qtbot, written(tmp_path / "earlier.h5", moved()))
    assert panel.report_button.isEnabled()
    page.comparing.write_report(str(tmp_path / "report"))
    idle(page.context.jobs, qtbot)
    assert {one.name for one in (tmp_path / "report").iterdir()} == {
        "index.html",
        "compare.json",
        "patterns.png",
        "positions.png",
    }
    assert "earlier.h5" in (tmp_path / "report" / "index.html").read_text()
