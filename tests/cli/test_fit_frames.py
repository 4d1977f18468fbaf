"""``lfcal fit frames``: recalibration of a camera on frames of unknown objects, as a user asks for it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.base import InputError
from lfcal.camera import Camera
from lfcal.fit import NewFrame
from lfcal.psf import PSFMatrix, open_psf, save
from tests.cli.conftest import Run
from tests.recalibrate.common import WRONG, beads, frame_of, small_plan

Lfcal = Callable[..., Run]
START = ("--camera", "camera.json", "--virtual-depths", "2.2,2.7", "--cutout", 21)
FAST = ("--unknowns", "geometry,iris", "--windows", 1, "--noise", "9,1", "--workers", 2)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the described camera and a frame of beads by the true one."""
    folder, plan = tmp_path_factory.mktemp("frames"), small_plan()
    sensor = replace(plan.camera.sensor, bit_depth=16, full_well_e=65535.0, black_level=100.0, saturation=None)
    (folder / "camera.json").write_text(replace(plan.camera, sensor=sensor).to_json())
    values = frame_of(plan, beads(plan, 1), 1).values
    tifffile.imwrite(folder / "beads.tif", np.clip(np.rint(values + 100), 0, 65535).astype(np.uint16))
    tifffile.imwrite(folder / "dark.tif", np.full(values.shape, 100, np.uint16))
    return folder


@pytest.fixture
def place(kept: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(kept)
    return kept


def test_one_frame_of_beads_gives_the_camera_and_h(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("fit", "frames", "beads.tif", *START, *FAST, "--black-level", 100, "--out", "monday")
    assert run.code == 0 and "recalibrated from 1 frame, goodness of fit" in run.out, run.err
    assert "monday: H.h5, camera.json, effects.json, recalibration.json" in run.out
    numbers = json.loads((place / "monday/recalibration.json").read_text())
    gap = next(one for one in numbers["parameters"] if one["name"] == "gap_um")
    assert gap["value"] - gap["start"] == pytest.approx(WRONG["gap_um"], abs=4 * gap["sigma"])
    with open_psf(place / "monday/H.h5") as H:
        assert H.shape[0] == 2 and H.shape[3:] == (21, 21)
        assert H.camera is not None and H.camera.lattice.gap_um == pytest.approx(gap["value"])
        assert H.provenance["recalibration"]["verdict"] == numbers["verdict"]


def test_h_is_the_start_and_answers_are_json(lfcal: Lfcal, place: Path) -> None:
    plan = small_plan()
    camera = Camera.from_json((place / "camera.json").read_text())
    old = PSFMatrix(np.ones(plan.shape, np.float32), depths=plan.depths_um, camera=camera, anchor=plan.anchor)
    save(old, place / "old.h5")
    given = ("--psf", "old.h5", *FAST, "--dark", "dark.tif", "--orientation", "as-is", "--no-h", "--force")
    run = lfcal("fit", "frames", "beads.tif", *given, "-o", "tuesday", "--json")
    assert run.code == 0, run.err
    said = run.json
    assert isinstance(said, dict) and said["accepted"] and not (place / "tuesday/H.h5").exists()
    assert [Path(name).name for name in said["files"]] == ["camera.json", "effects.json", "recalibration.json"]


def test_a_frame_that_is_not_explained_leaves_nothing(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("fit", "frames", "beads.tif", *START, *FAST[:-4], "--noise", "9,3", "--black-level", 100, "-o", "bad")
    assert run.code == 1 and "not recalibrated: the residual is only" in run.out, run.err
    assert not (place / "bad").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "start of the recalibration: expected H, or a camera with planes"),
        (("--psf", "old.h5", "--camera", "bench"), "either H or a camera with planes, got H and camera"),
        (("--camera", "bench"), "--depths"),
        (("--camera", "camera.json", "--depths", "-1mm", "--cutout", 20), "cutout"),
        ((*START, "--windows", 9), "windows"),
        ((*START, "--orientation", "auto"), "orientation: expected as-is"),
        ((*START, "--unknowns", "colour"), "unknowns: expected auto or groups of unknowns, got colour"),
        (("--camera", "bench", "--virtual-depths", "3"), "size: expected 320 x 320 px, as in the camera"),
    ],
)
def test_what_cannot_be_done_is_one_line(lfcal: Lfcal, place: Path, words: tuple[object, ...], message: str) -> None:
    run = lfcal("fit", "frames", "beads.tif", *words)
    assert run.code == 2 and message in run.err, run.err
    assert run.err.count("\n") <= 2 and not (place / "fit").exists()


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


@pytest.mark.parametrize(("option", "value"), CORRECTIONS.items(), ids=list(CORRECTIONS))
def test_corrections_are_those_of_other_frames(lfcal: Lfcal, place: Path, option: str, value: str) -> None:
    run = lfcal("fit", "frames", "beads.tif", *START, *FAST, option, value)
    assert run.code == 2 and run.err, run.out
    assert value in run.err or option.lstrip("-").split("-")[0] in run.err.lower()


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
        done = lfcal("fit", "frames", *words, *FAST, "--black-level", 100)
        assert "read" in done.err, done.err
        return seen

    return run


def test_one_component_of_a_colour_image_is_used(
    read: Callable[..., list[NewFrame]], lfcal: Lfcal, place: Path
) -> None:
    beads = tifffile.imread("beads.tif")
    tifffile.imwrite("rgb.tif", np.stack([beads // 2, beads, beads // 4], axis=-1), photometric="rgb")
    (found,) = read("rgb.tif", *START, "--channel", "G")
    assert np.array_equal(found.values, beads.astype(np.float32) - 100) and found.valid is None
    run = lfcal("fit", "frames", "rgb.tif", *START, *FAST)
    assert run.code == 2 and "use one colour: --channel G" in run.err and "colour=" not in run.err
    wrong = lfcal("fit", "frames", "rgb.tif", *START, *FAST, "--channel", "X")
    assert wrong.code == 2 and "colour channel: expected R, G or B, got 'X'; choose one of these" in wrong.err


def test_pixels_of_one_colour_of_a_mosaic_are_used(
    read: Callable[..., list[NewFrame]], lfcal: Lfcal, place: Path
) -> None:
    camera = Camera.from_json((place / "camera.json").read_text())
    mosaic = replace(camera, sensor=replace(camera.sensor, cfa="GRBG"))
    (place / "mosaic.json").write_text(mosaic.to_json())
    start = ("--camera", "mosaic.json", *START[2:])
    (found,) = read("beads.tif", *start, "--channel", "B")
    wanted = np.zeros(found.values.shape, bool)
    wanted[1::2, ::2] = True
    assert found.valid is not None and np.array_equal(found.valid, wanted)
    run = lfcal("fit", "frames", "beads.tif", *start, *FAST)
    assert run.code == 2 and "got a mosaic of G1, R, B, G2; choose one of them (--channel G1)" in run.err
    run = lfcal("fit", "frames", "beads.tif", *START, *FAST, "--channel", "R")
    assert (
        run.code == 2
        and "colour channel: expected none for monochrome frames, got 'R'; leave the channel out (--channel)" in run.err
    )


def test_frames_of_the_camera_of_one_channel_are_thinned(read: Callable[..., list[NewFrame]], place: Path) -> None:
    camera = Camera.from_json((place / "camera.json").read_text())
    rows, columns = camera.sensor.shape
    raw = np.arange(4 * rows * columns, dtype=np.uint16).reshape(2 * rows, 2 * columns)
    pattern = ((33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes([1, 0, 2, 1]), True))  # GRBG
    tifffile.imwrite("mosaic.tif", raw, photometric="cfa", extratags=pattern)
    (found,) = read("mosaic.tif", *START, "--channel", "R")
    assert np.array_equal(found.values, raw[::2, 1::2].astype(np.float32) - 100)


def test_a_folder_with_the_name_of_the_command_is_named_with_a_slash(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("frames").mkdir()
    run = lfcal("fit", "frames", "-o", "fit")
    assert run.code == 2 and "To use the folder frames, type frames/" in run.err
    assert "expected images" in lfcal("fit", "frames/", "-o", "fit").err
