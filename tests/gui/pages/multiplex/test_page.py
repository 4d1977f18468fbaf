from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication, QFileDialog, QGraphicsView, QLabel, QTableWidget
from pytestqt.qtbot import QtBot

from lfcal.camera import preset
from lfcal.multiplex import (
    camera_chi2,
    cfa,
    colour_edges,
    demultiplex,
    demultiplex_generally,
    gain_map,
    mask,
    multiplex,
    paper,
    paper_figure,
)
from lfcal_gui.context import Context
from lfcal_gui.pages.multiplex import model
from lfcal_gui.pages.multiplex.model import MultiplexSettings
from lfcal_gui.pages.multiplex.model_compare import compare
from lfcal_gui.pages.multiplex.page import Page
from lfcal_gui.pages.multiplex.panel import NAME, NO_MODULATOR
from lfcal_gui.theme import DARK, LIGHT, apply_theme
from lfcal_gui.widgets.naming import controls
from lfcal_gui.widgets.picture import Picture
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Page:
    made: Page = open_page("multiplex", height=640)
    made.entered()
    settle(made, qtbot)
    return made


def settle(page: Page, qtbot: QtBot) -> None:
    idle(page.context.jobs, qtbot)


def offered(page: Page) -> tuple[str, ...]:
    others = page.panel.others
    return tuple(others.item(k).data(NAME) for k in range(others.count()))


def tick(page: Page, name: str) -> None:
    item = page.panel.others.item(offered(page).index(name))
    on = item.checkState() == Qt.CheckState.Checked
    item.setCheckState(Qt.CheckState.Unchecked if on else Qt.CheckState.Checked)


def browse(page: Page, key: str) -> None:
    editor = editor_of(page, key)
    assert editor.isEnabled()
    (action,) = editor.actions()
    action.trigger()


def editor_of(page: Page, key: str) -> Any:
    return next(form.editor(key) for form in page.forms if key in form.fields)


def choose(page: Page, key: str, value: str) -> None:
    editor = editor_of(page, key)
    editor.setCurrentIndex(editor.findData(value))


def type_in(page: Page, key: str, text: str) -> None:
    editor = editor_of(page, key)
    editor.setText(text)
    editor.textEdited.emit(text)
    editor.editingFinished.emit()


def cells(page: Page) -> dict[str, str]:
    table = page.panel.table
    found = {}
    for row in range(table.rowCount()):
        name, value = table.item(row, 0), table.item(row, 1)
        assert name is not None and value is not None and name.toolTip()
        found[name.text()] = value.text()
    return found


def test_the_first_modulator_is_drawn_in_turns(open_page: OpenPage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four pictures and a plot were created in the same turn, which took 70 ms."""
    page, left = open_page("multiplex", height=640), list[Any]()
    monkeypatch.setattr(page.context.jobs, "later", left.append)
    settings = MultiplexSettings()
    found = model.picture(settings), compare(settings, preset("bench").sensor, "bench")
    page._computed(found)
    made = []
    for step in left:
        before = len(page.panel.findChildren(QGraphicsView))
        step()
        made.append(len(page.panel.findChildren(QGraphicsView)) - before)
    assert max(made) == 1 and sum(made) == 5
    assert page.panel.table.rowCount() == len(found[1].rows)


def test_the_modulator_is_drawn_with_its_numbers(page: Page, context: Context, qtbot: QtBot) -> None:
    assert page.body.minimumSizeHint().width() <= 1100 and page.minimumSizeHint().height() <= 640
    assert cells(page)["Transmission τ"] == "0.5833" and cells(page)["Rank"] == "3 of 3"
    np.testing.assert_array_equal(page.panel.views[2].values, cfa("CYMG").spatial)
    np.testing.assert_array_equal(page.panel.views[3].values, cfa("CYMG").plenoptic)
    assert page.panel.views[0].shot.coloured
    type_in(page, "size", "5")
    choose(page, "family", "mask")
    settle(page, qtbot)
    assert cells(page)["Samples N"] == "25" and not page.panel.views[0].shot.coloured
    assert page.panel.views[0].values is not None and page.panel.views[0].values.shape == (5, 5)
    assert "real part" in page.panel.titles[2].text() and "over pinhole" in page.panel.curve_title.text()
    settings = MultiplexSettings(family="both", mask="lenslet", size=4, right="truth")
    context.project.update("all", settings=settings.into(context.state))
    settle(page, qtbot)
    size: Any = page.panel.form.editor("size")
    assert size.text() == "4" and offered(page) == ("pinhole", "lenslet", "MURA", "sum_of_sinusoids")
    assert page.panel.pictures.right.currentData() == "truth"
    assert "No gains" in page.panel.curve_hint.text() and cells(page)["Rank"] == "16 of 48"
    type_in(page, "size", "31")
    settle(page, qtbot)
    assert "reduce Size" in page.panel.curve_hint.text() and page.panel.views[2].values is None
    assert page.panel.views[2].blank.isVisible() and page.panel.views[2].blank.text() == NO_MODULATOR


def test_gain_curves_follow_ticks_and_camera(page: Page, context: Context, qtbot: QtBot, qapp: QApplication) -> None:
    assert set(page.panel.curve._curves) == {"CYMG", "Sony", "RGBW", "CMYW"}
    tick(page, "X-Trans")
    settle(page, qtbot)
    assert "X-Trans" in page.panel.curve._curves and "lenslet" in page.settings.compared
    context.project.undo()
    settle(page, qtbot)
    assert "X-Trans" not in page.panel.curve._curves and "X-Trans" not in page.panel.ticked()
    camera = context.state.camera
    sensor = replace(camera.sensor, full_well_e=1e4, read_noise_e=10.0, bit_depth=16)
    context.project.update("sensor", camera=replace(camera, sensor=sensor))
    settle(page, qtbot)
    assert page.panel.marker.value() == pytest.approx(2, abs=1e-4) and "Gain at χ² = 100" in cells(page)
    type_in(page, "gain", "10")
    settle(page, qtbot)
    assert page.panel.marker.value() == pytest.approx(1, abs=1e-4)
    for theme in (DARK, LIGHT):
        apply_theme(qapp, theme)
        page.take_theme()
        assert page.panel.marker.pen.color().name() == theme.text


def test_reconstructions_equal_the_library_s_and_zoom_together(page: Page, qtbot: QtBot) -> None:
    shown = page.panel.pictures
    page.panel.tabs.setCurrentIndex(1)
    settle(page, qtbot)
    truth = colour_edges((240, 240))
    frame = multiplex(truth, cfa("CYMG"))
    shown.sample.setCurrentIndex(shown.sample.findData(1))
    chosen = page.settings.filter
    spatial, fourier = (demultiplex(frame, cfa("CYMG"), route=r, filter=chosen)[1] for r in ("spatial", "fourier"))
    for view, expected in zip(shown.views, (spatial, fourier, spatial - fourier, frame), strict=True):
        assert view.values is not None
        np.testing.assert_allclose(view.values, expected, atol=1e-9)
    assert "% rms" in shown.heads[0].text() and "Fourier" in shown.heads[1].text()
    shown.right.setCurrentIndex(1)
    np.testing.assert_array_equal(shown.views[2].values, truth[1])
    assert not shown.views[2].shot.signed and page.settings.right == "truth"
    assert shown.views[2].shot.name == "truth"
    box = shown.views[1].box
    box.setRange(xRange=(50, 90), yRange=(60, 100), padding=0)
    box.sigRangeChangedManually.emit([True, True])
    for view in shown.views:
        (left, right), (top, bottom) = view.box.viewRange()
        assert (left + right) / 2 == pytest.approx(70) and (top + bottom) / 2 == pytest.approx(80)
    shown.views[0].hovered.emit(3, 4, 0.0)
    assert f"{spatial[3, 4]:.4g}" in shown.readout.text()


def test_an_opened_frame_is_demultiplexed_as_a_job(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    shown = page.panel.pictures
    type_in(page, "size", "5")
    choose(page, "mask", "lenslet")
    choose(page, "family", "mask")
    page.panel.tabs.setCurrentIndex(1)
    choose(page, "scene", "image")
    settle(page, qtbot)
    assert "Open an image" in shown.status.text() and shown.views[0].values is None
    frame = np.random.default_rng(0).random((40, 50)).astype(np.float32)
    np.save(tmp_path / "frame.npy", frame)
    assert page.accept_drop([str(tmp_path / "frame.npy")]) and not page.accept_drop([str(tmp_path)])
    settle(page, qtbot)
    assert page.settings.image.endswith("frame.npy") and context.jobs.jobs()[0].page == "multiplex"
    assert shown.views[0].values is not None and shown.sample.currentText() == "view 2,2"
    np.testing.assert_allclose(shown.views[0].values, demultiplex(frame, mask("lenslet", 5))[12], rtol=1e-5)
    bad = tmp_path / "bad.tif"
    bad.write_bytes(b"nothing")
    page.open_image(str(bad))
    settle(page, qtbot)
    assert "bad.tif" in page.notice.label.text() and page.notice.isVisible()
    assert page.settings.image.endswith("frame.npy") and shown.views[0].values is not None, "the good one stays"


def test_figures_of_the_paper(page: Page, qtbot: QtBot, qapp: QApplication, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("SIDE", 5), ("UPSAMPLED", 3)):
        monkeypatch.setattr(paper, name, value)
    page.panel.tabs.setCurrentIndex(2)
    settle(page, qtbot)
    shown = page.panel.figures
    wanted = paper_figure(7)
    assert "PG Dragonfly" in shown.status.text() and shown.numbers[5].text() == wanted.panels[5].numbers
    drawn = [QLabel.text(shown.numbers[k]) for k in (0, 7)]
    assert "−" in drawn[0] and not any(re.search(r"\s-\d", words) for words in drawn)
    np.testing.assert_array_equal(shown.views[5].values, wanted.panels[5].image)
    assert not any(card.isHidden() for card in shown.cards)
    shown.own.click()
    settle(page, qtbot)
    assert page.context.state.camera.name in shown.status.text() and page.settings.own_camera
    for number, visible in ((5, 6), (3, 6)):
        shown.figure.setCurrentIndex(shown.figure.findData(str(number)))
        settle(page, qtbot)
        assert sum(not card.isHidden() for card in shown.cards) == visible and not shown.own.isEnabled()
        assert all(head.text()[:1] == head.text()[:1].upper() for head in shown.heads[:visible])
    shown.figure.setCurrentIndex(shown.figure.findData("6"))
    settle(page, qtbot)
    assert shown.stack.currentIndex() == 1 and "MURA" in shown.curves[1]._curves
    assert [head.text() for head in shown.curve_heads] == [
        "Colour filter arrays compared with Bayer",
        "Light-field modulators of 5 × 5 compared with a pinhole",
    ]
    assert shown.markers[0].value() == pytest.approx(np.log10(camera_chi2(page.context.state.camera.sensor)))
    for theme in (DARK, LIGHT):
        apply_theme(qapp, theme)
        page.take_theme()
        assert shown.markers[0].pen.color().name() == theme.text
    page.context.project.undo()
    settle(page, qtbot)
    assert shown.figure.currentData() == "7", "one step back from all choices of a figure"


def test_map_of_the_samples_gains(page: Page, qtbot: QtBot) -> None:
    shown = page.panel.figures
    page.panel.tabs.setCurrentIndex(2)
    shown.figure.setCurrentIndex(shown.figure.findData("0"))
    settle(page, qtbot)
    wanted = gain_map(cfa("CYMG"), cfa("Bayer"), 10.0 ** np.arange(-4, 5)).gains
    np.testing.assert_allclose(shown.map.values, wanted, rtol=1e-6)
    assert shown.stack.currentIndex() == 2 and "0: R, 1: G, 2: B" in shown.map_words.text()
    choose(page, "reference_cfa", "CYMG")
    settle(page, qtbot)
    np.testing.assert_allclose(shown.map.values, 0, atol=1e-9)
    choose(page, "cfa", "typed")
    type_in(page, "pattern", "RG/RG")
    settle(page, qtbot)
    assert np.isnan(shown.map.values[2]).all() and np.isfinite(shown.map.values[0]).all()


def test_search_and_use(page: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page.panel.tabs.setCurrentIndex(3)
    search = page.panel.search
    assert not search.buttons["Use"].isEnabled()
    search.buttons["Search"].click()
    settle(page, qtbot)
    design = search.found.design
    assert design.exhaustive and "best of all" in search.found.words[2][1] and search.view.shot.coloured
    search.buttons["Use"].click()
    settle(page, qtbot)
    np.testing.assert_array_equal(page.settings.modulator().matrix, design.modulator.matrix)
    sought: Any = search.form.editor("sought")
    sought.setCurrentIndex(sought.findData("mask"))
    size: Any = search.form.editor("search_size")
    size.setText("3")
    size.textEdited.emit("3")
    assert search.form.editor("levels").isEnabled() and not search.form.editor("kinds").isEnabled()
    search.buttons["Search"].click()
    settle(page, qtbot)
    assert search.found.design.modulator.views == (3, 3)
    target = str(tmp_path / "mask.json")
    monkeypatch.setattr("lfcal_gui.saving.QFileDialog.getSaveFileName", lambda *_: (target, ""))
    search.buttons["Use"].click()
    settle(page, qtbot)
    assert page.settings.written == target and cells(page)["Samples N"] == "9"
    assert page.settings.modulator().views == (3, 3), "it is a light field still"
    size.editingFinished.emit()
    size.setText("40")
    size.textEdited.emit("40")
    assert "Mask side: expected 2 to 13" in search.form.error and page.settings.search_size == 3


def test_a_coloured_scene_of_a_project_is_known_by_what_is_made_of_it(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "colours.png"), np.full((24, 30, 3), 300, np.uint16))
    settings = MultiplexSettings(scene="image", image=str(tmp_path / "colours.png"), weighted=True)
    page.context.project.update("opened", settings=settings.into(page.context.state))
    page.panel.tabs.setCurrentIndex(1)
    settle(page, qtbot)
    assert page.found.spatial.name == "Spatial, cubic"
    assert editor_of(page, "filter").isEnabled() and not editor_of(page, "weighted").isEnabled()


def test_the_general_route_of_a_file(page: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = page.panel.pictures
    assert not editor_of(page, "dead").isEnabled() and not editor_of(page, "spacing").isEnabled()
    rng = np.random.default_rng(0)
    shares, frame, dead = rng.random((2, 30, 40)), rng.random((30, 40)).astype(np.float32), np.zeros((30, 40), np.uint8)
    dead[4, 5] = 1
    for name, array in (("shares", shares), ("frame", frame), ("dead", dead)):
        np.save(tmp_path / f"{name}.npy", array)
    page.open_image(str(tmp_path / "frame.npy"))
    settle(page, qtbot)
    choose(page, "route", "general")
    for key, name in (("dead", "dead"), ("transmissions", "shares")):
        picked = (str(tmp_path / f"{name}.npy"), "")
        monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_, picked=picked: picked)
        browse(page, key)
    type_in(page, "spacing", "2")
    settle(page, qtbot)
    wanted = demultiplex_generally(frame, shares, 2.0, weights=dead == 0).samples
    assert shown.names == ("sample 0", "sample 1") and editor_of(page, "dead").text().endswith("dead.npy")
    np.testing.assert_allclose(shown.views[0].values, wanted[1], atol=1e-6)
    assert shown.views[1].values is None and shown.heads[1].text() == "No second route"
    assert "iterations" in shown.status.text() and not editor_of(page, "filter").isEnabled()
    type_in(page, "dead", str(tmp_path / "none.npy"))
    settle(page, qtbot)
    assert "none.npy" in shown.status.text() and "<br" not in shown.status.text() and shown.views[0].values is None
    type_in(page, "dead", "")
    type_in(page, "spacing", "0.1")
    settle(page, qtbot)
    assert "node spacing" in page.panel.form.error and page.settings.spacing == 2
    assert shown.views[0].values is not None


def test_a_mask_on_the_lattice_of_the_project_s_camera(page: Page, context: Context, qtbot: QtBot) -> None:
    shown = page.panel.pictures
    choose(page, "family", "mask")
    type_in(page, "size", "5")
    page.panel.tabs.setCurrentIndex(1)
    choose(page, "route", "lattice")
    settle(page, qtbot)
    assert f"lattice of {context.state.camera.name}" in shown.status.text() and page.found is not None
    assert page.found.fourier is not None and shown.views[1].values is not None
    before, camera = page.found.step, context.state.camera
    lattice = replace(camera.lattice, pitch_um=1.3 * camera.lattice.pitch_um, clear_um=None)
    context.project.update("lattice", camera=replace(camera, lattice=lattice))
    settle(page, qtbot)
    assert page.found.step == pytest.approx(1.3 * before)
    choose(page, "family", "cfa")
    settle(page, qtbot)
    assert "a square super-pixel that samples only views" in shown.status.text() and shown.views[0].values is None


def test_no_numbers_of_the_settings_before_stand_beside_others(page: Page, qtbot: QtBot) -> None:
    shown = page.panel.pictures
    page.panel.tabs.setCurrentIndex(1)
    settle(page, qtbot)
    assert "% rms" in shown.heads[0].text()
    choose(page, "filter", "nearest")
    assert page.found is None and "rms" not in shown.heads[0].text() + shown.heads[1].text()
    shown.sample.setCurrentIndex(1)
    tick(page, "X-Trans")
    assert "previous settings" in shown.status.text() and not page.panel.table.isEnabled()
    settle(page, qtbot)
    assert "nearest: error" in shown.heads[0].text() and page.panel.table.isEnabled()
    assert page.panel.titles[0].text() == "Pattern of CYMG"


def test_nine_controls_are_seen_first_and_pictures_are_made_when_they_are_shown(page: Page, qtbot: QtBot) -> None:
    made = {tab: len(page.panel.tabs.widget(tab).findChildren(Picture)) for tab in range(4)}
    assert made == {0: 4, 1: 0, 2: 0, 3: 0}
    for tab, count in ((1, 4), (2, None), (3, 1), (0, 4)):
        page.panel.tabs.setCurrentIndex(tab)
        settle(page, qtbot)
        pictures = page.panel.tabs.widget(tab).findChildren(Picture)
        assert count is None or (len(pictures) == count and all(one.isVisible() for one in pictures))
        shown = (QGraphicsView, QTableWidget)
        seen = [one for one in controls(page) if one.isVisible() and not isinstance(one, shown)]
        assert editor_of(page, "family") in seen and len(seen) <= 9, [one.accessibleName() for one in seen]


def test_live_frames_are_demultiplexed_by_the_latest_settings(page: Page, context: Context, qtbot: QtBot) -> None:
    page.panel.tabs.setCurrentIndex(1)
    choose(page, "scene", "live")
    settle(page, qtbot)
    assert "connect the camera in Record > Rig" in page.panel.pictures.status.text()
    truth = colour_edges((60, 80))
    sensor = context.state.camera.sensor
    frame = (500 * multiplex(truth, cfa("CYMG"))[3:, 1:] + sensor.black_level).astype(np.uint16)
    context.frame_seen.emit(frame, (3, 1))
    settle(page, qtbot)
    assert page.found is not None and "live frame" in page.panel.pictures.status.text()
    part = frame[1:, 1:].astype(np.float32) - np.float32(sensor.black_level)
    wanted = demultiplex(part, cfa("CYMG"), filter=page.settings.filter)
    np.testing.assert_allclose(page.found.spatial.samples, wanted, atol=1e-3)
    inner = np.s_[:, 8:40, 8:60]
    assert np.abs(page.found.spatial.samples / 500 - truth[:, 4:, 2:][:, :56, :78])[inner].mean() < 0.05
    context.frame_seen.emit(frame * 2, (3, 1))
    choose(page, "filter", "nearest")
    settle(page, qtbot)
    assert float(page.found.spatial.samples.max()) > 1.5 * float(wanted.max())
    assert page.found.spatial.name == "Spatial, nearest"


@pytest.mark.long
def test_rewritten_files_are_read_again(
    page: Page, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, dead, highest, shown = tmp_path / "frame.npy", tmp_path / "dead.npy", list[float](), list[str]()
    for light in (1.0, 7.0):
        np.save(path, np.full((40, 50), light, np.float32))
        page.open_image(str(path))
        settle(page, qtbot)
        highest.append(float(page.found.spatial.samples.max()))
    assert highest[1] == pytest.approx(7 * highest[0])
    type_in(page, "dead", str(dead))
    settle(page, qtbot)
    assert "dead.npy" in page.panel.pictures.status.text() and page.found is None
    np.save(dead, np.zeros((40, 50), np.uint8))
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (str(dead), ""))
    browse(page, "dead")
    settle(page, qtbot)
    assert page.found is not None and page.panel.pictures.views[0].values is not None
    monkeypatch.setattr("lfcal_gui.saving.QFileDialog.getSaveFileName", lambda *_: (str(tmp_path / "mask.json"), ""))
    choose(page, "sought", "mask")
    type_in(page, "search_size", "3")
    for levels, light_share in (("2", "0.6"), ("5", "0.2")):
        type_in(page, "levels", levels)
        type_in(page, "least_light", light_share)
        for name in ("Search", "Use"):
            page.panel.search.buttons[name].click()
            settle(page, qtbot)
        shown.append(cells(page)["Transmission τ"])
    assert shown[0] != shown[1], "a design written over another"


@pytest.mark.long
def test_a_refused_value_is_not_replaced_by_the_one_before(page: Page, context: Context, qtbot: QtBot) -> None:
    search, form = page.panel.search, page.panel.form
    type_in(page, "kinds", "0")
    search.buttons["Search"].click()
    assert "Filter kinds: expected 1 to 6, got 0" in search.status.text() and not context.jobs.jobs()
    assert search.status.property("role") == "error"
    choose(page, "sought", "mask")
    assert not search.form.error, "it is no wish of masks"
    for least, role in (("0", "hint"), ("0.99", "error")):
        type_in(page, "least_light", least)
        search.buttons["Search"].click()
        settle(page, qtbot)
        assert search.status.property("role") == role and (search.found is None) == (role == "error")
    assert "allow less or more light" in search.status.text()
    choose(page, "family", "mask")
    for key, text, reason in (("size", "9", "odd prime"), ("gain", "0", "amplifier gain"), ("gain", "2", "odd prime")):
        type_in(page, key, text)
        assert reason in form.error, "the reason of the field that was touched last"
    choose(page, "family", "cfa")
    editor: Any = form.editor("size")
    assert not form.error and editor.text() == "11" and not editor.property("invalid")


def test_a_design_goes_with_its_wishes_and_takes_the_suffix_of_the_chosen_kind(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page.panel.tabs.setCurrentIndex(3)
    search = page.panel.search

    def searched() -> None:
        search.buttons["Search"].click()
        settle(page, qtbot)
        assert search.found is not None

    searched()
    answer = (str(tmp_path / "design"), "Transmissions only (*.npy)")
    monkeypatch.setattr("lfcal_gui.saving.QFileDialog.getSaveFileName", lambda *_: answer)
    search.buttons["Save …"].click()
    assert [path.name for path in tmp_path.glob("design*")] == ["design.npy"]
    choose(page, "cfa", "Bayer")
    assert search.found is not None, "the page's modulator is none of its wishes"
    for key, text, back in (("kinds", "2", "4"), ("gain", "4", "1")):
        type_in(page, key, text)
        assert search.found is None and not search.buttons["Use"].isEnabled() and search.view.values is None
        type_in(page, key, back)
        searched()
    choose(page, "sought", "mask")
    type_in(page, "search_size", "13")
    search.buttons["Search"].click()
    type_in(page, "search_size", "3")
    assert context.jobs.jobs()[0].state.value == "stopped" and "searching" not in search.status.text()
    searched()
    assert search.found.design.modulator.side == (3, 3)
