"""``lfcal watch``: whether H still holds for frames of unknown objects, as a user asks for it."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.psf import PSFMatrix, save
from tests.cli.conftest import Run
from tests.recalibrate.common import small_h
from tests.recalibrate.test_watch import PLAN, SETUP, drifted, frame

Lfcal = Callable[..., Run]
GIVEN = ("--noise", "9,1", "--black-level", 100, "--workers", 2)


def stored(values: np.ndarray) -> np.ndarray:
    """Return the samples that a camera stores."""
    return np.clip(np.rint(values + 100), 0, 65535).astype(np.uint16)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
def place(kept: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(kept)
    return kept


def test_frames_of_a_calibrated_camera_are_quiet(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("watch", "monday", "steady/", *GIVEN)
    assert run.code == 0 and "H is still valid: shift x" in run.out, run.err
    assert "chi² distribution with 3 degrees of freedom" in run.err


def test_a_shift_is_reported_and_written(lfcal: Lfcal, place: Path) -> None:
    more = ("--quiet", "quiet", "--mean", 2, "--rate", "2%", "--windows", 1, "--orientation", "as-is", "--force")
    run = lfcal("watch", "monday/H.h5", "steady/30.tif", "moved", *GIVEN, *more, "-o", "out")
    assert run.code == 1 and "H is no longer valid: shift x +0.0" in run.out, run.err
    assert "recalibrate with lfcal fit frames" in run.out and "out: watch.csv, watch.json, watch.png" in run.out
    assert "false alarms: 2 % for each tested value, from 7 quiet frames" in run.err
    numbers = json.loads((place / "out/watch.json").read_text())
    assert numbers["holds"] is False and numbers["trends"][0]["per"] == "hour"
    with (place / "out/watch.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["frame"] for row in rows] == ["30.tif", "40.tif", "41.tif", "42.tif"]
    assert [row["alarm"] for row in rows[2:]] == ["1", "1"] and rows[0]["when"].startswith("2026-05-01T08:00")
    shifts = np.array([[float(row["shift_x_px"]), float(row["shift_x_px_sigma"])] for row in rows])
    assert np.abs((shifts[:, 0] - [0, 0.08, 0.08, 0.08]) / shifts[:, 1]).max() < 4
    assert (place / "out/watch.png").stat().st_size > 5000


def test_answers_are_json(lfcal: Lfcal, place: Path) -> None:
    run = lfcal("watch", "monday", "moved/40.tif", "--noise", "9,1", "--dark", "steady.none", "--json")
    assert run.code == 2 and "steady.none" in run.err
    tifffile.imwrite("dark.tif", np.full(PLAN.camera.sensor.shape, 100, np.uint16))
    run = lfcal("watch", "monday", "moved/40.tif", "--noise", "9,1", "--dark", "dark.tif", "--json")
    said = run.json
    assert run.code == 1 and isinstance(said, dict) and said["files"] == [], run.err
    assert said["means"][0]["shift_x_px"] == pytest.approx(0.08, abs=0.02)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("monday", "dim.tif"), "structure that is larger than the noise"),
        (("monday", "small.tif"), "size: expected 56 x 56 px, as in the camera"),
        (("plain.h5", "steady"), "expected an H with a camera that explains it, got an H without a camera"),
        (("other.h5", "steady"), "expected an H with a camera that explains it, got a camera that leaves"),
        (("steady", "steady"), "steady/H.h5"),
        (("monday", "none"), "none: no such file or folder"),
        (("monday", "steady", "--quiet", "moved"), "quiet frames: expected at least 6, or none, got 3"),
        (("monday", "steady", "--mean", 0), "mean"),
        (("monday", "steady", "--rate", "80%"), "rate"),
        (("monday", "steady", "--windows", 9), "windows"),
        (("monday", "steady", "--channel", "R"), "channel"),
        (("monday", "steady", "--orientation", "auto"), "orientation: expected as-is"),
    ],
)
def test_what_cannot_be_done_is_one_line(lfcal: Lfcal, place: Path, words: tuple[object, ...], message: str) -> None:
    for name, shape in (("dim", (56, 56)), ("small", (40, 56))):
        tifffile.imwrite(f"{name}.tif", np.random.default_rng(0).normal(100, 3, shape).astype(np.uint16))
    save(PSFMatrix(np.ones((1, 3, 3, 21, 21), np.float32)), place / "plain.h5")
    wrong = PSFMatrix(
        np.random.default_rng(0).random((1, 3, 3, 21, 21), np.float32),
        depths=PLAN.depths_um,
        camera=SETUP.camera,
        anchor=PLAN.anchor,
    )
    save(wrong, place / "other.h5")
    run = lfcal("watch", *words, *GIVEN, "-o", "bad")
    assert run.code == 2 and message in run.err.replace("\\", "/"), run.err
    assert run.err.count("\n") <= 2 and not (place / "bad").exists()


def test_a_blank_frame_is_refused_without_an_option_of_another_command(lfcal: Lfcal, place: Path) -> None:
    tifffile.imwrite(place / "blank.tif", np.zeros(PLAN.camera.sensor.shape, np.uint16))
    run = lfcal("watch", "monday", "blank.tif", *GIVEN)
    assert run.code == 2 and run.err.strip().endswith("record it again, or leave it out"), run.err
