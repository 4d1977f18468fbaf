"""The export in the inspector shows what concerns a code or a kind of file, and writes it as a job."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from PySide6.QtWidgets import QApplication, QFileDialog, QLineEdit, QMessageBox
from pytestqt.qtbot import QtBot

from lfcal.base import Judgement
from lfcal.psf import PSFMatrix, save
from lfcal_gui.jobs import JobState
from lfcal_gui.models.gathering import exported_to
from lfcal_gui.models.next_step import next_step
from lfcal_gui.models.stamp import stamp_of
from lfcal_gui.models.verdict import verdict_of, with_verdict
from lfcal_gui.pages.reconstruct import _exporting
from lfcal_gui.pages.reconstruct._exporting import ExportCard
from lfcal_gui.pages.reconstruct.export_model import ExportSettings
from lfcal_gui.window import MainWindow
from tests.gui.pages.reconstruct.test_export_model import incomplete, matrix
from tests.gui.waiting import GUARD_MS, idle


@pytest.fixture
def card(qtbot: QtBot) -> ExportCard:
    made = ExportCard()
    qtbot.addWidget(made)
    made.other.open()
    made.show()
    return made


def shown(card: ExportCard) -> set[str]:
    return {key for key in card.form.fields if card.form.editor(key).isVisible()}


def test_only_what_concerns_the_file_is_shown(card: ExportCard) -> None:
    card.show_settings(ExportSettings(), matrix(), "")
    assert shown(card) == {"lens_centred", "interpolation", "rows_first", "no_ht", "allow_missing", "uncompressed"}
    assert "8.50" in card.other_note.text() and "--" not in card.other_note.text(), "no options of the command line"
    card.show_settings(ExportSettings(lens_centred=True, interpolation="cubic"), matrix(), "")
    assert not card.other_note.isVisible()
    asked: list[tuple[str, object]] = []
    for part in (card, card.form):
        part.edited.connect(lambda key, value: asked.append((key, value)))
    card.kind.setCurrentIndex(card.kind.findData(".tif"))
    assert asked == [("suffix", ".tif")]
    card.show_settings(ExportSettings(suffix=".tif"), matrix(), "")
    assert shown(card) == {"transposed", "position", "allow_missing"}
    position = card.form.editor("position")
    assert isinstance(position, QLineEdit)
    position.setText("1,2")
    position.textEdited.emit("1,2")
    assert asked[-1][0] == "position"


def test_a_code_has_its_facts_and_its_refusal(card: ExportCard) -> None:
    card.show_settings(ExportSettings(), matrix(), "good")
    assert card.codes["olaf"].isChecked() and card.go.text() == "Export for oLaF …" and card.go.isEnabled()
    words = [label.text() for fact in card.facts.values() for label in fact]
    assert "H{y,x,z}(t,s)" in words and "good" in words and "stored in the file" in words
    asked: list[str] = []
    card.asked.connect(asked.append)
    card.usual_asked.connect(lambda: asked.append("usual"))
    card.go.click()
    card.other_go.click()
    assert asked == ["usual", ""]
    card.show_settings(ExportSettings("flfm"), matrix(), "")
    assert "one pattern for each plane" in card.note.text()
    assert card.go.isEnabled() and card.go.text() == "Export as .mat …", "other formats hold any H"


def test_missing_positions_must_be_allowed(card: ExportCard) -> None:
    card.show_settings(ExportSettings(), incomplete(), "")
    assert card.go.text() == "Export as .h5 …" and not card.other_go.isEnabled(), "that format marks them"
    assert "1 of 18 positions is missing" in card.other_note.text() and card.form.editor("allow_missing").isEnabled()
    card.show_settings(ExportSettings(allow_missing=True), incomplete(), "")
    assert card.go.isEnabled() and card.other_go.isEnabled()
    assert "1 of 18 positions is missing" in card.other_note.text()
    card.show_settings(ExportSettings(suffix=".h5"), incomplete(), "")
    assert card.other_go.isEnabled() and "the file marks them" in card.other_note.text()


def test_without_a_camera_no_lens_can_be_centred(card: ExportCard) -> None:
    card.show_settings(ExportSettings(), PSFMatrix(np.ones((1, 3, 3, 3, 3), np.float32)), "")
    assert not card.form.editor("lens_centred").isEnabled() and card.form.editor("rows_first").isEnabled()
    assert "not state where its lenses are" in card.other_note.text()


def opened(window: MainWindow, qtbot: QtBot, path: Path) -> Any:
    window.go("reconstruct")
    page: Any = window.page("reconstruct")
    save(matrix(), path)
    window.project.update("open", psf=str(path))
    idle(window.jobs, qtbot)
    return page


def test_nothing_is_exported_without_an_h(window: MainWindow) -> None:
    window.go("reconstruct")
    page: Any = window.page("reconstruct")
    for export in (page.exporting.ask, page.exporting.ask_usual, lambda: page.exporting.start("H.mat")):
        page.notice.clear()
        export()
        assert "no H to export" in page.notice.label.text()


def test_the_next_step_exports_for_a_code_with_the_quality_of_h(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = opened(window, qtbot, tmp_path / "H.h5")
    stamp = stamp_of(str(tmp_path / "H.h5"))
    assert stamp is not None
    verdict = verdict_of(Judgement("H", (), "good by 26 checks"))
    window.project.note(settings=with_verdict(window.project.state, stamp, verdict))
    assert page.panel.export.facts["Quality"][0].text() == "good"
    page.panel.export.codes["prevedel"].click()
    window.leading.gather()
    step, (value, unit) = next_step(window.leading.sitting), page.panel.export.facts["H and HT"]
    assert step.button == page.panel.export.go.text().removesuffix(" …") == "Export for Prevedel"
    size = f"{value.text()} {unit.text()}"
    assert f"export H and HT, {size}: H is good" in step.words, "one number for one export"
    assert page.exporting.settings.code == "prevedel"
    out = tmp_path / "H_Prevedel.mat"
    monkeypatch.setattr(_exporting, "ask_target", lambda *_: str(out))
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        assert page.do("export")
    assert end.args[0].state is JobState.DONE and end.args[0].kind == "export", end.args[0].error
    with h5py.File(out) as file:
        assert bytes(file["quality"][:, 0].tolist()) == b"good" and file["H"].shape == (2, 15, 15, 3, 3)
        np.testing.assert_allclose(file["lensCentre"][()], [[8.5], [8.5]])
    assert exported_to(window.project.state) == str(out)
    assert "H is exported to H_Prevedel.mat" in page.panel.export.result.text()
    folders: list[Path] = []
    monkeypatch.setattr(_exporting, "open_folder", folders.append)
    page.panel.export.result.linkActivated.emit("folder")
    assert page.do("folder") and folders == [tmp_path, tmp_path]


def test_other_formats_write_what_the_project_says(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = opened(window, qtbot, tmp_path / "H.h5")
    said = ExportSettings("flfm", ".h5", dtype="rounded", uncompressed=True)
    window.project.update("export", settings=said.into(window.project.state))
    assert page.panel.export.go.text() == "Export as .h5 …" and page.panel.export.kind.currentData() == ".h5"
    out = tmp_path / "small.h5"
    monkeypatch.setattr(_exporting, "ask_target", lambda *_: str(out))
    with qtbot.waitSignal(window.jobs.finished, timeout=GUARD_MS) as end:
        assert page.do("export"), "a code that cannot use H leads to the other formats"
    assert end.args[0].state is JobState.DONE, end.args[0].error
    with h5py.File(out) as file:
        assert file["step"][...].all() and file["H"].compression is None
    idle(window.jobs, qtbot)


@pytest.mark.parametrize(
    ("settings", "name", "words"),
    [
        (ExportSettings("", ".mat"), "H.png", "suffix of the output file: expected .mat .h5 .npy .tif .tiff, got .png"),
        (
            ExportSettings("", ".mat", lens_centred=True),
            "other.h5",
            "Centre a lens: expected a .mat file, got a .h5 file",
        ),
    ],
)
def test_a_name_that_the_settings_do_not_allow_is_refused(
    window: MainWindow,
    qtbot: QtBot,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    settings: ExportSettings,
    name: str,
    words: str,
) -> None:
    """Both names ended in a traceback."""
    page = opened(window, qtbot, tmp_path / "H.h5")
    window.project.update("export", settings=settings.into(window.project.state))
    told: list[str] = []
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_: (str(tmp_path / name), ""))
    monkeypatch.setattr(QMessageBox, "warning", lambda *args: told.append(args[2]))
    page.exporting.ask()
    assert len(told) == 1 and words in told[0], told
    assert not (tmp_path / name).exists()


def test_a_name_asks_for_its_kind_of_file(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    page = opened(window, qtbot, tmp_path / "H.h5")
    page.exporting.start(str(tmp_path / "H.npy"))
    idle(window.jobs, qtbot)
    np.testing.assert_array_equal(np.load(tmp_path / "H.npy"), np.asarray(matrix()))


def test_the_facts_are_whole_in_the_smallest_window(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    """Before H was judged, "MB uncompressed" was cut."""
    card = opened(window, qtbot, tmp_path / "H.h5").panel.export
    window.resize(1000, 600)
    card.show_settings(ExportSettings(), matrix(), "")
    QApplication.processEvents()
    remark = card.facts["H and HT"][1]
    assert card.facts["Quality"][0].text() == "not judged" and remark.width() < 120
    assert "uncompressed" in remark.text() and remark.toolTip() == "", "nothing is left out"
