"""Frames that others recorded become H with what lies beside them: a list of the stage, a camera, four commands."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

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
    assert "axes: -y,+x,-z move the image right, down and the source away, as the light moves" in done.err
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
    assert "places: " in done.err and "px rms off the grid" in done.err and "the light agrees" in done.err
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
    assert "axes: -y,+x,-z move the image right" in done.err and "the plan says +x,+y,+z" in done.err
    with open_psf(out) as matrix:
        assert np.unravel_index(np.asarray(matrix)[0, 0, 0].argmax(), (9, 11)) == (4, 5)


def test_what_goes_wrong_is_one_line(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    done = lfcal("plan", folder / "camera.json", "--positions", folder / "stage.csv")
    assert done.code == 2 and "column of file" in done.err and "--columns file=COLUMN" in done.err
    done = lfcal("plan", folder / "camera.json", "--positions", folder / "stage.csv", "--columns", "file=Bild")
    assert done.code == 0 and "--frames names their folder" in done.err and "--stage states them" in done.err
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
    told = [line for line in done.err.splitlines() if "warning: " not in line]
    assert done.code == 2 and len(told) == 1


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
    assert proposed.code == 0 and "multiples of 16; --shift auto" in proposed.err
    done = lfcal(*arguments, "-o", tmp_path / "b.h5", "--shift", "auto")
    assert done.code == 0 and "left-aligned, moved down by 4 to 12 bits" in done.err
    wrong = lfcal(*arguments, "-o", tmp_path / "c.h5", "--shift", "high")
    assert wrong.code == 2 and "auto or a number of bits" in wrong.err
