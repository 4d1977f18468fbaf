"""What an export is asked for in the window is what the library is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfcal.camera import preset
from lfcal.psf import PSFMatrix, save_regions
from lfcal.psf._export import WRITERS
from lfcal.tasks import command_of
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.psf.export_model import CHOICES, KINDS, ExportIntent, ExportSettings, export_task


def matrix() -> PSFMatrix:
    values = np.ones((2, 15, 15, 3, 3), np.float32)
    return PSFMatrix(values, camera=preset("lfm_20x05"), anchor=(1072, 1272), depths=[0.0, 1.0])


@pytest.mark.parametrize("suffix", [suffix for suffix, _ in KINDS])
def test_every_choice_reaches_its_format_and_no_other(suffix: str) -> None:
    assert ExportIntent(suffix=suffix).options.given() == {}
    everything = ExportIntent(suffix=suffix, position=(1, 2))
    for choice in CHOICES:
        everything = everything.with_choice(choice.name, not getattr(everything, choice.name))
    given = everything.options.given()
    assert set(given) <= WRITERS[suffix].uses
    # HT in place of H is another matrix, not an option
    told = len(everything.choices()) - ("transposed" in {choice.name for choice in everything.choices()})
    assert len(given) == told, given


def test_patterns_are_moved_only_where_the_lens_is_centred() -> None:
    intent = ExportIntent().with_choice("moved", True)
    assert intent.lens_centred and intent.options.interpolation == "cubic"
    assert not intent.with_choice("lens_centred", False).moved


def test_notes_follow_the_choices() -> None:
    H = matrix()
    intent = ExportIntent()
    assert "a lens is centred on row 8.50" in intent.notes(H)[0]
    assert "leave the lens's centre" in intent.with_choice("lens_centred", True).notes(H)[0]
    assert intent.with_choice("moved", True).notes(H) == ()
    assert ExportIntent(suffix=".npy").notes(H) == ()
    plain = PSFMatrix(np.ones((1, 3, 3, 3, 3)))
    assert not {"lens_centred", "moved"} & intent.open_to(plain) and "lens_centred" in intent.open_to(H)


def incomplete() -> PSFMatrix:
    values = np.ones((2, 3, 3, 3, 3), np.float32)
    recorded = np.ones((2, 3, 3), int)
    recorded[0, 1, 2] = 0
    return PSFMatrix(values, depths=[0.0, 1.0], recorded=recorded)


@pytest.mark.parametrize("suffix", [suffix for suffix, _ in KINDS])
def test_missing_positions_are_written_only_where_that_was_allowed(suffix: str) -> None:
    H, intent = incomplete(), ExportIntent(suffix=suffix)
    said = "1 of 18 positions is missing"
    assert said in intent.notes(H)[0] and "--" not in intent.notes(H)[0]
    assert bool(intent.refusal(H)) is (suffix != ".h5") and ("allow_missing" in intent.open_to(H)) is (suffix != ".h5")
    allowed = intent.with_choice("allow_missing", True)
    assert not allowed.refusal(H) and said in allowed.notes(H)[0]
    assert "allow_missing" not in intent.open_to(matrix()) and not intent.refusal(matrix())


def test_files_and_matrix_are_what_is_written(tmp_path: Path) -> None:
    H = matrix()
    intent = ExportIntent(suffix=".tif", position=(1, 2)).with_choice("here", True)
    assert intent.files(H, tmp_path / "H.tif") == [tmp_path / "H.tif"] and intent.options.position == (1, 2)
    turned = ExportIntent(suffix=".npy").with_choice("transposed", True)
    assert turned.matrix(H).is_transposed and not ExportIntent(suffix=".mat", transposed=True).matrix(H).is_transposed


def test_what_the_project_says_of_an_h_file_is_proposed() -> None:
    assert ExportSettings().on(ExportIntent(".npy")) == ExportIntent(".npy")
    said = ExportSettings(".h5", sixteen=True, compress=False)
    assert ExportSettings.from_dict(said.to_dict()) == said
    found = ExportSettings.of(ProjectState(settings={"psf": said.to_dict()})).on(ExportIntent(".mat"))
    assert found.suffix == ".h5" and found.options.given() == {"dtype": "rounded", "compress": False}
    assert "sixteen" in found.open_to(matrix())


def test_of_several_regions_the_one_that_is_shown_is_exported(tmp_path: Path) -> None:
    one, other = (PSFMatrix(np.full((1, 3, 3, 3, 3), value, np.float32)) for value in (1.0, 2.0))
    psf = save_regions({"middle": one, "edge": other}, tmp_path / "R.h5")
    task = export_task(str(psf), str(tmp_path / "made.npy"), ExportIntent(suffix=".npy"))
    assert "--region=middle" in command_of(task)
    task.run()
    assert float(np.load(tmp_path / "made.npy").max()) == 1.0
