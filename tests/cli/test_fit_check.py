"""``lfcal fit check``: whether an old H still holds, as a user asks it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.psf import PSFMatrix, save
from tests.cli.conftest import Run
from tests.judge.test_check import AT, changed, new_frame, plan_of, setup_of, values

Lfcal = Callable[..., Run]
NOISE = ("--noise", "64,1")


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kept")
    save(told(), folder / "old.h5")
    write(folder / "same.tif", new_frame(setup_of(plan_of())))
    return folder


@pytest.fixture
def place(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(kept, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def told(camera: bool = True) -> PSFMatrix:
    """Return the old H with a sensor that has room for the frames, and states its noise."""
    plan = plan_of()
    sensor = replace(plan.camera.sensor, bit_depth=16, full_well_e=65535.0, read_noise_e=8.0, black_level=100.0)
    own = replace(plan.camera, sensor=sensor) if camera else None
    return PSFMatrix(values(), depths=plan.depths_um, camera=own, anchor=plan.anchor)


def write(path: Path, frame: np.ndarray) -> None:
    tifffile.imwrite(path, np.clip(np.rint(frame + 70), 0, 65535).astype(np.uint16))


def check(lfcal: Lfcal, *words: object) -> Run:
    return lfcal("fit", "check", *words, *NOISE, "--black-level", 100)


@pytest.mark.long
def test_h_holds_for_a_frame_of_the_same_camera(lfcal: Lfcal, place: Path) -> None:
    run = check(lfcal, "old.h5", "same.tif")
    assert run.code == 0 and f"0, {AT[0]}, {AT[1]}" in run.out, run.err
    assert "holds: This H is confirmed by the frames: error below" in run.out
    assert run.err == "lfcal: note: noise: as stated\n"
    assert {path.name for path in place.iterdir()} == {"old.h5", "same.tif"}, "nothing is written"


def test_what_has_changed_is_named_and_ends_with_1(lfcal: Lfcal, place: Path) -> None:
    lattice = plan_of().camera.lattice
    for k in range(2):
        write(place / f"new{k}.tif", new_frame(changed(gap_um=1.01 * lattice.gap_um), seed=k))
    run = check(lfcal, "old.h5", "new0.tif")
    words = "does not hold: This H should not be used as it is: error of H beyond its limit, gap of the array"
    assert run.code == 1 and words in run.out
    found = check(lfcal, "old.h5", "new0.tif", "new1.tif", "--json").json
    assert isinstance(found, dict) and found["answer"] == "does not hold" and len(found["frames"]) == 2
    gap = found["suspects"][0]["values"][0]
    assert gap["name"] == "gap_um" and abs(gap["change"] - 0.01 * lattice.gap_um) < 4 * gap["sigma"]
    assert found["frames"][0]["position"] == [0, *AT] and abs(found["frames"][0]["background"]) < 3
    # a limit beyond the change
    assert check(lfcal, "old.h5", "new0.tif", "--limit", "20%").code == 0


@pytest.mark.long
def test_frames_of_a_folder_with_a_plan_are_held_at_their_places(lfcal: Lfcal, place: Path) -> None:
    """A plan of another anchor: its positions are those of H that lie at the same pixels."""
    plan = plan_of()
    camera = told().camera
    assert camera is not None
    later = replace(plan, camera=camera, anchor=(plan.anchor[0] + 2, plan.anchor[1] + 1), period=(3, 5))
    (place / "scan").mkdir()
    (place / "scan" / "plan.json").write_text(later.to_json())
    for k, (y, x) in enumerate(((2, 4), (2, 4))):
        name = f"z0_y{y - k}_x{x - k}.png"
        moved = np.roll(new_frame(setup_of(plan), seed=k), (-k, -k), (0, 1))
        # the pattern of (4, 5) of H lies at (2, 4) of this plan; the other frame is not what its name says
        cv2.imwrite(str(place / "scan" / name), np.rint(moved + 70).astype(np.uint16))
    run = check(lfcal, "old.h5", "scan", "--orientation", "as-is", "--positions", 0, "--json")
    found = run.json
    assert isinstance(found, dict), run.err
    frames = {one["label"]: one for one in found["frames"]}
    right = frames["z0_y2_x4.png"]
    assert right["position"] == [0, *AT] and right["chi2"] < 1.3 and np.abs(right["beside_px"]).max() < 0.05
    assert frames["z0_y1_x3.png"]["chi2"] > 2
    deeper = replace(later, depths_um=(1.2 * later.depths_um[0],))
    (place / "scan" / "plan.json").write_text(deeper.to_json())
    run = check(lfcal, "old.h5", "scan", "--orientation", "as-is")
    assert run.code == 2 and "depth: expected a depth of H" in run.err and run.err.count("\n") <= 2, run.err


def test_frames_that_state_no_position_are_named_one_by_one(lfcal: Lfcal, place: Path) -> None:
    for folder in (place / "scan", place / "below" / "frames"):
        folder.mkdir(parents=True)
    for name in (
        "scan/image_0.tif",
        "scan/image_1.tif",
        "below/frames/z0_y4_x5.tif",
        "below/frames/z0_y3_x4.tif",
        "below/dark.tif",
    ):
        shutil.copy(place / "same.tif", place / name)
    for name in ("scan", "below"):
        (place / name / "plan.json").write_text(plan_of().to_json())
    run = check(lfcal, "old.h5", "scan")
    assert "give the files of single frames instead of scan, because the positions of their sources" in run.err, run.err
    # none of these is an option here
    assert run.code == 2 and not any(option in run.err for option in ("--manifest", "--order", "--pattern"))
    nested = check(lfcal, "old.h5", "below").err
    assert "run lfcal fit check old.h5 below/frames" in nested, nested


@pytest.mark.long
def test_a_name_that_says_the_place_is_used(lfcal: Lfcal, place: Path) -> None:
    write(place / "z0_y4_x5.tif", new_frame(setup_of(plan_of()), (0.3, 0.0)))
    run = check(lfcal, "old.h5", "z0_y4_x5.tif")
    assert run.code == 0 and "sources are displaced by" in run.err, run.err
    write(place / "z0_y0_x0.tif", new_frame(setup_of(plan_of())))
    elsewhere = check(lfcal, "old.h5", "z0_y0_x0.tif")
    assert elsewhere.code == 0 and f"0, {AT[0]}, {AT[1]}" in elsewhere.out


def test_an_h_without_a_camera_gives_numbers(lfcal: Lfcal, place: Path) -> None:
    save(told(camera=False), place / "bare.h5")
    run = check(lfcal, "bare.h5", "same.tif")
    assert run.code == 0 and "the camera of H is unknown" in run.err, run.err
    # whose samples' photons nobody can count
    bare = lfcal("fit", "check", "bare.h5", "same.tif", "--black-level", 100)
    assert bare.code in (0, 1) and "the photon noise is unknown" in bare.err and "does not hold" not in bare.out


def _text(path: Path) -> None:
    path.write_text("no picture")


def _dark(path: Path) -> None:
    rng = np.random.default_rng(0)
    write(path, 30 + 8 * rng.standard_normal((120, 120)))


def _small(path: Path) -> None:
    write(path, new_frame(setup_of(plan_of()))[:100])


def _one_value(path: Path) -> None:
    tifffile.imwrite(path, np.full((120, 120), 100, np.uint16))


def _nan(path: Path) -> None:
    tifffile.imwrite(path, np.full((120, 120), np.nan, np.float32))


def _colour(path: Path) -> None:
    tifffile.imwrite(path, np.zeros((120, 120, 3), np.uint16) + np.arange(120, dtype=np.uint16)[:, None, None])


def _cut(path: Path) -> None:
    write(path, new_frame(setup_of(plan_of())))
    path.write_bytes(path.read_bytes()[:5000])


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        (lambda path: None, "new.tif: no such file or folder"),
        (lambda path: path.write_bytes(b""), "new.tif: expected an image, got an empty file"),
        (lambda path: path.mkdir(), "frames in new.tif: expected images, got none"),
        (_text, "new.tif: expected"),
        (_dark, "new.tif, light: expected more light than noise, got no light"),
        (_small, "new.tif, size: expected 120 x 120 px, as in the camera of H, got 100 x 120 px"),
        (_one_value, "new.tif: expected an image, got the value 100 in every pixel"),
        (_nan, "new.tif: expected finite values"),
        (_colour, "new.tif: expected"),
        (_cut, "new.tif"),
    ],
)
def test_unlucky_frames_end_in_one_line(lfcal: Lfcal, place: Path, spoil: Callable[[Path], object], what: str) -> None:
    spoil(place / "new.tif")
    run = check(lfcal, "old.h5", "new.tif")
    assert run.code == 2 and run.err.count("\n") == 1 and what in run.err, run.err
    # no option of another command, and no position that nobody gave
    assert not any(word in run.err for word in ("colour=", "(--skip-damaged)", "(z, y, x) = (0, 0, 0)"))


def test_unlucky_h_files_end_in_one_line(lfcal: Lfcal, place: Path) -> None:
    (place / "empty.h5").write_bytes(b"")
    (place / "text.h5").write_text("none")
    save(
        PSFMatrix(np.zeros_like(values()), depths=told().depths, camera=told().camera, anchor=plan_of().anchor),
        place / "zero.h5",
    )
    scaled = {"cutout": {"scale": [1.1, 1.0]}}
    save(
        PSFMatrix(values(), depths=plan_of().depths_um, camera=plan_of().camera, provenance=scaled),
        place / "resampled.h5",
    )
    for name in ("missing.h5", "empty.h5", "text.h5", "zero.h5", "resampled.h5"):
        run = check(lfcal, name, "same.tif")
        assert run.code == 2 and run.err.count("\n") == 1, run.err


def test_ht_is_taken_for_its_h(lfcal: Lfcal, place: Path) -> None:
    save(told().T, place / "HT.h5")
    assert check(lfcal, "HT.h5", "same.tif").code == 0


def test_bad_words_end_in_one_line(lfcal: Lfcal, place: Path) -> None:
    for words, what in (
        (("--limit", 0), "--limit: expected a number > 0 and < 1, got 0"),
        (("--limit", "nan"), "--limit: expected"),
        (("--limit", "2"), "--limit: expected a number > 0 and < 1, got 2"),
        (("--noise", "much"), "--noise: expected CONSTANT,SLOPE"),
        (("--noise=-1,0",), "--noise: expected a number ≥ 0"),
    ):
        run = lfcal("fit", "check", "old.h5", "same.tif", *words)
        assert run.code == 2 and run.err.count("\n") == 1 and what in run.err, run.err
    run = lfcal("fit", "old.h5", "same.tif", "--noise", "4,1")
    assert run.code == 2 and run.err.count("\n") == 1 and "same.tif" in run.err, run.err


@pytest.mark.long
def test_a_camera_whose_noise_is_stated_needs_no_words(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("fit", "check", "old.h5", "same.tif", "--json")
    assert run.code == 0 and isinstance(run.json, dict), run.err
    assert run.json["noise_from"] == "as the frames state"
    assert abs(run.json["chi2"]["lit"] - 1) < 0.3 and json.dumps(run.json["notes"]) == "[]"


def test_options_of_a_fit_are_no_options_of_a_check(lfcal: Lfcal, place: Path) -> None:
    for option in ("-o", "--unknowns", "--effect", "--camera", "--no-h", "--hybrid"):
        run = lfcal("fit", "check", "H.h5", "any.tif", option, "x")
        assert run.code == 2 and len(run.err.splitlines()) == 1 and f"No such option: {option}" in run.err, run.err


@pytest.mark.parametrize(
    ("words", "now"),
    [
        (("--check", "old.h5", "same.tif"), "--check: expected another spelling; type lfcal fit check OLD.h5 FRAMES"),
        (("H.h5", "--limit", "3"), "type lfcal fit check OLD.h5 FRAMES --limit 2%"),
        (("H.h5", "--validate"), "type lfcal fit SOURCE -o fit, then lfcal fit validate fit SOURCE"),
        (("H.h5", "--validate-on", "b.h5"), "then lfcal fit validate fit OTHER --other"),
        (("H.h5", "--object", "a.tif", "--scene", "b.npy"), "then lfcal fit object fit FRAME --scene VOLUME"),
        (("H.h5", "--effects", "a.json"), "--effects: expected another spelling; type --effect"),
    ],
)
def test_what_is_a_command_now_is_named(lfcal: Lfcal, place: Path, words: tuple[str, ...], now: str) -> None:
    run = lfcal("fit", *words)
    assert run.code == 2 and now in run.err and len(run.err.splitlines()) == 1, run.err
    assert not (place / "fit").exists()
