"""What an export is asked for in the window is what the library does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.psf import CODES, PSFMatrix, save_regions
from lfcal.records import rows, value_at
from lfcal.tasks import ExportFor, command_of
from lfcal_gui.models.next_step import Sitting, next_step
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.verdict import Verdict
from lfcal_gui.pages.reconstruct.export_model import ELSEWHERE, KINDS, OPTIONS, ExportSettings, facts_of, next_facts


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


def test_patterns_are_moved_only_where_the_lens_is_centred() -> None:
    settings = ExportSettings().changed("interpolation", "cubic")
    assert settings.lens_centred and settings.interpolation == "cubic"
    assert not settings.changed("lens_centred", False).interpolation


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


def test_files_and_matrix_are_what_is_written(tmp_path: Path) -> None:
    H = matrix()
    settings = ExportSettings(suffix=".tif").changed("position", "1,2")
    assert settings.position == (1, 2) and settings.files(H, tmp_path / "H.tif") == [tmp_path / "H.tif"]
    task: Any = ExportSettings(suffix=".npy", transposed=True).task("H.h5", "H.npy")
    assert task.exported(H).is_transposed


def test_settings_of_a_project_are_kept() -> None:
    said = ExportSettings("prevedel", ".h5", dtype="rounded", uncompressed=True, position=(2, 1))
    assert ExportSettings.from_dict(said.to_dict()) == said
    assert ExportSettings.of(ProjectState(settings={"export": said.to_dict()})) == said
    wrong = {"code": "other", "suffix": ".zip", "dtype": "int3", "position": [1], "uncompressed": True}
    assert ExportSettings.from_dict(wrong) == ExportSettings(uncompressed=True)


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
    """The next step offered a code that refused this H, and a size of H and HT for files without HT."""
    offered, code = settings.offered(H)
    assert not offered.refusal(H, code)
    project = ProjectState(settings={"export": settings.to_dict()})
    facts = {"export_title": title, "export_ht": both, "export_bytes": (1 + both) * H.nbytes}
    assert next_facts(project, H) == facts
    assert next_step(replace(Sitting(h=True, verdict=Verdict("good")), **facts)).button == title


def test_nothing_that_a_form_does_not_show_is_an_option() -> None:
    assert not set(ELSEWHERE) & set(OPTIONS)
