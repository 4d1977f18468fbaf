"""``lfcal multiplex coding`` against the library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfcal.camera import preset
from lfcal.multiplex import (
    code_matrix,
    coding_gain,
    coding_pays,
    display_fit,
    display_frames,
    overlapping_patterns,
    s_matrix,
    sensor_noise,
)
from lfcal.psf import PSFMatrix, open_psf, save
from tests.cli.conftest import Run

CAMERA = preset("bench")


@pytest.fixture
def matrix(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:9, :9] - 4
    core = np.exp(-(y**2 + x**2) / 2.0)
    values = (core * rng.uniform(0.5, 1, (2, 4, 5, 9, 9))).astype(np.float32)
    save(PSFMatrix(values, depths=(-20_000.0, -26_000.0), camera=CAMERA), tmp_path / "H.h5")
    return tmp_path / "H.h5"


def test_the_gains_are_the_library_s(lfcal: Callable[..., Run], matrix: Path, tmp_path: Path) -> None:
    words = ("multiplex", "coding", matrix, "--plane", 1, "--points", 7, "--step", 2, "--at", "1,2", "--signal", 300)
    words = (*words, "--gain", 2, "--exposure", 0.1)
    done = lfcal(*words, "--monte-carlo", 200, "-o", tmp_path / "gain.png", "--json")
    assert done.code == 0, done.err
    with open_psf(matrix) as H:
        light, _ = overlapping_patterns(H[1], 7, step=2, first=(1, 2))
    noise = sensor_noise(CAMERA.sensor, gain=2.0, exposure_s=0.1)
    found = coding_gain(light, s_matrix(7), noise, signal_e=300.0)
    for key, numbers in (("equal_time", found.time), ("equal_full_well", found.full_well)):
        assert done.json[key]["rms_db"] == pytest.approx(numbers.rms_db)
        assert done.json[key]["exposure"] == pytest.approx(numbers.exposure)
        assert done.json["measured_db"][key.removeprefix("equal_")] == pytest.approx(numbers.rms_db, abs=0.05)
    verdict = coding_pays(light, noise, signal_e=300.0)
    assert done.json["pays"]["time"] is verdict.pays and done.json["frames"] == 7
    assert done.json["break_even_e"] == pytest.approx(verdict.break_even_e)
    assert cv2.imread(str(tmp_path / "gain.png")).std() > 5
    table = lfcal(*words)
    assert table.code == 0 and "equal full well" in table.out and "coding" in table.err
    random = lfcal(*words, "--code", "random", "--frames", 14, "--density", 0.3, "--seed", 3, "--json")
    code = code_matrix("random", 7, frames=14, density=0.3, rng=np.random.default_rng(3))
    wanted = coding_gain(light, code, noise, signal_e=300.0).time.rms_db
    assert random.json["equal_time"]["rms_db"] == pytest.approx(wanted)
    corrected = lfcal(*words, "--json", "--uncorrected", "--workers", 1)
    assert corrected.code == 0 and corrected.json["full_e"] == pytest.approx(noise.full_e)


def test_patterns_for_a_display(lfcal: Callable[..., Run], matrix: Path, tmp_path: Path) -> None:
    step = CAMERA.step_um(-20_000.0)
    display = f"64x48@{step / 2:.6f}"
    words = ("multiplex", "coding", matrix, "--points", 7, "--display", display)
    done = lfcal(*words, "--patterns", tmp_path / "code", "--repeat", 11, "--json")
    assert done.code == 0 and len(done.json["files"]) == 8, done.err
    assert done.json["display"]["fits"] and done.json["display"]["needed_um"] == pytest.approx(step)
    np.testing.assert_array_equal(np.load(tmp_path / "code/code.npy"), s_matrix(7))
    places = np.array([[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2], [2, 0]])
    fit = display_fit(step, float(display.partition("@")[2]))
    for k, shown in enumerate(display_frames(s_matrix(7), places, fit, (48, 64), repeat=(11, 11))):
        seen = cv2.imread(str(tmp_path / f"code/code_{k:03d}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(seen, shown)
    again = lfcal(*words, "--patterns", tmp_path / "code")
    assert again.code == 2 and "--force" in again.err
    large = lfcal("multiplex", "coding", matrix, "--display", "64x48@300")
    assert large.code == 0 and "too coarse" in large.err


def test_patterns_of_a_described_camera(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    done = lfcal("multiplex", "coding", "bench", "--points", 3, "--virtual-depth", 3, "--signal", 100, "--json")
    assert done.code == 0 and "simulated" in done.json["source"], done.err
    assert done.json["equal_time"]["dark_db"] is not None
    words = ("multiplex", "coding", "bench", "--points", 3, "--json")
    zero, default = lfcal(*words, "--virtual-depth", 0), lfcal(*words)
    assert zero.code == default.code == 0 and zero.json["source"] != default.json["source"], "0 is a depth"
    loud = replace(CAMERA, sensor=replace(CAMERA.sensor, read_noise_e=300.0))
    (tmp_path / "loud.json").write_text(loud.to_json())
    more = lfcal("multiplex", "coding", "bench", "--points", 3, "--sensor", tmp_path / "loud.json", "--json")
    assert more.code == 0 and more.json["additive_e2"] > 9e4


def test_what_is_refused(lfcal: Callable[..., Run], matrix: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "bare.npy", np.ones((1, 2, 2, 3, 3), np.float32))
    for more, word in (
        (("--code", "H"), "code"),
        (("--points", 1), "points"),
        (("--plane", 7), "plane"),
        (("--depth", 5), "--depth"),
        (("--at", "1"), "y,x"),
        (("--at", "²,1"), "y,x"),
        (("--signal", "nan"), "electrons"),
        (("--signal", 1e9), "electrons"),
        (("--frames", 9), "frames"),
        (("--code", "random", "--density", 2), "fraction"),
        (("--display", "64@3"), "display"),
        (("--display", "64x48@nan"), "display"),
        (("--display", "64x48@-1"), "display"),
        (("--patterns", tmp_path / "code"), "--display"),
        (("--display", "2x2@1", "--patterns", tmp_path / "code"), "block"),
        (("--sensor", "nothing"), "camera"),
        (("-o", matrix, "--force"), "other than the input"),
    ):
        refused = lfcal("multiplex", "coding", matrix, *more)
        assert refused.code == 2 and word in refused.err and "Traceback" not in refused.err, (more, refused.err)
    bare = lfcal("multiplex", "coding", tmp_path / "bare.npy")
    assert bare.code == 2 and "--sensor" in bare.err
    assert lfcal("multiplex", "coding", tmp_path / "bare.npy", "--sensor", "r29", "--points", 2).code == 0
