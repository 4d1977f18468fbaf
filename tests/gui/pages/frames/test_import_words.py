"""What the import cannot do is said in the words of its window: what to do there, and no option of a command."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.camera import Camera, ScanPlan, preset
from lfcal_gui.models.words import said_in_window
from lfcal_gui.pages.frames.import_choice import ImportChoice
from lfcal_gui.pages.frames.model_import import survey
from tests.frames.lists.scans import scan, write_frames
from tests.gui.pages.frames.test_import_columns import PLACES, plan, recorded


def positions(folder: Path) -> str:
    """Write a scan with positions in the names, from 0."""
    found = scan()
    write_frames(folder, found, [f"z{z}_y{y}_x{x}.tif" for z, y, x in found.positions])
    return str(folder)


def counted(folder: Path) -> str:
    """Write a scan with a list of positions, from 0."""
    found = scan()
    names = [f"a{k}.tif" for k in range(len(found.positions))]
    write_frames(folder, found, names)
    rows = [f"{name},{z},{y},{x}" for name, (z, y, x) in zip(names, found.positions.tolist(), strict=True)]
    (folder / "list.csv").write_text("\n".join(["file,z,y,x", *rows]))
    return str(folder)


def two_lists(folder: Path) -> str:
    recorded(folder)
    shutil.copy(folder / "stage.csv", folder / "stage2.csv")
    return str(folder)


def empty(folder: Path) -> str:
    folder.mkdir()
    return str(folder)


def unlike(folder: Path) -> str:
    """Write frames of names without numbers of positions."""
    folder.mkdir()
    for name in ("left", "right"):
        tifffile.imwrite(folder / f"{name}.tif", np.zeros((40, 48), np.uint16))
    return str(folder)


def long_exposures(folder: Path) -> str:
    recorded(folder, ("file", *PLACES, "Exposure"))
    listed = folder / "stage.csv"
    listed.write_text(listed.read_text().replace(";20\n", ";20000\n").removesuffix("20") + "20000")
    return str(folder)


CASES: list[tuple[Callable[[Path], str], dict[str, str], str]] = [
    (positions, {"first": "1"}, "got 0; count from 0; choose above whether Positions are counted from 0 or 1"),
    (
        counted,
        {"first": "1"},
        "correct the number of the first position; choose above whether Positions are counted from 0 or 1",
    ),
    (two_lists, {}, "expected one, got stage.csv, stage2.csv; choose the right one; choose the List above"),
    (empty, {}, "expected images (TIFF, PNG, NPY, RAW …), got none; name the folder that contains them"),
    (unlike, {}, "; choose the List above, type the pattern of Names above, or choose their Order above"),
    (
        long_exposures,
        {},
        "state the unit in the contents of the columns; choose the content above the column",
    ),
    (
        lambda p: recorded(p, ("file", "X (mm)", "Y", "Z (mm)")),
        {},
        "got none; choose the content above the column",
    ),
    (
        lambda p: recorded(p, ("file", "X", "Y", "other")),
        {},
        "got none; state which column is z; choose the content above the column",
    ),
]


@pytest.mark.parametrize(("made", "choice", "end"), CASES)
def test_a_problem_ends_with_what_to_do_in_the_window(
    tmp_path: Path, made: Callable[[Path], str], choice: dict[str, str], end: str
) -> None:
    found = survey(ImportChoice(made(tmp_path / "s"), **choice), plan(), None)
    assert found.problem.endswith(end)
    for word in ("--", "lfcal ", "first=", "MANIFEST", "CAMERA"):
        assert word not in found.problem


@pytest.mark.parametrize("made", [empty, two_lists])
def test_what_is_wrong_with_the_frames_is_said_before_a_plan_is_asked_for(
    tmp_path: Path, made: Callable[[Path], str]
) -> None:
    found = survey(ImportChoice(made(tmp_path / "s")), None, None)
    assert "plan" not in found.problem and found.problem


def test_a_list_of_the_stage_without_camera_and_plan_asks_for_them(tmp_path: Path) -> None:
    found = survey(ImportChoice(recorded(tmp_path / "s")), None, None)
    assert found.problem.endswith("got none; choose the camera, or make the plan of the scan, in Set up")


def test_the_unit_that_z_seems_to_have_is_named_in_the_window(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "s", ("file", "X (mm)", "Y (mm)", "Z (um)"))
    found = survey(ImportChoice(folder), None, scan().camera)
    assert found.problem.endswith("is z in mm? state its unit; choose the content above the column")


def test_what_is_known_of_found_depths_stays_in_the_window(tmp_path: Path) -> None:
    found = survey(ImportChoice(recorded(tmp_path / "s")), None, scan().camera)
    (depths,) = {said_in_window(note) for note in found.notes if note.startswith("depths: inferred")}
    assert "for all" in depths and "--" not in depths
    found.close()


def test_another_camera_s_scan_is_refused_in_the_window_s_words(tmp_path: Path) -> None:
    camera: Camera = preset("bench")
    small = ScanPlan(scan().camera, (3, 2), (9, 11), scan().depths, (18.0, 21.0))
    found = survey(ImportChoice(recorded(tmp_path / "s")), small, camera)
    assert "another scan" in found.problem
    assert found.problem.endswith("choose the camera, or make the plan of the scan, in Set up")
