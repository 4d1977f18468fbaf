"""Exports: what is offered of an H, and the same file by the window, its command and its Python."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from PySide6.QtWidgets import QFileDialog, QMessageBox
from pytestqt.qtbot import QtBot

from lfcal.base import Judgement, drain
from lfcal.camera import ScanPlan, preset
from lfcal.psf import CODES, PSFMatrix, save, save_regions
from lfcal.records import rows, value_at
from lfcal.tasks import ExportFor, command_of
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState
from lfcal_gui.models import (
    OpeningSettings,
    ProjectState,
    Sitting,
    Verdict,
    exported_to,
    next_step,
    stamp_of,
    verdict_of,
    with_verdict,
)
from lfcal_gui.pages.reconstruct import _exporting
from lfcal_gui.pages.reconstruct._exporting import ExportCard
from lfcal_gui.pages.reconstruct.export_model import (
    ELSEWHERE,
    KINDS,
    OPTIONS,
    ExportSettings,
    facts_of,
    iter_exported,
    next_facts,
)
from lfcal_gui.pages.reconstruct.step import export_step, step
from lfcal_gui.window import MainWindow
from tests.cli import conftest
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle
from tests.tasks.routes import Lfcal
from tests.tasks.test_matrices import contents


def matrix() -> PSFMatrix:
    values = np.ones((2, 15, 15, 3, 3), np.float32)
    return PSFMatrix(values, camera=preset("lfm_20x05"), anchor=(1072, 1272), depths=[0.0, 1.0])


def turned(suffix: str) -> ExportSettings:
    """Return settings with every option of a kind of file other than by default."""
    settings = ExportSettings(suffix=suffix)
    values: dict[str, Any] = {"position": "1,2", "interpolation": "cubic", "dtype": "float32"}
    for name in settings.names:
        settings = settings.changed(name, values.get(name, True))
    return settings


@pytest.mark.parametrize("suffix", KINDS)
def test_every_option_of_a_kind_reaches_its_task_and_no_other(suffix: str) -> None:
    plain = ExportSettings(suffix=suffix).task("H.h5", f"out{suffix}")
    assert type(plain) is KINDS[suffix][0]
    assert not any(value_at(plain, row) for row in rows(type(plain)) if row.name not in ("source", "out"))
    settings = turned(suffix)
    task = settings.task("H.h5", f"out{suffix}")
    default = {row.name for row in rows(type(task)) if value_at(task, row) == row.default}
    assert default == {"region", "mat_order"}, "these depend on how the file was opened"
    assert set(settings.names) <= set(OPTIONS) and settings.shown().keys() == OPTIONS.keys()


def test_notes_follow_the_options() -> None:
    H = matrix()
    settings = ExportSettings()
    assert "a lens is centred on row 8.50" in settings.notes(H)[0]
    assert "the centre of the lens is" in settings.changed("lens_centred", True).notes(H)[0]
    assert settings.changed("interpolation", "cubic").notes(H) == ()
    assert ExportSettings(suffix=".npy").notes(H) == ()
    plain = PSFMatrix(np.ones((1, 3, 3, 3, 3), np.float32))
    assert not {"lens_centred", "interpolation"} & settings.open_to(plain) and "lens_centred" in settings.open_to(H)


def incomplete() -> PSFMatrix:
    values = np.ones((2, 3, 3, 3, 3), np.float32)
    recorded = np.ones((2, 3, 3), int)
    recorded[0, 1, 2] = 0
    return PSFMatrix(values, depths=[0.0, 1.0], recorded=recorded)


@pytest.mark.parametrize("suffix", KINDS)
def test_missing_positions_are_written_only_where_that_was_allowed(suffix: str) -> None:
    H, settings = incomplete(), ExportSettings(suffix=suffix)
    said = "1 of 18 positions is missing"
    assert said in settings.notes(H)[0]
    assert bool(settings.refusal(H)) is (suffix != ".h5")
    assert ("allow_missing" in settings.open_to(H)) is (suffix != ".h5")
    if suffix != ".h5":
        allowed = settings.changed("allow_missing", True)
        assert not allowed.refusal(H) and said in allowed.notes(H)[0]
    assert "allow_missing" not in settings.open_to(matrix()) and not settings.refusal(matrix())


def test_of_several_regions_the_one_that_is_shown_is_exported(tmp_path: Path) -> None:
    one, other = (PSFMatrix(np.full((1, 3, 3, 3, 3), value, np.float32)) for value in (1.0, 2.0))
    psf = save_regions({"middle": one, "edge": other}, tmp_path / "R.h5")
    task = ExportSettings(suffix=".npy").task(str(psf), str(tmp_path / "made.npy"))
    assert "--region=middle" in command_of(task)
    task.run()
    assert float(np.load(tmp_path / "made.npy").max()) == 1.0


@pytest.mark.parametrize("code", CODES)
def test_a_code_is_a_task_with_the_quality_of_h(code: str) -> None:
    settings = ExportSettings(suffix=".npy", dtype="rounded")
    out = f"H{settings.suffix_for(code)}"
    task = settings.task("H.h5", out, code=code, quality="good")
    assert isinstance(task, ExportFor) and (task.code, task.quality, str(task.out)) == (code, "good", out)
    facts = facts_of(matrix(), code, "good")
    assert facts.order[0] == CODES[code].order and facts.quality == ("good", "stored in the file")
    assert facts.size[1] == "uncompressed", "a longer remark was cut in a narrow window"
    assert facts_of(matrix(), code, "").quality == ("not judged", "")


def test_the_first_code_that_can_use_h_is_proposed() -> None:
    H, settings = matrix(), ExportSettings()
    assert settings.code_for(H) == "olaf" and not settings.refusal(H, "olaf")
    assert "one pattern for each plane, got 15 × 15" in settings.refusal(H, "flfm").replace(" x ", " × ")
    assert settings.notes(H, "flfm") == (settings.refusal(H, "flfm"),)
    assert "range 'full'" in settings.notes(H, "olaf")[-1]
    assert ExportSettings("pyolaf").code_for(H) == "pyolaf"
    single = PSFMatrix(np.ones((1, 1, 1, 3, 3), np.float32))
    assert settings.refusal(incomplete(), "olaf") and not settings.changed("allow_missing", True).refusal(
        incomplete(), "olaf"
    )
    assert not settings.refusal(single, "flfm")
    plan = ScanPlan.for_camera(preset("bench"), depths_um=[1e3])
    hexagonal = PSFMatrix(np.ones((1, *plan.shape[1:3], 3, 3), np.float32), camera=preset("bench"), depths=[1e3])
    assert settings.code_for(hexagonal) == "olaf" and "lenses on a square grid" in settings.refusal(hexagonal, "olaf")


@pytest.mark.parametrize(
    ("H", "settings", "title", "both"),
    [
        (matrix(), ExportSettings(), "Export for oLaF", True),
        (matrix(), ExportSettings("flfm"), "Export as .mat", True),
        (matrix(), ExportSettings("flfm", no_ht=True), "Export as .mat", False),
        (matrix(), ExportSettings("flfm", ".npy"), "Export as .npy", False),
        (incomplete(), ExportSettings(), "Export as .h5", False),
        (incomplete(), ExportSettings("olaf", allow_missing=True), "Export for oLaF", True),
        (PSFMatrix(np.ones((1, 1, 1, 3, 3), np.float32)), ExportSettings("flfm"), "Export for FLFM", False),
    ],
)
def test_what_is_offered_is_possible(H: PSFMatrix, settings: ExportSettings, title: str, both: bool) -> None:
    offered, code = settings.offered(H)
    assert not offered.refusal(H, code)
    project = ProjectState(settings={"export": settings.to_dict()})
    facts = {"export_title": title, "export_ht": both, "export_bytes": (1 + both) * H.nbytes}
    assert next_facts(project, H) == facts
    assert next_step(replace(Sitting(h=True, verdict=Verdict("good")), **facts)).button == title


@pytest.fixture
def card(qtbot: QtBot) -> ExportCard:
    made = ExportCard()
    qtbot.addWidget(made)
    made.other.open()
    made.show()
    return made


def fields_shown(card: ExportCard) -> set[str]:
    return {key for key in card.form.fields if card.form.editor(key).isVisible()}


def test_only_what_concerns_the_file_is_shown(card: ExportCard) -> None:
    card.show_settings(ExportSettings(), matrix(), "")
    assert fields_shown(card) == {
        "lens_centred",
        "interpolation",
        "rows_first",
        "no_ht",
        "allow_missing",
        "uncompressed",
    }
    assert "8.50" in card.other_note.text() and "--" not in card.other_note.text(), "no options of the command line"
    card.show_settings(ExportSettings(lens_centred=True, interpolation="cubic"), matrix(), "")
    assert not card.other_note.isVisible()
    asked: list[tuple[str, object]] = []
    for part in (card, card.form):
        part.edited.connect(lambda key, value: asked.append((key, value)))
    card.kind.setCurrentIndex(card.kind.findData(".tif"))
    assert asked == [("suffix", ".tif")]
    card.show_settings(ExportSettings(suffix=".tif"), matrix(), "")
    assert fields_shown(card) == {"transposed", "position", "allow_missing"}
    position = card.form.editor("position")
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


def opened(page: Any, qtbot: QtBot, path: Path) -> Any:
    """Return the page once it has an H."""
    save(matrix(), path)
    page.context.project.update("open", psf=str(path))
    idle(page.context.jobs, qtbot)
    return page


def test_nothing_is_exported_without_an_h(open_page: OpenPage) -> None:
    page = open_page("reconstruct")
    for export in (page.exporting.ask, page.exporting.ask_usual, lambda: page.exporting.start("H.mat")):
        page.notice.clear()
        export()
        assert "no H to export" in page.notice.label.text()


def test_other_formats_write_what_the_project_says_under_names_that_are_allowed(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, told = opened(open_page("reconstruct"), qtbot, tmp_path / "H.h5"), list[str]()
    said = ExportSettings("flfm", ".h5", dtype="rounded", uncompressed=True)
    context.project.update("export", settings=said.into(context.state))
    assert page.panel.export.go.text() == "Export as .h5 …" and page.panel.export.kind.currentData() == ".h5"
    out = tmp_path / "small.h5"
    with monkeypatch.context() as patch, qtbot.waitSignal(context.jobs.finished, timeout=GUARD_MS) as end:
        patch.setattr(_exporting, "ask_target", lambda *_: str(out))
        assert page.do("export"), "a code that cannot use H leads to the other formats"
    assert end.args[0].state is JobState.DONE, end.args[0].error
    with h5py.File(out) as file:
        assert file["step"][...].all() and file["H"].compression is None
    idle(context.jobs, qtbot)
    monkeypatch.setattr(QMessageBox, "warning", lambda *args: told.append(args[2]))
    for centred, name, words in (
        (False, "H.png", "suffix of the output file: expected .mat .h5 .npy .tif .tiff, got .png"),
        (True, "other.h5", "Centre a lens: expected a .mat file, got a .h5 file"),
    ):
        settings = ExportSettings("", ".mat", lens_centred=centred)
        context.project.update("export", settings=settings.into(context.state))
        monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_, name=name: (str(tmp_path / name), ""))
        page.exporting.ask()
        assert words in told[-1] and not (tmp_path / name).exists()
    assert len(told) == 2


def test_the_next_step_exports_for_a_code_with_the_quality_of_h(
    window: MainWindow, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.go("reconstruct")
    page = opened(window.page("reconstruct"), qtbot, tmp_path / "H.h5")
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


def test_files_settings_and_matrix_are_what_is_written(tmp_path: Path) -> None:
    H = matrix()
    settings = ExportSettings(suffix=".tif").changed("position", "1,2")
    assert settings.position == (1, 2) and settings.files(H, tmp_path / "H.tif") == [tmp_path / "H.tif"]
    task: Any = ExportSettings(suffix=".npy", transposed=True).task("H.h5", "H.npy")
    assert task.exported(H).is_transposed
    said = ExportSettings("prevedel", ".h5", dtype="rounded", uncompressed=True, position=(2, 1))
    assert ExportSettings.from_dict(said.to_dict()) == said
    assert ExportSettings.of(ProjectState(settings={"export": said.to_dict()})) == said
    wrong = {"code": "other", "suffix": ".zip", "dtype": "int3", "position": [1], "uncompressed": True}
    assert ExportSettings.from_dict(wrong) == ExportSettings(uncompressed=True)
    moved = ExportSettings().changed("interpolation", "cubic")
    assert moved.lens_centred and moved.interpolation == "cubic"
    assert not moved.changed("lens_centred", False).interpolation, "patterns are moved only where the lens is centred"
    assert not set(ELSEWHERE) & set(OPTIONS)


def test_missing_positions_must_be_allowed_and_no_lens_is_centred_without_a_camera(card: ExportCard) -> None:
    said = "1 of 18 positions is missing"
    card.show_settings(ExportSettings(), incomplete(), "")
    assert card.go.text() == "Export as .h5 …" and not card.other_go.isEnabled(), "that format marks them"
    assert said in card.other_note.text() and card.form.editor("allow_missing").isEnabled()
    card.show_settings(ExportSettings(allow_missing=True), incomplete(), "")
    assert card.go.isEnabled() and card.other_go.isEnabled() and said in card.other_note.text()
    card.show_settings(ExportSettings(suffix=".h5"), incomplete(), "")
    assert card.other_go.isEnabled() and "the file marks them" in card.other_note.text()
    card.show_settings(ExportSettings(), PSFMatrix(np.ones((1, 3, 3, 3, 3), np.float32)), "")
    assert not card.form.editor("lens_centred").isEnabled() and card.form.editor("rows_first").isEnabled()
    assert "not state where its lenses are" in card.other_note.text()


CASES = {
    **{suffix: (turned(suffix).changed("lens_centred", False), "") for suffix in KINDS},  # H states no camera
    **{code: (ExportSettings(), code) for code in ("olaf", "prevedel", "pyolaf")},
}
lfcal = conftest.lfcal


@pytest.mark.parametrize("case", CASES)
def test_every_route_writes_the_same(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    monkeypatch.chdir(tmp_path)
    settings, code = CASES[case]
    values = np.random.default_rng(0).random((2, 3, 3, 5, 7), np.float32)
    save(PSFMatrix(values, depths=(-5.0, 5.0)), "H.h5")
    out = f"out{settings.suffix_for(code)}"
    copied = export_step(ProjectState(psf="H.h5"), out, settings, code)
    path = drain(iter_exported(settings.task("H.h5", out, code=code), out))
    by_window = written(path)
    path.unlink()
    done = lfcal(*shlex.split(copied.shell())[1:])
    assert done.code == 0, done.err
    assert written(path) == by_window
    path.unlink()
    exec(compile(copied.script(), "script", "exec"), {})
    assert written(path) == by_window


def written(path: Path) -> Any:
    """Return the values of a file, without the addresses of cells and the dates of a zip file."""
    if path.suffix != ".npz":
        found = contents(path)
        cells = path.suffix == ".mat" and any(name.startswith("#refs#") for name in found)
        return {name: value for name, value in found.items() if name not in ("H", "Ht")} if cells else found
    with np.load(path) as file:
        return {name: file[name].tobytes() for name in file.files}


def test_the_command_names_the_order_of_axes_that_was_stated() -> None:
    project = ProjectState(psf="H.mat")
    assert "--mat-order=rows-first" not in step(project).arguments
    project = replace(project, settings=OpeningSettings().with_order("H.mat", "rows-first").into(project))
    assert "--mat-order=rows-first" in step(project).arguments
    assert "--mat-order=rows-first" not in step(replace(project, psf="other.mat")).arguments
    script = step(ProjectState(psf="H.h5")).script()
    assert script.count("from pathlib import Path") == 1 and "ExportMat(" in script
