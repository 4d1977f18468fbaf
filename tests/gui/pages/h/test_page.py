"""The place H: patterns of H and HT, the sum, another H, apertures, the verdict."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QApplication, QLabel
from pytestqt.qtbot import QtBot

from lfcal.camera import preset
from lfcal.psf import PSFMatrix, export, save
from lfcal.psf.aperture import fit_aperture
from lfcal.psf.aperture.shape import blade_radius
from lfcal_gui.context import Context
from lfcal_gui.models import COLOUR_MAPS, OpeningSettings, ProjectState, Verdict, stamp_of, with_verdict
from lfcal_gui.widgets.plots import LINES
from lfcal_gui.widgets.strip import EXPECTED, FITTED, PlaneTile
from lfcal_gui.window import MainWindow
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle
from tests.psf.test_mat_import import as_meant, save_v73


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, str, str]:
    """Write a signed H in counts, a simulated reference of it, and another H without one."""
    rng = np.random.default_rng(1)
    values = rng.random((2, 3, 4, 5, 7)).astype(np.float32) * 900 - 30
    save(PSFMatrix(values, depths=[-10, 10]), tmp_path / "H.h5")
    save(PSFMatrix(values + 9, depths=[-10, 10], provenance={"simulated": {}}), tmp_path / "R.h5")
    save(PSFMatrix(values[:1, :2], depths=[-10]), tmp_path / "other.h5")
    return tuple(str(tmp_path / name) for name in ("H.h5", "R.h5", "other.h5"))  # type: ignore[return-value]


@pytest.fixture
def page(open_page: OpenPage, context: Context, qtbot: QtBot, files: tuple[str, str, str]) -> Any:
    context.project.update("open", psf=files[0], reference=files[1])
    made = open_page("h")
    idle(context.jobs, qtbot)
    return made


def test_what_was_sent_is_shown_later(page: Any, context: Context, qtbot: QtBot, files: tuple[str, str, str]) -> None:
    context.project.update("neither", psf="", reference="")
    assert page.panel.readout.isHidden() and page.panel.view_buttons["Difference"].isHidden(), "there is no H"
    page.receive({"place": (0, 2, 1), "view": "difference"})
    context.project.update("H alone", psf=files[0])
    idle(context.jobs, qtbot)
    assert page.intent.view == "both"
    context.project.update("both", reference=files[1])
    idle(context.jobs, qtbot)
    assert (page.intent.z, page.intent.y, page.intent.x, page.intent.view) == (0, 2, 1, "difference")


def test_the_readout_follows_the_picture(page: Any, context: Context, qtbot: QtBot) -> None:
    panel = page.panel
    panel.main_view.hovered.emit(2, 3, 0.0)
    for change in ({"transposed": True}, {"x": 0}, {"transposed": False}, {"show": "reference"}, {"z": 0}):
        page.set_intent(**change)
        idle(context.jobs, qtbot)
        unit = "of the light" if page.intent.show == "reference" else "counts"
        assert panel.readout.text() == f"t 2, s 3: {panel.main_view.values[2, 3]:.5g} {unit}", change
    assert panel.main_view.quantity == "fraction of the light"
    page.set_intent(show="measured")
    assert panel.main_view.quantity == "intensity (counts)" and not panel.readout.isHidden()
    page.set_intent(view="difference")
    idle(context.jobs, qtbot)
    panel.readout.resize(240, 20)
    assert panel.readout.text().endswith("relative to the other H")
    shown = f"t 2, s 3: Δ {panel.linked_view.values[2, 3]:+.4g} counts"
    assert QLabel.text(panel.readout) == shown.replace("-", "−")
    low, high = panel.linked_view.levels
    assert low == -high and panel.linked_view.shot.caption.endswith(f"the other H, ±{high:.3g} counts")
    assert "±" not in panel.main_view.shot.caption
    panel.main_view.hovered.emit(-1, -1, float("nan"))
    assert panel.readout.text().startswith("Point at")


def test_the_pointer_may_leave_a_picture_while_it_is_drawn(page: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    view = page.panel.main_view
    view.hovered.emit(2, 3, 0.0)
    draw = view.set_shot

    def draw_and_leave(shot: Any) -> None:
        draw(shot)
        view.hovered.emit(-1, -1, float("nan"))

    monkeypatch.setattr(view, "set_shot", draw_and_leave)
    page.set_intent(view="sum")
    assert page.intent.pixel is None and page.panel.readout.text().startswith("Point at")
    assert view.shot.cross is None


@pytest.mark.parametrize("show", ["measured", "reference"])
def test_h_and_ht_share_one_scale_whatever_is_chosen(page: Any, show: str) -> None:
    panel = page.panel
    page.look_into("compare")
    page.comparing.shown.setCurrentIndex(page.comparing.shown.findData(show))
    assert page.intent.show == show
    before = panel.main_view.levels
    for change in ({"y": 0, "x": 1}, {"transposed": True}):
        page.set_intent(**change)
        assert panel.main_view.levels == panel.linked_view.levels == before
        assert before[0] <= panel.main_view.values.min() and panel.main_view.values.max() <= before[1]
    panel.display_asked.emit({"colour_map": COLOUR_MAPS[2]})
    panel.toggle_scale("log")
    assert panel.main_view.levels == before
    panel.own_scale.setChecked(True)
    assert panel.main_view.levels != before


def test_an_h_without_reference_shows_itself(page: Any, context: Context, qtbot: QtBot, files: Any) -> None:
    page.set_intent(view="difference")
    assert page.panel.linked_view.shot.signed and page.panel.view_buttons["Difference"].isVisible()
    context.project.update("open", psf=files[2])
    idle(context.jobs, qtbot)
    assert page.intent.view == "both" and not page.panel.view_buttons["Difference"].isVisible()
    assert not page.panel.linked_view.shot.signed and page.panel.main_view.shot.caption.startswith("H,")
    assert page.panel.place_label.text().startswith("Plane 0 (the only one)")


def test_h_or_ht_or_the_sum_takes_the_place_of_both(page: Any, qtbot: QtBot) -> None:
    panel, buttons = page.panel, page.panel.view_buttons
    drawn(page, qtbot)
    assert buttons["Both"].isChecked() and panel.linked_view.isVisible()
    buttons["HT"].click()
    assert page.intent.transposed and panel.main_view.isVisible() and not panel.linked_view.isVisible()
    np.testing.assert_array_equal(panel.main_view.values, page.matrix.T[page.intent.z, page.intent.y, page.intent.x])
    small = panel.sum_view.width()
    buttons["Sum"].click()
    QApplication.processEvents()
    assert not panel.main_view.isVisible() and panel.sum_view.isVisible() and panel.sum_view.width() > 1.5 * small
    buttons["H"].click()
    QApplication.processEvents()
    assert not page.intent.transposed and panel.main_view.isVisible() and panel.sum_view.width() <= small + 4
    assert [title for title, button in buttons.items() if button.isChecked()] == ["H"]


def test_no_outline_is_drawn_where_no_aperture_is_seen(page: Any, context: Context, qtbot: QtBot) -> None:
    drawn(page, qtbot)
    panel, cutout = page.panel, (61, 61)
    seen = fit_aperture(np.hypot(*np.mgrid[-30:31, -30:31]) < 18.3)
    unseen = fit_aperture(np.zeros(cutout))
    assert seen.seen and not unseen.seen and np.isnan(unseen.outline()).all()
    with qtbot.captureExceptions() as raised:
        for aperture in (seen, unseen, seen):
            panel.show_aperture(aperture, None, cutout)
            panel.sum_view.grab()
            assert len(panel.sum_view.overlays[0].points) == (360 if aperture.seen else 0)
    assert not raised


def drawn(page: Any, qtbot: QtBot) -> None:
    """Wait until all that is known of H is on the page."""
    qtbot.waitUntil(lambda: page.shown and not page.context.jobs.busy, timeout=GUARD_MS)


def test_expected_apertures_are_drawn(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    camera = preset("bench")
    depths = [-26_000.0, -20_000.0]
    values = np.zeros((2, 2, 2, 55, 55), np.float32)
    y, x = np.mgrid[-27:28, -27:28]
    for z, apothem in enumerate((18.0, 13.0)):
        inside = blade_radius(np.arctan2(y, x), 7, 0.2, apothem) - np.hypot(y, x)
        values[z] = 1000 * np.clip(inside / 2 + 0.5, 0, 1)
    save(PSFMatrix(values, depths=depths, camera=camera), tmp_path / "H.h5")
    context.project.update("open", psf=str(tmp_path / "H.h5"))
    page = open_page("h")
    drawn(page, qtbot)
    tiles = page.panel.strip.tiles
    assert [tile.depth_um for tile in tiles] == depths
    for z, tile in enumerate(tiles):
        assert tile.image is not None and tile.fitted is not None and tile.expected is not None
        assert round(tile.fitted.apothem_px) == (18, 13)[z] and len(tile.outlines()) == 2
        qtbot.waitUntil(lambda z=z: page.panel.strip.tiles[z].image is not None, timeout=GUARD_MS)
        tip = page.panel.strip.item(z).toolTip()
        assert "fitted: 7 blades" in tip and "expected: 7 blades" in tip and f"Plane {z} (0 to 1)" in tip
        assert set(drawn_in(tile)) == {FITTED, EXPECTED}
        assert not drawn_in(replace(tile, fitted=None, expected=None))
        below, dashes = drawn_in(replace(tile, expected=tile.fitted)).values()
        assert dashes / 2 < below < 2 * dashes, "gaps show the fit where both coincide"
    assert "expected" in page.panel.aperture_text.text()


def drawn_in(tile: PlaneTile) -> dict[str, int]:
    """Return how many pixels of each outline that is seen are in the picture of a plane."""
    picture = tile.picture(160).toImage()
    pixels = [picture.pixelColor(x, y).getRgb()[:3] for x in range(160) for y in range(160)]
    wanted = {name: QColor(name).getRgb()[:3] for name in (FITTED, EXPECTED)}
    seen = {name: sum(max(map(abs, np.subtract(p, rgb))) < 30 for p in pixels) for name, rgb in wanted.items()}
    return {name: number for name, number in seen.items() if number}


def test_the_large_apertures_follow_the_strip_and_choose_planes(page: Any, context: Context, qtbot: QtBot) -> None:
    large = page.panel.show_apertures()
    qtbot.addWidget(large)
    assert large.grid.count() == page.panel.strip.count() == 2 and large.isVisible()
    assert large.width() <= 1000 and large.height() <= 600, "it fits the smallest window"
    assert large.grid.currentRow() == page.intent.z
    large.grid.setCurrentRow(0)
    idle(context.jobs, qtbot)
    assert page.intent.z == 0 == page.panel.strip.currentRow()
    page.set_intent(z=1)
    assert large.grid.currentRow() == 1
    assert page.panel.show_apertures() is large


@pytest.mark.long
def test_the_planes_and_their_legend_are_red_where_all_is_red(window: MainWindow, qtbot: QtBot) -> None:
    t, s = np.indices((31, 31)) - 15
    disc = np.clip(9.5 - np.hypot(t, s), 0, 1).astype(np.float32)
    window.context.matrices.put("disc", PSFMatrix(np.broadcast_to(disc, (1, 2, 2, 31, 31)).copy()))
    window.project.update("open", psf="disc")
    window.go("h")
    page: Any = window.page("h")
    drawn(page, qtbot)
    large = page.panel.show_apertures()

    def colours() -> set[bool]:
        """Return whether pixels of the strip and the large window are red."""
        found = set()
        for strip in (page.panel.strip, large.grid):
            image = strip.item(0).icon().pixmap(40, 40).toImage()
            pixels = [image.pixelColor(x, y) for x in range(image.width()) for y in range(image.height())]
            found |= {max(one.green(), one.blue()) <= one.red() for one in pixels if one.alpha() == 255}
        return found

    assert False in colours() and LINES[0] in page.panel.profile_title.text()
    window.set_theme("night")
    idle(window.jobs, qtbot)
    assert colours() == {True}
    for label in (page.panel.profile_title, page.panel.legend, large.legend):
        assert not any(tone in label.text() for tone in (*LINES, FITTED, EXPECTED))
    window.set_theme("light")
    idle(window.jobs, qtbot)
    assert FITTED in page.panel.legend.text() and FITTED in large.legend.text()
    large.close()


def test_a_reference_of_another_camera_warns(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    """The camera is changed after its H was simulated; what differs then is not only the measurement."""
    camera = context.state.camera
    values = np.ones((1, 3, 4, 5, 7), np.float32)
    for name in ("H.h5", "R.h5"):
        save(PSFMatrix(values, depths=[-10], camera=camera), tmp_path / name)
    context.project.update("open", psf=str(tmp_path / "H.h5"), reference=str(tmp_path / "R.h5"))
    told: list[tuple[str, bool]] = []
    context.attention.connect(lambda key, flag: told.append((key, flag)))
    page: Any = open_page("h")
    idle(context.jobs, qtbot)
    assert page.reference is not None and "another camera" not in page.hint.text()
    other = preset("r29" if camera != preset("r29") else "bench")
    context.project.update("other", camera=other)
    assert "the other H belongs to another camera" in page.hint.text() and told[-1] == ("simulate", True)
    context.project.update("back", camera=camera)
    assert "another camera" not in page.hint.text() and told[-1] == ("simulate", False)
    context.project.update("other", camera=other)
    context.project.update("neither", psf="", reference="")
    assert told[-1] == ("simulate", False), "nothing is compared"


def test_the_verdict_stands_next_to_h(page: Any, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    card = page.panel.verdict
    assert card.head.text() == "Not judged yet" and not card.sentence.isVisibleTo(card)
    stamp = stamp_of(page.context.state.psf)
    assert stamp is not None

    def say(verdict: Verdict) -> str:
        page.context.project.note(settings=with_verdict(page.context.state, stamp, verdict))
        return str(card.head.text())

    assert say(Verdict("good", "All checks pass.")) == "✓ Good" and card.property("merit") == "good"
    assert card.sentence.text() == "All checks pass."
    assert say(Verdict("bad", "5 positions are bad.", bad=5, share=0.01)) == "Good, except 5 positions"
    assert card.property("merit") == "fair"
    monkeypatch.setattr("lfcal_gui.pages.h.page.filled_of", lambda verdict, matrix: 5)
    assert say(Verdict("good", "Six were bad.", bad=6, share=0.01)) == "Good, except 1 position"
    assert say(Verdict("good", "Five were bad.", bad=5, share=0.01)) == "✓ Good", "the fit has filled all of them"
    monkeypatch.undo()
    assert say(Verdict("bad", "The background is 4 % of the light.")) == "▲ Bad"
    card.why.click()
    assert page.level == "checks" and page.panel.levels.currentWidget().objectName() == "checks"
    other = Path(page.context.state.psf)
    other.write_bytes(other.read_bytes() + b"\0")
    page.context.project.update("rename", name="other")
    assert card.head.text() == "Not judged yet", "it was of another file"


def test_the_order_of_axes_is_offered_and_kept(page: Any, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    values, path = np.random.default_rng(0).random((5, 5, 3, 3, 2)), str(tmp_path / "H.mat")
    save_v73(tmp_path / "H.mat", H=values)
    context.project.update("open", psf=path, reference="")
    idle(context.jobs, qtbot)
    guessed = np.asarray(page.matrix)
    assert page.notice.isVisible() and "read columns first" in page.notice.label.text()
    assert (page.notice.button.text(), page.notice.leave.text()) == ("Read rows first", "Keep columns first")
    page.notice.button.click()
    idle(context.jobs, qtbot)
    np.testing.assert_array_equal(np.asarray(page.matrix), as_meant(values))
    assert np.abs(np.asarray(page.matrix) - guessed).max() > 0.1 and not page.notice.isVisible()
    assert "rows first, as requested" in page.hint.text()
    again = ProjectState.from_json(context.state.to_json())
    context.project.start(ProjectState())
    context.project.start(again)
    idle(context.jobs, qtbot)
    np.testing.assert_array_equal(np.asarray(page.matrix), as_meant(values))
    assert not page.notice.isVisible(), "it is known"
    page.open_file(path)
    idle(context.jobs, qtbot)
    assert page.notice.button.text() == "Read columns first", "who opens a file again may choose again"
    export(PSFMatrix(np.ones((2, 3, 3, 5, 5), np.float32)), tmp_path / "said.mat")
    page.open_file(str(tmp_path / "said.mat"))
    idle(context.jobs, qtbot)
    assert page.matrix is not None and context.state.psf.endswith("said.mat") and not page.notice.isVisible()
    columns = OpeningSettings().with_order(path, "columns-first").into(again)
    context.project.update("order", psf=path, settings=columns)
    idle(context.jobs, qtbot)
    np.testing.assert_array_equal(np.asarray(page.matrix), guessed)


def test_controls_follow_the_intent(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((3, 4, 5, 9, 11)).astype(np.float32)
    save(PSFMatrix(values, depths=[-10, 0, 10]), tmp_path / "H.h5")
    save(PSFMatrix(values * 3, depths=[-10, 0, 10]), tmp_path / "R.h5")
    context.project.update("open", psf=str(tmp_path / "H.h5"), reference=str(tmp_path / "R.h5"))
    page = open_page("h")
    panel = page.panel
    idle(context.jobs, qtbot)
    assert (page.intent.z, page.intent.y, page.intent.x) == (1, 2, 2)
    panel.map.chosen.emit(3, 4)
    np.testing.assert_array_equal(panel.main_view.values, values[1, 3, 4])
    for z in (2, 0):
        panel.strip.setCurrentRow(z)
        idle(context.jobs, qtbot)
        assert page.intent.z == z
        np.testing.assert_array_equal(panel.main_view.values, values[z, 3, 4])
    page.set_intent(transposed=True)
    np.testing.assert_array_equal(panel.main_view.values, page.matrix.T[0, 3, 4])
    panel.main_view.hovered.emit(2, 3, 0.0)
    assert panel.linked_view.shot.cross is not None
    panel.main_view.hovered.emit(-1, -1, float("nan"))
    assert panel.linked_view.shot.cross is None
    panel.view_buttons["Difference"].click()
    assert panel.linked_view.shot.signed and np.abs(panel.linked_view.values).max() < 1e-5
    assert not panel.main_view.shot.signed
    panel.toggle_scale("log")
    panel.view_buttons["Both"].click()
    assert not panel.linked_view.shot.signed


def test_damaged_planes_have_no_picture(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((3, 3, 4, 9, 9)).astype(np.float32)
    save(PSFMatrix(values, depths=[0, 10, 20]), tmp_path / "H.h5")
    with h5py.File(tmp_path / "H.h5", "r+") as file:
        chunks = file["H"].id
        mask, raw = chunks.read_direct_chunk((2, 0, 0, 0, 0))
        chunks.write_direct_chunk((2, 0, 0, 0, 0), raw[:20] + bytes([raw[20] ^ 255]) + raw[21:], mask)
    context.project.update("open", psf=str(tmp_path / "H.h5"))
    page, said = open_page("h"), list[str]()
    idle(context.jobs, qtbot)
    panel = page.panel
    qtbot.waitUntil(lambda: panel.map.item.image is not None, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    page.set_intent(z=2)
    idle(context.jobs, qtbot)
    for view in (panel.main_view, panel.linked_view, panel.sum_view):
        assert view.values is None and view.blank.shown and "cannot be read" in view.blank.text()
    assert "damaged" in panel.readout.text() and panel.map.item.image is None and not panel.profile._curves
    assert panel.aperture_text.text() == ""
    page._step(0, 1)
    page.set_intent(transposed=True, z=1)
    qtbot.waitUntil(lambda: panel.map.item.image is not None, timeout=GUARD_MS)
    assert np.array_equal(panel.main_view.values, page.matrix.T[1, page.intent.y, page.intent.x])
    assert panel.readout.text().startswith("Point at") and panel.aperture_text.text()
    (tmp_path / "bad.h5").write_bytes(b"no hdf5")
    context.message.connect(said.append)
    context.project.update("open", psf=str(tmp_path / "bad.h5"))
    idle(context.jobs, qtbot)
    assert page.matrix is None and "HDF5" in page.empty.label.text() and any("HDF5" in words for words in said)
    page.checking.write_report(str(tmp_path / "report"))
    page.look_into("checks")
    idle(context.jobs, qtbot)
    assert "HDF5" in page.checking.view.message.text()
    context.project.update("none", psf="")
    page.look_into("fit")
    assert page.empty.title.text() == "No H yet" and not page.fitting.view.fit_button.isEnabled()
    assert page.checking.inspection is None and not page.checking.view.report_button.isEnabled()


def test_a_simulated_plane_shows_how_it_was_computed(page: Any, context: Context, tmp_path: Path, qtbot: QtBot) -> None:
    assert page.panel.made_fold.isHidden() and "computed" not in page.panel.strip.item(0).toolTip(), "it was recorded"
    sampling = {"samples_per_px": 3, "nodes_per_px": 2}
    grid = {"engine": "grid", "sampling": sampling, "grid_side": 96, "processor_seconds": 2.5, "error": 0.012}
    rays = {"engine": "geometric", "sampling": sampling, "processor_seconds": 12}
    values = np.ones((3, 3, 4, 5, 7), np.float32)
    made = PSFMatrix(values, depths=[1, 2, 3], provenance={"simulated": {"planes": [grid, None, rays]}})
    save(made, tmp_path / "made.h5")
    context.project.update("open", psf=str(tmp_path / "made.h5"), reference="")
    idle(context.jobs, qtbot)
    stated = {
        0: "grid, 3 samples per pixel, 96 × 96 samples\n2.5 s of processor time\nerror at most 1.2 %",
        1: "",
        2: "geometric, rays integrated over the pixels\n12 s of processor time",
    }
    for z, words in stated.items():
        page.set_intent(z=z)
        idle(context.jobs, qtbot)
        assert page.panel.made.text() == words and page.panel.made_fold.isHidden() is not bool(words)
        qtbot.waitUntil(lambda z=z: page.panel.strip.tiles[z].image is not None, timeout=GUARD_MS)
        tip = page.panel.strip.item(z).toolTip()
        assert tip.endswith(f"computed with {words}") if words else "computed" not in tip
