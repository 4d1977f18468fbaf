"""Frames that others recorded become H with what lies beside them: a list of the stage, a camera, four commands."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.psf import open_psf
from tests.cli.conftest import Run
from tests.frames.lists.scans import COLUMNS, ROWS, Scan, scan, write_frames


def foreign_list(path: Path, found: Scan, names: list[str]) -> None:
    """Write a list as a spreadsheet of the continent does: semicolons, decimal commas, millimetres, its own names."""
    rows = ["Bild;Pos X (mm);Pos Y (mm);Pos Z (mm);Exp. (ms)"]
    for name, place in zip(names, found.stage / 1e3, strict=True):
        numbers = [f"{value:.6f}".replace(".", ",") for value in place]
        rows.append(";".join([f"D:\\Messung\\{name.removesuffix('.tif')}", *numbers, "20"]))
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(rows).encode())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of TIFFs of a stage that is mounted turned round, with its list; order is no help."""
    root = tmp_path_factory.mktemp("foreign")
    found = scan(right="-y", down="+x", away="-z", origin=(5300.0, 1200.0, -80.0))
    order = np.random.default_rng(3).permutation(len(found.stage))
    found = Scan(found.camera, found.depths, found.positions[order], found.stage[order])
    names = [f"shot{k:03d}.tif" for k in range(len(order))]
    write_frames(root / "tiffs", found, names)
    foreign_list(root / "stage.csv", found, names)
    (root / "camera.json").write_text(found.camera.to_json())
    return root


def h_of_newcomer(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> Path:
    """Run plan and assemble as a newcomer would, and return H."""
    columns = "file=Bild"
    plan, out = tmp_path / "plan.json", tmp_path / "H.h5"
    listed = ("--positions", folder / "stage.csv", "--frames", folder / "tiffs", "--columns", columns)
    done = lfcal("plan", folder / "camera.json", *listed, "--cutout", "9,11", "-o", plan)
    assert done.code == 0, done.err
    assert "columns: file=Bild, z=Pos Z (mm), y=" in done.err and "decimal commas" in done.err
    assert (
        "axes: -y,+x,-z move the image right and down and the source away, inferred from the motion of the light"
    ) in done.err
    assert "anchor: row 18, column 21" in done.err
    done = lfcal(
        "assemble",
        folder / "tiffs",
        "-p",
        plan,
        "--manifest",
        folder / "stage.csv",
        "--columns",
        columns,
        "--black-level",
        "100",
        "-o",
        out,
    )
    assert done.code == 0, done.err
    assert "px rms from the grid" in done.err and "the motion of the light agrees" in done.err
    return out


def test_a_newcomer_reaches_h(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    out = h_of_newcomer(lfcal, folder, tmp_path)
    with open_psf(out) as matrix:
        H = np.asarray(matrix)
        assert matrix.provenance["intake"], "what was guessed is kept with H"
    assert H.shape == (2, ROWS, COLUMNS, 9, 11)
    # every cutout holds the same spot in its middle: no frame is at another's position
    assert all(np.unravel_index(cut.argmax(), cut.shape) == (4, 5) for cut in H.reshape(-1, 9, 11))


@pytest.mark.long
def test_a_newcomer_reaches_the_report(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    done = lfcal("inspect", h_of_newcomer(lfcal, folder, tmp_path), "--report", tmp_path / "report")
    assert done.code == 0, done.err


def test_a_plan_that_puts_the_axes_wrong_is_corrected_and_it_is_said(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path
) -> None:
    plan, out = tmp_path / "plan.json", tmp_path / "H.h5"
    done = lfcal(
        "plan", folder / "camera.json", "--depths=-40mm,10mm", "--cutout", "9,11", "--anchor", "18,21", "-o", plan
    )
    assert done.code == 0, done.err
    listed = ("--manifest", folder / "stage.csv", "--columns", "file=1,exposure_ms=5")
    done = lfcal("assemble", folder / "tiffs", "-p", plan, *listed, "--black-level", "100", "-o", out)
    assert done.code == 0, done.err
    assert "axes: -y,+x,-z move the image right" in done.err and "the plan states +x,+y,+z" in done.err
    with open_psf(out) as matrix:
        assert np.unravel_index(np.asarray(matrix)[0, 0, 0].argmax(), (9, 11)) == (4, 5)


def test_what_goes_wrong_is_one_line(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    done = lfcal("plan", folder / "camera.json", "--positions", folder / "stage.csv")
    assert done.code == 2 and "column of file" in done.err and "--columns file=COLUMN" in done.err
    done = lfcal("plan", folder / "camera.json", "--positions", folder / "stage.csv", "--columns", "file=Bild")
    assert (
        done.code == 0
        and "choose their folder (--frames)" in done.err
        and "state the stage axes if they differ (--stage)" in done.err
    )
    missing = tmp_path / "none"
    done = lfcal(
        "plan",
        folder / "camera.json",
        "--positions",
        folder / "stage.csv",
        "--columns",
        "file=Bild",
        "--frames",
        missing,
    )
    # the small camera of the test draws a warning of its own
    assert done.code == 2 and len([line for line in done.err.splitlines() if "warning" not in line]) == 1


def test_names_that_count_from_one(lfcal: Callable[..., Run], session: Path, tmp_path: Path) -> None:
    frames = session / "frames"
    (frames / "manifest.csv").unlink()
    for z, y, x in np.ndindex(2, 3, 4):
        (frames / f"z{z}_y{y}_x{x}.png").rename(frames / f"img_x{x + 1:03d}_y{y + 1:03d}_z{z + 1}.png")
    done = lfcal("assemble", frames, "-o", tmp_path / "a.h5")
    assert done.code == 0, done.err
    assert "read as --pattern 'img_x{x}_y{y}_z{z}.png'" in done.err and "counted from 1" in done.err
    said = lfcal("assemble", frames, "--pattern", "img_x{x}_y{y}_z{z}.png", "--first", "1", "-o", tmp_path / "b.h5")
    assert said.code == 0 and "counted from" not in said.err
    with open_psf(tmp_path / "a.h5") as a, open_psf(tmp_path / "b.h5") as b:
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))
    wrong = lfcal("assemble", frames, "--pattern", "img_x{x}_y{y}_z{z}.png", "--first", "0", "-o", tmp_path / "c.h5")
    assert wrong.code == 2 and "expected 0 … " in wrong.err


def test_notes_do_not_disturb_json(lfcal: Callable[..., Run], session: Path, tmp_path: Path) -> None:
    (session / "frames" / "manifest.csv").unlink()
    done = lfcal("assemble", session / "frames", "-o", tmp_path / "a.h5", "--json")
    assert json.loads(done.out)["frames"] == 24


def test_left_aligned_samples(lfcal: Callable[..., Run], session: Path, tmp_path: Path) -> None:
    for path in (*(session / "frames").glob("*.png"), *(session / "dark").glob("*.png")):
        frame = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), (frame // 16).astype(np.uint16) << 4)
    arguments = ("assemble", session / "frames", "--dark", session / "dark")
    proposed = lfcal(*arguments, "-o", tmp_path / "a.h5")
    assert proposed.code == 0 and "multiples of 16; shift them down (--shift auto)" in proposed.err
    done = lfcal(*arguments, "-o", tmp_path / "b.h5", "--shift", "auto")
    assert done.code == 0 and "left-aligned, shifted down to 12 bits" in done.err
    wrong = lfcal(*arguments, "-o", tmp_path / "c.h5", "--shift", "high")
    assert wrong.code == 2 and "auto or a number of bits" in wrong.err


def of_positions(folder: Path, listed: Path, frames: Path | None = None) -> tuple[object, ...]:
    """Return the words of ``lfcal plan`` for a list of the foreign folder."""
    named = ("--positions", listed, "--frames", frames or folder / "tiffs", "--columns", "file=Bild")
    return ("plan", folder / "camera.json", *named, "--cutout", "9,11")


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16", "utf-8"])
def test_a_list_as_spreadsheets_save_it(lfcal: Callable[..., Run], folder: Path, tmp_path: Path, encoding: str) -> None:
    """The usual CSV of a spreadsheet is no UTF-8: umlauts and the micro sign are single bytes, or all are two."""
    listed = tmp_path / "Tisch.csv"
    text = (folder / "stage.csv").read_text("utf-8-sig").replace("Pos Z (mm)", "Pos Z (mm);Prüfer")
    head, *rows = text.splitlines()
    rows = [";".join([*row.split(";")[:4], "Müller µ", *row.split(";")[4:]]) for row in rows]
    listed.write_bytes("\r\n".join([head, *rows]).encode(encoding))
    done = lfcal(*of_positions(folder, listed))
    assert done.code == 0, done.err
    assert "anchor: row 18, column 21" in done.err


def test_letters_that_another_system_writes_in_two_parts(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path
) -> None:
    """A name with an umlaut is one name, composed in the list and decomposed on the disk."""
    frames = tmp_path / "Bilder vom Prüfstand"
    frames.mkdir()
    text = (folder / "stage.csv").read_text("utf-8-sig").replace("shot", "Prüfling ")
    (tmp_path / "stage.csv").write_text(text, encoding="utf-8")
    for path in (folder / "tiffs").iterdir():
        (frames / path.name.replace("shot", "Pru\u0308fling ")).write_bytes(path.read_bytes())
    done = lfcal(*of_positions(folder, tmp_path / "stage.csv", frames))
    assert done.code == 0, done.err


def test_rows_that_are_wrong_are_named(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    rows = (folder / "stage.csv").read_text("utf-8-sig").splitlines()
    listed = tmp_path / "stage.csv"
    for lines, words in (
        ([*rows[:5], rows[4], *rows[5:]], ("rows of shot003.tif: expected one, got 2",)),
        ([*rows[:5], rows[4].rsplit(";", 4)[0] + ";" + rows[5].split(";", 1)[1], *rows[6:]], ("rows of shot003.tif",)),
        (rows[:1], ("only a header",)),
        ([*rows, "shot999;1,0;2,0;3,0;20"], ("'shot999' is not in",)),
        ([*rows[:5], rows[5].replace(rows[5].split(";")[1], "NaN"), *rows[6:]], ("line 6, Pos X (mm)", "'NaN'")),
    ):
        listed.write_text("\n".join(lines), encoding="utf-8")
        done = lfcal(*of_positions(folder, listed))
        errors = [line for line in done.err.splitlines() if "warning" not in line and "note" not in line]
        assert done.code == 2 and len(errors) == 1, done.err
        assert all(word in errors[0] for word in words), errors[0]


def test_colour_pictures_tell_where_the_light_is(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    frames = tmp_path / "rgb"
    frames.mkdir()
    for path in (folder / "tiffs").iterdir():
        grey = tifffile.imread(path)
        tifffile.imwrite(frames / path.name, np.stack([grey // 2, grey, grey // 3], -1), photometric="rgb")
    plan = tmp_path / "plan.json"
    done = lfcal(*of_positions(folder, folder / "stage.csv", frames), "-o", plan)
    assert done.code == 0, done.err
    assert "anchor: row 18, column 21" in done.err and "the colour G of the colour images is used" in done.err
    listed = ("--manifest", folder / "stage.csv", "--columns", "file=Bild", "--plan", plan, "--black-level", "100")
    wrong = lfcal("assemble", frames, *listed, "-o", tmp_path / "H.h5")
    assert wrong.code == 2 and "--channel G" in wrong.err and "--channel each" in wrong.err
    assert "colour=" not in wrong.err
    done = lfcal("assemble", frames, *listed, "-o", tmp_path / "H.h5", "--channel", "G")
    assert done.code == 0, done.err


def test_frames_of_a_part_of_the_sensor_need_their_origin(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path
) -> None:
    frames, plan = tmp_path / "cut", tmp_path / "plan.json"
    frames.mkdir()
    for path in (folder / "tiffs").iterdir():
        tifffile.imwrite(frames / path.name, tifffile.imread(path)[5:-2, 6:])
    words = of_positions(folder, folder / "stage.csv", frames)
    done = lfcal(*words, "-o", plan)
    assert done.code == 2 and not plan.exists()
    assert "whole sensor, 40 x 48 px, got 33 x 42 px" in done.err and "--origin ROW,COLUMN" in done.err
    done = lfcal(*words, "--origin", "5,9", "-o", plan)
    assert done.code == 2 and "on the sensor of 40 x 48 px, got 5,9 for frames of 33 x 42 px" in done.err
    assert lfcal(*words, "--origin", "five", "-o", plan).code == 2
    done = lfcal(*words, "--origin", "5,6", "-o", plan)
    assert done.code == 0 and "anchor: row 18, column 21" in done.err, done.err
    listed = ("--manifest", folder / "stage.csv", "--columns", "file=Bild", "--plan", plan, "--black-level", "100")
    done = lfcal("assemble", frames, *listed, "-o", tmp_path / "a.h5")
    assert done.code == 2 and "first pixel is row 5, column 6" in done.err and "--origin 5,6" in done.err
    done = lfcal("assemble", frames, *listed, "-o", tmp_path / "a.h5", "--origin", "5,6")
    assert done.code == 0, done.err
    assert lfcal("assemble", folder / "tiffs", *listed, "-o", tmp_path / "b.h5").code == 0
    with open_psf(tmp_path / "a.h5") as part, open_psf(tmp_path / "b.h5") as whole:
        np.testing.assert_array_equal(part[0], whole[0])


def test_options_of_a_list_need_one(lfcal: Callable[..., Run], folder: Path) -> None:
    camera = ("plan", folder / "camera.json", "--depths=-40mm")
    for words in (("--frames", folder / "tiffs"), ("--columns", "x=1"), ("--orientation", "rot90")):
        done = lfcal(*camera, *words)
        assert done.code == 2 and f"{words[0]}: expected a recorded scan (--positions)" in done.err
    done = lfcal(*of_positions(folder, folder / "stage.csv"), "--average", "2")
    assert done.code == 2 and "--average" in done.err


def test_folders_without_a_list_or_frames(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    plan = tmp_path / "plan.json"
    assert lfcal(*of_positions(folder, folder / "stage.csv"), "-o", plan).code == 0
    done = lfcal("assemble", tmp_path / "empty", "--plan", plan, "-o", tmp_path / "H.h5")
    assert done.code == 2 and "expected images" in done.err and "got none" in done.err
    done = lfcal("assemble", folder / "tiffs", "--plan", plan, "-o", tmp_path / "H.h5")
    assert done.code == 2 and "--manifest LIST" in done.err
