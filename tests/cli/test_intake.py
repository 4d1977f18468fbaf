"""Frames that others recorded: lists of the stage, orientation, and what is said of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.camera import Camera
from lfcal.psf import open_psf
from lfcal.tasks._scan_frames import note_size
from tests.cli.conftest import Lfcal, Run
from tests.frames.lists.scans import COLUMNS, ROWS, SENSOR, Scan, scan, small_camera, write_frames


# -- Frames that others recorded, with a list of the stage and a camera --
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


def test_a_list_of_the_stage_and_a_camera_lead_to_h(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    plan, out = tmp_path / "plan.json", tmp_path / "H.h5"
    done = lfcal(*of_positions(folder, folder / "stage.csv"), "-o", plan).ok()
    assert "columns: file=Bild, z=Pos Z (mm), y=" in done.err and "decimal commas" in done.err
    said = "axes: -y,+x,-z move the image right and down and the source away, inferred from the motion of the light"
    assert said in done.err and "anchor: row 18, column 21" in done.err
    listed = ("--manifest", folder / "stage.csv", "--columns", "file=Bild", "--black-level", "100")
    done = lfcal("assemble", folder / "tiffs", "-p", plan, *listed, "-o", out).ok()
    assert "px rms from the grid" in done.err and "the motion of the light agrees" in done.err
    with open_psf(out) as matrix:
        H = np.asarray(matrix)
        assert matrix.provenance["intake"], "what was guessed is kept with H"
    assert H.shape == (2, ROWS, COLUMNS, 9, 11)
    # every cutout has the same spot in its middle: no frame is at the position of another
    assert all(np.unravel_index(cut.argmax(), cut.shape) == (4, 5) for cut in H.reshape(-1, 9, 11))


def test_wrong_axes_of_a_plan_are_corrected_and_named(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    plan, out = tmp_path / "plan.json", tmp_path / "H.h5"
    words = ("--depths=-40mm,10mm", "--cutout", "9,11", "--anchor", "18,21")
    lfcal("plan", folder / "camera.json", *words, "-o", plan).ok()
    listed = ("--manifest", folder / "stage.csv", "--columns", "file=1,exposure_ms=5")
    done = lfcal("assemble", folder / "tiffs", "-p", plan, *listed, "--black-level", "100", "-o", out).ok()
    assert "axes: -y,+x,-z move the image right" in done.err and "the plan states +x,+y,+z" in done.err
    with open_psf(out) as matrix:
        assert np.unravel_index(np.asarray(matrix)[0, 0, 0].argmax(), (9, 11)) == (4, 5)


def test_what_a_list_lacks_is_named(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    words = ("plan", folder / "camera.json", "--positions", folder / "stage.csv")
    lfcal(*words).refused("column of file", "--columns file=COLUMN")
    done = lfcal(*words, "--columns", "file=Bild").ok()
    assert "choose their folder (--frames)" in done.err and "state the stage axes if they differ (--stage)" in done.err
    lfcal(*words, "--columns", "file=Bild", "--frames", tmp_path / "none").refused()


def test_names_that_count_from_one(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    frames = session / "frames"
    (frames / "manifest.csv").unlink()
    for z, y, x in np.ndindex(2, 3, 4):
        (frames / f"z{z}_y{y}_x{x}.png").rename(frames / f"img_x{x + 1:03d}_y{y + 1:03d}_z{z + 1}.png")
    done = lfcal("assemble", frames, "-o", tmp_path / "a.h5", "--json").ok()
    assert "read as --pattern 'img_x{x}_y{y}_z{z}.png'" in done.err and "counted from 1" in done.err
    assert done.json["frames"] == 24, "notes do not disturb it"
    words = ("assemble", frames, "--pattern", "img_x{x}_y{y}_z{z}.png", "--first")
    assert "counted from" not in lfcal(*words, "1", "-o", tmp_path / "b.h5").ok().err
    with open_psf(tmp_path / "a.h5") as a, open_psf(tmp_path / "b.h5") as b:
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))
    lfcal(*words, "0", "-o", tmp_path / "c.h5").refused("expected 0 … ")


def test_left_aligned_samples(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    for path in (*(session / "frames").glob("*.png"), *(session / "dark").glob("*.png")):
        frame = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), (frame // 16).astype(np.uint16) << 4)
    words = ("assemble", session / "frames", "--dark", session / "dark", "--force", "-o", tmp_path / "a.h5")
    assert "multiples of 16; shift them down (--shift auto)" in lfcal(*words).ok().err
    assert "left-aligned, shifted down to 12 bits" in lfcal(*words, "--shift", "auto").ok().err
    lfcal(*words, "--shift", "high").refused("auto or a number of bits")


def of_positions(folder: Path, listed: Path, frames: Path | None = None) -> tuple[object, ...]:
    """Return the words of ``lfcal plan`` for a list of the foreign folder."""
    named = ("--positions", listed, "--frames", frames or folder / "tiffs", "--columns", "file=Bild")
    return ("plan", folder / "camera.json", *named, "--cutout", "9,11")


def test_a_list_as_spreadsheets_save_it(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    """The usual CSV of a spreadsheet is not UTF-8: umlauts and the micro sign are single bytes, or all are two."""
    text = (folder / "stage.csv").read_text("utf-8-sig").replace("Pos Z (mm)", "Pos Z (mm);Prüfer")
    head, *rows = text.splitlines()
    rows = [";".join([*row.split(";")[:4], "Müller µ", *row.split(";")[4:]]) for row in rows]
    for encoding in ("cp1252", "utf-16", "utf-8"):
        (tmp_path / "Tisch.csv").write_bytes("\r\n".join([head, *rows]).encode(encoding))
        assert "anchor: row 18, column 21" in lfcal(*of_positions(folder, tmp_path / "Tisch.csv")).ok().err, encoding


def test_letters_that_another_system_writes_in_two_parts(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    """A name with an umlaut is one name, composed in the list and decomposed on the disk."""
    frames = tmp_path / "Bilder vom Prüfstand"
    frames.mkdir()
    text = (folder / "stage.csv").read_text("utf-8-sig").replace("shot", "Prüfling ")
    (tmp_path / "stage.csv").write_text(text, encoding="utf-8")
    for path in (folder / "tiffs").iterdir():
        (frames / path.name.replace("shot", "Pru\u0308fling ")).write_bytes(path.read_bytes())
    lfcal(*of_positions(folder, tmp_path / "stage.csv", frames)).ok()


def test_rows_that_are_wrong_are_named(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    rows = (folder / "stage.csv").read_text("utf-8-sig").splitlines()
    listed = tmp_path / "stage.csv"
    for lines, said in (
        ([*rows[:5], rows[4], *rows[5:]], ("rows of shot003.tif: expected one, got 2",)),
        ([*rows[:5], rows[4].rsplit(";", 4)[0] + ";" + rows[5].split(";", 1)[1], *rows[6:]], ("rows of shot003.tif",)),
        (rows[:1], ("only a header",)),
        ([*rows, "shot999;1,0;2,0;3,0;20"], ("'shot999' is not in",)),
        ([*rows[:5], rows[5].replace(rows[5].split(";")[1], "NaN"), *rows[6:]], ("line 6, Pos X (mm)", "'NaN'")),
    ):
        listed.write_text("\n".join(lines), encoding="utf-8")
        lfcal(*of_positions(folder, listed)).refused(*said)


def test_colour_images_show_where_the_light_is(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    frames, plan = tmp_path / "rgb", tmp_path / "plan.json"
    frames.mkdir()
    for path in (folder / "tiffs").iterdir():
        grey = tifffile.imread(path)
        tifffile.imwrite(frames / path.name, np.stack([grey // 2, grey, grey // 3], -1), photometric="rgb")
    done = lfcal(*of_positions(folder, folder / "stage.csv", frames), "-o", plan).ok()
    assert "anchor: row 18, column 21" in done.err and "the colour G of the colour images is used" in done.err
    listed = ("--manifest", folder / "stage.csv", "--columns", "file=Bild", "--plan", plan, "--black-level", "100")
    wrong = lfcal("assemble", frames, *listed, "-o", tmp_path / "H.h5").refused("--channel G", "--channel each")
    assert "colour=" not in wrong.err
    lfcal("assemble", frames, *listed, "-o", tmp_path / "H.h5", "--channel", "G").ok()


def test_frames_of_a_part_of_the_sensor_need_their_origin(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    frames, plan = tmp_path / "cut", tmp_path / "plan.json"
    frames.mkdir()
    for path in (folder / "tiffs").iterdir():
        tifffile.imwrite(frames / path.name, tifffile.imread(path)[5:-2, 6:])
    words = (*of_positions(folder, folder / "stage.csv", frames), "-o", plan)
    lfcal(*words).refused("whole sensor, 40 x 48 px, got 33 x 42 px", "--origin ROW,COLUMN")
    lfcal(*words, "--origin", "5,9").refused("on the sensor of 40 x 48 px, got 5,9 for frames of 33 x 42 px")
    lfcal(*words, "--origin", "five").refused()
    assert not plan.exists() and "anchor: row 18, column 21" in lfcal(*words, "--origin", "5,6").ok().err
    listed = ("--manifest", folder / "stage.csv", "--columns", "file=Bild", "--plan", plan, "--black-level", "100")
    words = ("assemble", frames, *listed, "-o", tmp_path / "a.h5")
    lfcal(*words).refused("first pixel is row 5, column 6", "--origin 5,6")
    lfcal(*words, "--origin", "5,6").ok()
    lfcal("assemble", folder / "tiffs", *listed, "-o", tmp_path / "b.h5").ok()
    with open_psf(tmp_path / "a.h5") as part, open_psf(tmp_path / "b.h5") as whole:
        np.testing.assert_array_equal(part[0], whole[0])


def test_options_of_a_list_need_one(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    for words in (("--frames", folder / "tiffs"), ("--columns", "x=1"), ("--orientation", "rot90")):
        done = lfcal("plan", folder / "camera.json", "--depths=-40mm", *words)
        done.refused(f"{words[0]}: expected a recorded scan (--positions)")
    plan, out = tmp_path / "plan.json", tmp_path / "H.h5"
    lfcal(*of_positions(folder, folder / "stage.csv"), "-o", plan).ok()
    (tmp_path / "empty").mkdir()
    lfcal("assemble", tmp_path / "empty", "--plan", plan, "-o", out).refused("expected images", "got none")
    lfcal("assemble", folder / "tiffs", "--plan", plan, "-o", out).refused("--manifest LIST")


# -- What ``lfcal plan --positions`` and ``lfcal assemble`` say of lists and of frames that are not the camera's --
def test_binned_frames_need_a_camera_of_larger_pixels(caplog: pytest.LogCaptureFixture) -> None:
    twice = "this suggests binning of 2 x 2"
    for shape, words in (
        ((20, 24), f"{twice}. If the frames are binned, create a camera file with the binned pixels"),
        ((24, 20), twice),
        ((13, 16), "this suggests binning of 3 x 3"),
        ((10, 12), "this suggests binning of 4 x 4"),
        ((20, 40), "--frame FRAME"),
        ((38, 44), "--frame FRAME"),
    ):
        caplog.clear()
        note_size(shape, small_camera())
        assert words in caplog.text and ("--frame" in caplog.text) != ("--sensor" in caplog.text), shape


def test_the_advice_for_binned_frames_makes_their_camera(
    lfcal: Lfcal, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    camera = small_camera()
    (tmp_path / "camera.json").write_text(camera.to_json())
    note_size((SENSOR[0] // 2, SENSOR[1] // 2), camera)
    said = caplog.text
    words = said[said.index("camera import") : said.index("BINNED,")].split()
    names = {"CAMERA": tmp_path / "camera.json"}
    lfcal(*(names.get(word, word) for word in words), tmp_path / "binned.json").ok()
    binned = Camera.from_json((tmp_path / "binned.json").read_text())
    assert binned.sensor.shape == (SENSOR[0] // 2, SENSOR[1] // 2)
    np.testing.assert_allclose(binned.period_px, np.array(camera.period_px) / 2, rtol=1e-4)
    assert binned.step_um(0.0) == pytest.approx(2 * camera.step_um(0.0), rel=1e-4)


def test_a_list_that_numbers_its_planes_and_one_of_a_wrong_z(lfcal: Lfcal, tmp_path: Path) -> None:
    found = scan()
    names = [f"shot{k:03d}.tif" for k in range(len(found.stage))]
    write_frames(tmp_path / "tiffs", found, names)
    (tmp_path / "camera.json").write_text(found.camera.to_json())

    def listed(name: str, header: str, last: np.ndarray) -> Path:
        rows = [f"{file},{x:.3f},{y:.3f},{z:g}" for file, (x, y, _), z in zip(names, found.stage, last, strict=True)]
        (tmp_path / name).write_text("\n".join([f"file,x_um,y_um,{header}", *rows]))
        return tmp_path / name

    def plan(path: Path) -> Run:
        named = ("--positions", path, "--frames", tmp_path / "tiffs", "--cutout", "9,11")
        return lfcal("plan", tmp_path / "camera.json", *named, "-o", tmp_path / f"{path.stem}.json")

    def assemble(path: Path) -> Run:
        named = ("--manifest", path, "-p", tmp_path / "numbered.json", "--black-level", "100")
        return lfcal("assemble", tmp_path / "tiffs", *named, "-o", tmp_path / f"{path.stem}.h5")

    numbered = listed("numbered.csv", "plane", found.positions[:, 0] + 1)
    assert "z=plane (index)" in plan(numbered).ok().err
    assemble(numbered).ok()
    longer = listed("longer.csv", "z_um", 1.8 * found.stage[:, 2])
    done = plan(longer).ok()
    assert "its range is 1.8" in done.err and "z and the steps disagree" in done.err
    assert "are 1.8" in assemble(longer).ok().err
    said = "z of the planes: expected the spacing of the planned planes, got 0.001"
    assemble(listed("thousand.csv", "z_um", found.stage[:, 2] / 1e3)).refused(said)
