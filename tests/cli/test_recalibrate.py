"""``lfcal fit check``, ``lfcal fit frames`` and ``lfcal watch``: whether H is still valid."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.base import InputError
from lfcal.camera import Camera
from lfcal.fit import NewFrame
from lfcal.frames import CorrectionRecipe
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.recalibrate import RECALIBRATED, DriftWatch, write_watch
from lfcal.recalibrate.watched import WatchedFrame, WatchedMean
from lfcal.reconstruct import FrameFile, load_volume
from lfcal.tasks import RunSettings, Watch
from lfcal.tasks._watched_series import WatchedSeries
from tests.cli.conftest import Lfcal, Run
from tests.judge.test_check import AT, changed, new_frame, plan_of, setup_of, values
from tests.recalibrate.common import WRONG, beads, frame_of, shared_patterns, small_h, small_plan, true_setup
from tests.recalibrate.test_watch import PLAN, SETUP, drifted, frame

# -- ``lfcal fit check``: whether an old H still holds, as a user asks it --
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
    write(place / "new0.tif", new_frame(changed(gap_um=1.01 * plan_of().camera.lattice.gap_um), seed=0))
    run = check(lfcal, "old.h5", "new0.tif")
    words = "does not hold: This H should not be used as it is: error of H beyond its limit, gap of the array"
    assert run.code == 1 and words in run.out


@pytest.mark.long
def test_a_change_is_measured_by_two_frames_and_compared_with_a_limit(lfcal: Lfcal, place: Path) -> None:
    lattice = plan_of().camera.lattice
    for k in range(2):
        write(place / f"new{k}.tif", new_frame(changed(gap_um=1.01 * lattice.gap_um), seed=k))
    found = check(lfcal, "old.h5", "new0.tif", "new1.tif", "--json").json
    assert found["answer"] == "does not hold" and len(found["frames"]) == 2
    gap = found["suspects"][0]["values"][0]
    assert gap["name"] == "gap_um" and abs(gap["change"] - 0.01 * lattice.gap_um) < 4 * gap["sigma"]
    assert found["frames"][0]["position"] == [0, *AT] and abs(found["frames"][0]["background"]) < 3
    # a limit beyond the change
    assert check(lfcal, "old.h5", "new0.tif", "--limit", "20%").code == 0


@pytest.mark.long
def test_frames_of_a_folder_with_a_plan_have_its_positions(lfcal: Lfcal, place: Path) -> None:
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
    frames = {one["label"]: one for one in found["frames"]}
    right = frames["z0_y2_x4.png"]
    assert right["position"] == [0, *AT] and right["chi2"] < 1.3 and np.abs(right["beside_px"]).max() < 0.05
    assert frames["z0_y1_x3.png"]["chi2"] > 2
    deeper = replace(later, depths_um=(1.2 * later.depths_um[0],))
    (place / "scan" / "plan.json").write_text(deeper.to_json())
    run = check(lfcal, "old.h5", "scan", "--orientation", "as-is")
    assert run.code == 2 and "depth: expected a depth of H" in run.err and run.err.count("\n") <= 2, run.err


def test_frames_that_state_no_position_are_named_one_by_one(lfcal: Lfcal, place: Path) -> None:
    for name in ("scan/image_0", "scan/image_1", "below/frames/z0_y4_x5", "below/frames/z0_y3_x4", "below/dark"):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(place / "same.tif", place / f"{name}.tif")
    for name in ("scan", "below"):
        (place / name / "plan.json").write_text(plan_of().to_json())
    run = check(lfcal, "old.h5", "scan")
    said = "give the files of single frames instead of scan, because the positions of their sources"
    # none of these is an option here
    assert said in run.err and not any(option in run.err for option in ("--manifest", "--order", "--pattern"))
    assert run.code == 2 and "run lfcal fit check old.h5 below/frames" in check(lfcal, "old.h5", "below").err


@pytest.mark.long
def test_a_name_that_states_the_position_is_used(lfcal: Lfcal, place: Path) -> None:
    write(place / "z0_y4_x5.tif", new_frame(setup_of(plan_of()), (0.3, 0.0)))
    assert "sources are displaced by" in check(lfcal, "old.h5", "z0_y4_x5.tif").ok().err
    write(place / "z0_y0_x0.tif", new_frame(setup_of(plan_of())))
    assert f"0, {AT[0]}, {AT[1]}" in check(lfcal, "old.h5", "z0_y0_x0.tif").ok().out


def test_an_h_without_a_camera_gives_numbers(lfcal: Lfcal, place: Path) -> None:
    save(told(camera=False), place / "bare.h5")
    assert "the camera of H is unknown" in check(lfcal, "bare.h5", "same.tif").ok().err


@pytest.mark.long
def test_an_h_without_a_camera_has_unknown_noise_and_ht_is_used_as_its_h(lfcal: Lfcal, place: Path) -> None:
    save(told(camera=False), place / "bare.h5")
    # the photons of its samples are unknown
    bare = lfcal("fit", "check", "bare.h5", "same.tif", "--black-level", 100)
    assert bare.code in (0, 1) and "the photon noise is unknown" in bare.err and "does not hold" not in bare.out
    save(told().T, place / "HT.h5")
    check(lfcal, "HT.h5", "same.tif").ok()


def test_frames_that_cannot_be_checked_end_in_one_line(lfcal: Lfcal, place: Path) -> None:
    rng, frame = np.random.default_rng(0), new_frame(setup_of(plan_of()))
    slope = np.arange(120, dtype=np.uint16)[:, None, None]
    cases: tuple[tuple[Callable[[Path], object], str], ...] = (
        (lambda path: None, ": no such file or folder"),
        (lambda path: path.write_bytes(b""), ": expected an image, got an empty file"),
        (lambda path: path.mkdir(), ": expected images, got none"),
        (lambda path: path.write_text("no picture"), ": expected"),
        (lambda path: write(path, 30 + 8 * rng.standard_normal((120, 120))), ", light: expected more light than noise"),
        (lambda path: write(path, frame[:100]), ", size: expected 120 x 120 px, as in the camera of H, got 100 x 120"),
        (
            lambda path: tifffile.imwrite(path, np.full((120, 120), 100, np.uint16)),
            ": expected an image, got the value",
        ),
        (lambda path: tifffile.imwrite(path, np.full((120, 120), np.nan, np.float32)), ": expected finite values"),
        (lambda path: tifffile.imwrite(path, np.zeros((120, 120, 3), np.uint16) + slope), ": expected"),
        (lambda path: path.write_bytes((place / "same.tif").read_bytes()[:5000]), ""),
    )
    for k, (spoil, said) in enumerate(cases):
        spoil(place / f"new{k}.tif")
        run = check(lfcal, "old.h5", f"new{k}.tif").refused(f"new{k}.tif{said}")
        # no option of another command, and no position that was not given
        assert not any(word in run.err for word in ("colour=", "(--skip-damaged)", "(z, y, x) = (0, 0, 0)"))


def test_h_files_that_cannot_be_checked_end_in_one_line(lfcal: Lfcal, place: Path) -> None:
    (place / "empty.h5").write_bytes(b"")
    (place / "text.h5").write_text("none")
    old, scaled = told(), {"cutout": {"scale": [1.1, 1.0]}}
    zero = PSFMatrix(np.zeros_like(values()), depths=old.depths, camera=old.camera, anchor=plan_of().anchor)
    save(zero, place / "zero.h5")
    resampled = PSFMatrix(values(), depths=plan_of().depths_um, camera=plan_of().camera, provenance=scaled)
    save(resampled, place / "resampled.h5")
    for name in ("missing.h5", "empty.h5", "text.h5", "zero.h5", "resampled.h5"):
        check(lfcal, name, "same.tif").refused()


def test_options_that_do_not_apply_end_in_one_line(lfcal: Lfcal, place: Path) -> None:
    for words, said in (
        ("check old.h5 same.tif --limit 0", "--limit: expected a number > 0 and < 1, got 0"),
        ("check old.h5 same.tif --limit nan", "--limit: expected"),
        ("check old.h5 same.tif --limit 2", "--limit: expected a number > 0 and < 1, got 2"),
        ("check old.h5 same.tif --noise much", "--noise: expected CONSTANT,SLOPE"),
        ("check old.h5 same.tif --noise=-1,0", "--noise: expected a number ≥ 0"),
        ("old.h5 same.tif --noise 4,1", "same.tif"),
        *(
            (f"check H.h5 any.tif {option} x", f"No such option: {option}")
            for option in ("-o", "--unknowns", "--effect", "--camera", "--no-h", "--hybrid")
        ),
        ("--check old.h5 same.tif", "--check: expected an option of lfcal fit; use lfcal fit check OLD.h5 FRAMES"),
        ("H.h5 --limit 3", "use lfcal fit check OLD.h5 FRAMES --limit 2%"),
        ("H.h5 --validate", "use lfcal fit SOURCE -o fit, then lfcal fit validate fit SOURCE"),
        ("H.h5 --validate-on b.h5", "then lfcal fit validate fit OTHER --other"),
        ("H.h5 --object a.tif --scene b.npy", "then lfcal fit object fit FRAME --scene VOLUME"),
        ("H.h5 --effects a.json", "--effects: expected an option of lfcal fit; use --effect"),
    ):
        lfcal("fit", *words.split()).refused(said)
        assert not (place / "fit").exists(), words


@pytest.mark.long
def test_a_camera_whose_noise_is_stated_needs_no_words(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("fit", "check", "old.h5", "same.tif", "--json")
    assert run.code == 0, run.err
    assert run.json["noise_from"] == "as the frames state"
    assert abs(run.json["chi2"]["lit"] - 1) < 0.3 and json.dumps(run.json["notes"]) == "[]"


# -- ``lfcal fit frames``: recalibration of a camera on frames of unknown objects, as a user asks for it --
START = ("--camera", "camera.json", "--virtual-depths", "2.2,2.7", "--cutout", 21)
FAST = ("--unknowns", "geometry,iris", "--windows", 1, "--noise", "9,1", "--workers", 2)


@pytest.fixture(scope="module")
def beads_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the described camera and a frame of beads by the true one."""
    folder, plan = tmp_path_factory.mktemp("frames"), small_plan()
    sensor = replace(plan.camera.sensor, bit_depth=16, full_well_e=65535.0, black_level=100.0, saturation=None)
    (folder / "camera.json").write_text(replace(plan.camera, sensor=sensor).to_json())
    values = frame_of(plan, beads(plan, 1), 1).values
    tifffile.imwrite(folder / "beads.tif", np.clip(np.rint(values + 100), 0, 65535).astype(np.uint16))
    tifffile.imwrite(folder / "dark.tif", np.full(values.shape, 100, np.uint16))
    return folder


@pytest.fixture
def beads_place(beads_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(beads_folder)
    return beads_folder


def test_one_frame_of_beads_gives_the_camera_and_h(lfcal: Lfcal, beads_place: Path) -> None:
    run = lfcal("fit", "frames", "beads.tif", *START, *FAST, "--black-level", 100, "--out", "monday")
    assert run.code == 0 and "recalibrated from 1 frame, goodness of fit" in run.out, run.err
    assert "monday: H.h5, camera.json, effects.json, recalibration.json" in run.out
    numbers = json.loads((beads_place / "monday/recalibration.json").read_text())
    gap = next(one for one in numbers["parameters"] if one["name"] == "gap_um")
    assert gap["value"] - gap["start"] == pytest.approx(WRONG["gap_um"], abs=4 * gap["sigma"])
    with open_psf(beads_place / "monday/H.h5") as H:
        assert H.shape[0] == 2 and H.shape[3:] == (21, 21)
        assert H.camera is not None and H.camera.lattice.gap_um == pytest.approx(gap["value"])
        assert H.provenance["recalibration"]["verdict"] == numbers["verdict"]


@pytest.mark.long
def test_h_is_the_start_and_answers_are_json(lfcal: Lfcal, beads_place: Path) -> None:
    plan = small_plan()
    camera = Camera.from_json((beads_place / "camera.json").read_text())
    old = PSFMatrix(np.ones(plan.shape, np.float32), depths=plan.depths_um, camera=camera, anchor=plan.anchor)
    save(old, beads_place / "old.h5")
    given = ("--psf", "old.h5", *FAST, "--dark", "dark.tif", "--orientation", "as-is", "--no-h", "--force")
    run = lfcal("fit", "frames", "beads.tif", *given, "-o", "tuesday", "--json").ok()
    said = run.json
    assert said["accepted"] and not (beads_place / "tuesday/H.h5").exists()
    assert [Path(name).name for name in said["files"]] == ["camera.json", "effects.json", "recalibration.json"]


@pytest.mark.long
def test_a_frame_that_is_not_explained_leaves_nothing(lfcal: Lfcal, beads_place: Path) -> None:
    run = lfcal("fit", "frames", "beads.tif", *START, *FAST[:-4], "--noise", "9,3", "--black-level", 100, "-o", "bad")
    assert run.code == 1 and "not recalibrated: the residual is only" in run.out, run.err
    assert not (beads_place / "bad").exists()


CORRECTIONS = {
    "--background": "none.tif",
    "--dark": "none.tif",
    "--defect-list": "none.txt",
    "--mask": "none.png",
    "--white": "none.tif",
    "--defects": "-1",
    "--exposure": "-1",
    "--saturation": "-5",
    "--white-floor": "7",
    "--white-mode": "gray",
}


def test_what_cannot_be_recalibrated_is_refused(lfcal: Lfcal, beads_place: Path) -> None:
    for words, message in (
        ((), "start of the recalibration: expected H, or a camera with planes"),
        (("--psf", "old.h5", "--camera", "bench"), "either H or a camera with planes, got H and camera"),
        (("--camera", "bench"), "--depths"),
        (("--camera", "camera.json", "--depths", "-1mm", "--cutout", 20), "cutout"),
        ((*START, "--windows", 9), "windows"),
        ((*START, "--orientation", "auto"), "orientation: expected as-is"),
        ((*START, "--unknowns", "colour"), "unknowns: expected auto or groups of unknowns, got colour"),
        (("--camera", "bench", "--virtual-depths", "3"), "size: expected 320 x 320 px, as in the camera"),
    ):
        lfcal("fit", "frames", "beads.tif", *words).refused(message)
        assert not (beads_place / "fit").exists(), words
    for option, value in CORRECTIONS.items():
        run = lfcal("fit", "frames", "beads.tif", *START, *FAST, option, value)
        assert run.code == 2 and (value in run.err or option.lstrip("-").split("-")[0] in run.err.lower()), option


class _SeenError(InputError):
    """Raised once the frames are read."""


@pytest.fixture
def read(lfcal: Lfcal, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[NewFrame]]:
    """Return a function that runs the command up to the recalibration, and returns the frames it reads."""
    seen: list[NewFrame] = []

    def stop(frames: list[NewFrame], *_: object, **__: object) -> None:
        seen[:] = frames
        raise _SeenError("read")

    monkeypatch.setattr("lfcal.recalibrate.iter_recalibrate", stop)

    def run(*words: object) -> list[NewFrame]:
        done = lfcal("fit", "frames", *words, *FAST, "--black-level", 100, "--force")
        assert "read" in done.err, done.err
        return seen

    return run


def test_one_colour_of_images_and_mosaics_is_used(
    read: Callable[..., list[NewFrame]], lfcal: Lfcal, beads_place: Path
) -> None:
    beads, camera = tifffile.imread("beads.tif"), Camera.from_json((beads_place / "camera.json").read_text())
    tifffile.imwrite("rgb.tif", np.stack([beads // 2, beads, beads // 4], axis=-1), photometric="rgb")
    (found,) = read("rgb.tif", *START, "--channel", "G")
    assert np.array_equal(found.values, beads.astype(np.float32) - 100) and found.valid is None
    # a mosaic: pixels of the colour are valid
    mosaic = replace(camera, sensor=replace(camera.sensor, cfa="GRBG"))
    (beads_place / "mosaic.json").write_text(mosaic.to_json())
    start = ("--camera", "mosaic.json", *START[2:])
    (found,) = read("beads.tif", *start, "--channel", "B")
    wanted = np.zeros(found.values.shape, bool)
    wanted[1::2, ::2] = True
    assert found.valid is not None and np.array_equal(found.valid, wanted)
    # frames of the camera of one channel are thinned
    rows, columns = camera.sensor.shape
    raw = np.arange(4 * rows * columns, dtype=np.uint16).reshape(2 * rows, 2 * columns)
    pattern = ((33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes([1, 0, 2, 1]), True))  # GRBG
    tifffile.imwrite("mosaic.tif", raw, photometric="cfa", extratags=pattern)
    (found,) = read("mosaic.tif", *START, "--channel", "R")
    assert np.array_equal(found.values, raw[::2, 1::2].astype(np.float32) - 100)


@pytest.mark.usefixtures("beads_place")
def test_colours_that_do_not_fit_are_refused(lfcal: Lfcal) -> None:
    beads = tifffile.imread("beads.tif")
    tifffile.imwrite("rgb.tif", np.stack([beads] * 3, axis=-1), photometric="rgb")
    camera = Camera.from_json(Path("camera.json").read_text())
    Path("mosaic.json").write_text(replace(camera, sensor=replace(camera.sensor, cfa="GRBG")).to_json())
    for words, said in (
        (("rgb.tif", *START), "use one colour: --channel G"),
        (("rgb.tif", *START, "--channel", "X"), "colour channel: expected R, G or B, got 'X'; choose one of these"),
        (("beads.tif", "--camera", "mosaic.json", *START[2:]), "got a mosaic of G1, R, B, G2; choose one of them"),
        (("beads.tif", *START, "--channel", "R"), "colour channel: expected none for monochrome frames, got 'R'"),
    ):
        assert "colour=" not in lfcal("fit", "frames", *words, *FAST).refused(said).err


def test_a_folder_with_the_name_of_the_command_is_named_with_a_slash(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("frames").mkdir()
    lfcal("fit", "frames", "-o", "fit").refused("To use the folder frames, type frames/")
    assert "expected images" in lfcal("fit", "frames/", "-o", "fit").err


# -- ``lfcal watch``: whether H still holds for frames of unknown objects, as a user asks for it --
GIVEN = ("--noise", "9,1", "--black-level", 100, "--workers", 2)


@pytest.fixture(scope="module", autouse=True)
def _shared_patterns() -> Iterator[None]:
    with shared_patterns():
        yield


def stored(values: np.ndarray) -> np.ndarray:
    """Return the samples that a camera stores."""
    return np.clip(np.rint(values + 100), 0, 65535).astype(np.uint16)


@pytest.fixture(scope="module")
def watched_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with H, reference frames, and frames before and after a shift of the array by 0.08 px."""
    folder = tmp_path_factory.mktemp("watch")
    sensor = replace(SETUP.camera.sensor, bit_depth=16, full_well_e=65535.0, black_level=100.0, saturation=None)
    described = replace(SETUP, camera=replace(SETUP.camera, sensor=sensor))
    (folder / "monday").mkdir()
    save(small_h(PLAN, described), folder / "monday" / "H.h5")
    for name, drift, seeds in (("quiet", 0.0, range(7)), ("steady", 0.0, (30, 31)), ("moved", 0.08, (40, 41, 42))):
        (folder / name).mkdir()
        for k in seeds:
            when = f"2026:05:0{1 + k % 10} 08:00:00"
            page = stored(frame(drifted(drift) if drift else drifted(), k).values)
            tifffile.imwrite(folder / name / f"{k}.tif", page, datetime=when)
    return folder


@pytest.fixture
def watched(watched_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(watched_folder)
    return watched_folder


def test_frames_of_a_calibrated_camera_are_quiet(lfcal: Lfcal, watched: Path) -> None:
    run = lfcal("watch", "monday", "steady/", *GIVEN)
    assert run.code == 0 and "H is still valid: shift x" in run.out, run.err
    assert "chi² distribution with 3 degrees of freedom" in run.err


def test_a_shift_is_reported_and_written(lfcal: Lfcal, watched: Path) -> None:
    more = ("--quiet", "quiet", "--mean", 2, "--rate", "2%", "--windows", 1, "--orientation", "as-is", "--force")
    run = lfcal("watch", "monday/H.h5", "steady/30.tif", "moved", *GIVEN, *more, "-o", "out")
    assert run.code == 1 and "H is no longer valid: shift x +0.0" in run.out, run.err
    assert "recalibrate with lfcal fit frames" in run.out and "out: watch.csv, watch.json, watch.png" in run.out
    assert "false alarms: 2 % for each tested value, from 7 quiet frames" in run.err
    numbers = json.loads((watched / "out/watch.json").read_text())
    assert numbers["holds"] is False and numbers["trends"][0]["per"] == "hour"
    with (watched / "out/watch.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == ["30.tif", "40.tif", "41.tif", "42.tif"]
    assert [row["alarm"] for row in rows[2:]] == ["1", "1"] and rows[0]["when"].startswith("2026-05-01T08:00")
    shifts = np.array([[float(row["shift_x_px"]), float(row["shift_x_px_sigma"])] for row in rows])
    assert np.abs((shifts[:, 0] - [0, 0.08, 0.08, 0.08]) / shifts[:, 1]).max() < 4
    assert (watched / "out/watch.png").stat().st_size > 5000


def test_answers_are_json(lfcal: Lfcal, watched: Path) -> None:
    lfcal("watch", "monday", "moved/40.tif", "--noise", "9,1", "--dark", "steady.none", "--json").refused("steady.none")
    tifffile.imwrite("dark.tif", np.full(PLAN.camera.sensor.shape, 100, np.uint16))
    run = lfcal("watch", "monday", "moved/40.tif", "--noise", "9,1", "--dark", "dark.tif", "--json")
    said = run.json
    assert run.code == 1 and said["files"] == [], run.err
    assert said["means"][0]["shift_x_px"] == pytest.approx(0.08, abs=0.02)


def test_what_cannot_be_watched_is_refused(lfcal: Lfcal, watched: Path) -> None:
    rng = np.random.default_rng(0)
    for name, shape in (("dim", (56, 56)), ("small", (40, 56))):
        tifffile.imwrite(f"{name}.tif", rng.normal(100, 3, shape).astype(np.uint16))
    tifffile.imwrite("blank.tif", np.zeros(PLAN.camera.sensor.shape, np.uint16))
    save(PSFMatrix(np.ones((1, 3, 3, 21, 21), np.float32)), watched / "plain.h5")
    wrong = rng.random((1, 3, 3, 21, 21), np.float32)
    save(PSFMatrix(wrong, depths=PLAN.depths_um, camera=SETUP.camera, anchor=PLAN.anchor), watched / "other.h5")
    for words, message in (
        ("monday dim.tif", "structure that is larger than the noise"),
        ("monday small.tif", "size: expected 56 x 56 px, as in the camera"),
        ("plain.h5 steady", "expected an H with a camera that explains it, got an H without a camera"),
        ("other.h5 steady", "expected an H with a camera that explains it, got a camera that leaves"),
        ("steady steady", "steady/H.h5"),
        ("monday none", "none: no such file or folder"),
        ("monday steady --quiet moved", "quiet frames: expected at least 6, or none, got 3"),
        ("monday steady --mean 0", "mean"),
        ("monday steady --rate 80%", "rate"),
        ("monday steady --windows 9", "windows"),
        ("monday steady --channel R", "channel"),
        ("monday steady --orientation auto", "orientation: expected as-is"),
        ("monday blank.tif", "record it again, or leave it out"),
    ):
        run = lfcal("watch", *words.split(), *GIVEN, "-o", "bad").refused()
        assert message in run.err.replace("\\", "/") and not (watched / "bad").exists(), (words, run.err)


def test_a_watch_is_written_before_the_recalibration(
    lfcal: Lfcal, watched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recalibration that failed discarded the finished watch."""

    def failing(*_: object, **__: object) -> None:
        raise InputError("frames: not recalibrated")

    monkeypatch.setattr("lfcal.recalibrate.iter_recalibrate", failing)
    lfcal("watch", "monday", "moved/40.tif", *GIVEN, "--recalibrate", "-o", "stopped").refused("not recalibrated")
    said = json.loads((watched / "stopped/watch.json").read_text())
    assert said["holds"] is False and said["recalibrated"] is False and (watched / "stopped/watch.png").is_file()


def test_the_recalibrated_h_of_an_earlier_watch_is_refused(tmp_path: Path) -> None:
    """It was used if a newer watch in the same folder wrote no H."""
    psf, h = tmp_path / "H.h5", tmp_path / RECALIBRATED / "H.h5"
    h.parent.mkdir()
    h.touch()
    one = WatchedMean(("40.tif",), (0.1, 0.0, 0.0), (0.01, 0.01, 0.04), 99.0, 1e-6, True)
    frames = (WatchedFrame("40.tif", None, one.values, one.sigmas),)
    found = DriftWatch(frames, (), (one,), (0,), True, one.values, one.sigmas, (), 0.01, 11.3)
    known = {"task": {"psf": str(psf)}}
    series = [FrameFile("40", tmp_path / "40.tif", 0)]
    write_watch(found, tmp_path, known)
    with pytest.raises(InputError, match="expected the recalibrated H of this result, got that of an earlier one"):
        WatchedSeries.read(tmp_path, psf, series, recalibrated=True)
    write_watch(found, tmp_path, known | {"recalibrated": True})
    assert WatchedSeries.read(tmp_path, psf, series, recalibrated=True).recalibrated == h


LARGER = small_plan((2.4,), 66)  # recalibration needs more pixels than a check


@pytest.fixture(scope="module")
def knocked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder after a watch of two quiet and three shifted frames, with the recalibrated camera."""
    folder, setup = tmp_path_factory.mktemp("knock"), true_setup(LARGER)
    sensor = replace(setup.camera.sensor, bit_depth=16, full_well_e=65535.0, black_level=100.0, saturation=None)
    for name in ("monday", "series", "moved"):
        (folder / name).mkdir()
    save(small_h(LARGER, replace(setup, camera=replace(setup.camera, sensor=sensor))), folder / "monday" / "H.h5")
    for k in (30, 31, 40, 41, 42):
        page = stored(frame(drifted(0.08 * (k >= 40), plan=LARGER), k, plan=LARGER).values)
        for name in ("series", "moved")[: 1 + (k >= 40)]:
            tifffile.imwrite(folder / name / f"{k}.tif", page)
    task = Watch(
        psf=folder / "monday",
        frames=(folder / "series",),
        out=folder / "knock",
        noise=(9.0, 1.0),
        recalibrate=True,
        corrections=CorrectionRecipe(black_level=100),
    )
    (made,) = task.run(RunSettings(workers=2))
    assert made.failed and made.found.first_moved == 2, made.found.verdict
    assert made.recalibration.accepted, made.recalibration.verdict
    return folder


def details(path: Path) -> dict[str, Any]:
    with h5py.File(path) as file:
        found: dict[str, Any] = json.loads(str(file.attrs["details"]))
    return found


RECONSTRUCT = ("--resample", "never", "--solver", "rl", "--iterations", 2, "--margin", 0)


@pytest.mark.long
def test_a_series_uses_the_recalibrated_h_after_a_drift(lfcal: Lfcal, knocked: Path) -> None:
    place = knocked
    moved = json.loads((place / "knock/recalibrated/camera.json").read_text())["lattice"]["offset_um"]
    before = true_setup(LARGER).camera.lattice.offset_um
    assert (moved[0] - before[0]) / SETUP.camera.sensor.pixel_um == pytest.approx(0.08, abs=0.015)
    given = ("reconstruct", place / "monday/H.h5", place / "series", *RECONSTRUCT, "--format", ".h5")
    run = lfcal(*given, "-o", place / "volumes", "--watch", place / "knock", "--recalibrated").ok()
    assert "H is no longer valid: shift x +0.0" in run.err and "from 40 on, frames are reconstructed with" in run.err
    lfcal(*given, "-o", place / "old", "--watch", place / "knock/watch.json").ok()
    lfcal(*given, "-o", place / "plain").ok()
    for name, alarm in (("30", False), ("31", False), ("40", True), ("42", True)):
        said, old = (details(place / folder / f"{name}.h5")["watch"] for folder in ("volumes", "old"))
        assert (said["alarm"], said["recalibrated"]) == (alarm, alarm) and not old["recalibrated"]
        assert said["shift_x_px"] == pytest.approx(0.08 * alarm, abs=0.03) and old["name"] == f"{name}.tif"
        volume, unchanged, plain = (
            load_volume(place / folder / f"{name}.h5") for folder in ("volumes", "old", "plain")
        )
        np.testing.assert_array_equal(unchanged, plain)
        assert np.array_equal(volume, plain) is not alarm
    assert details(place / "volumes/40.h5")["task"]["watch"] and "watch" not in details(place / "plain/40.h5")
    lfcal(*given[:3], *RECONSTRUCT, "-o", place / "all.h5", "--watch", place / "knock").ok()
    assert [one["alarm"] for one in details(place / "all.h5")["watch"]] == [False, False, True, True, True]


@pytest.mark.long
def test_a_check_of_other_frames_or_another_h_is_refused(lfcal: Lfcal, knocked: Path) -> None:
    place = knocked
    shutil.copy(place / "monday/H.h5", place / "another.h5")
    for psf, frames, options, message in (
        ("another.h5", "series", ("--watch", "knock"), "reconstruct with that H"),
        ("monday/H.h5", "moved", ("--watch", "knock"), "the 3 frames of the series, got 5 frames, the first 30.tif"),
        ("monday/H.h5", "series", ("--recalibrated",), "--recalibrated: expected a result of lfcal watch"),
        ("monday/H.h5", "series", ("--watch", "knock/watch.csv"), "expected the result of lfcal watch"),
    ):
        given = [place / one if one.startswith("knock") else one for one in options]
        lfcal("reconstruct", place / psf, place / frames, *RECONSTRUCT, "-o", place / "no", *given).refused(message)
    words = ("reconstruct", place / "monday/H.h5", place / "series", *RECONSTRUCT, "-o", place / "no.h5")
    lfcal(*words, "--watch", place / "knock", "--recalibrated").refused("output for two H: expected a folder")
    lfcal("watch", place / "monday", place / "series", *GIVEN, "--recalibrate").refused("expected an output folder")
