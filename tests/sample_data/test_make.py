"""The sample session is what its script makes, and it is small, complete and good."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest

from lfcal.acquire import read_checks
from lfcal.camera import Camera, ScanPlan
from lfcal.frames import open_frames
from lfcal.simulate import SimulatedCamera
from lfcal.simulate.sample import unpack_light

FOLDER = Path(__file__).resolve().parents[2] / "sample_data"
SESSION, RECORDED = FOLDER / "session", FOLDER / "recorded"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("sample_make", FOLDER / "make.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def same(name: str, frame: np.ndarray) -> None:
    """Hold a frame made anew against the file: the same counts, but for single roundings on another processor."""
    kept = cv2.imread(str(SESSION / name), cv2.IMREAD_UNCHANGED)
    assert kept.dtype == np.uint16 and kept.shape == frame.shape
    difference = np.abs(kept.astype(int) - frame.astype(int))
    assert difference.max() <= 1 and (difference > 0).mean() < 1e-3, name


def test_the_script_makes_this_dark_frame(script: ModuleType) -> None:
    same("dark/dark_3.png", script.sample_source().dark_frame(3))


@pytest.mark.long
@pytest.mark.parametrize("number", [7, 700])
def test_the_script_makes_these_frames(script: ModuleType, number: int) -> None:
    source = script.sample_source()
    same(f"frames/{script.frame_name(source.position(number))}", source.read(number))


@pytest.mark.long
def test_the_light_in_a_package_is_that_of_the_script(script: ModuleType) -> None:
    source = script.sample_source()
    lights = unpack_light((FOLDER / "light.xz").read_bytes(), source.plan)
    read_noise = source.camera.sensor.read_noise_e
    for number in (0, 333, 1253):
        wanted, found = source.light(number), lights[source.position(number)]
        assert wanted.max() > 1000
        assert (np.abs(found - wanted) <= 0.16 * np.sqrt(read_noise**2 + np.maximum(wanted, found))).all()


def test_descriptions_fit(script: ModuleType) -> None:
    plan = ScanPlan.from_json((SESSION / "plan.json").read_text())
    assert plan == script.sample_plan()
    assert Camera.from_json((SESSION / "camera.json").read_text()) == plan.camera
    assert json.loads((SESSION / "truth.json").read_text())["seed"] == script.SEED
    with open_frames(SESSION / "frames", plan_shape=plan.shape[:3]) as source:
        assert len(source) == plan.n_positions
        assert sorted(source.info(k).position for k in range(len(source))) == sorted(plan.positions())


def test_it_is_small_and_16_bit() -> None:
    files = [p for p in SESSION.rglob("*") if p.is_file()]
    assert sum(p.stat().st_size for p in files) < 10e6
    assert len(list((SESSION / "dark").glob("*.png"))) >= 4 and len(list((SESSION / "white").glob("*.png"))) >= 2
    frame = cv2.imread(str(SESSION / "frames" / "z1_y09_x16.png"), cv2.IMREAD_UNCHANGED)
    assert frame.dtype == np.uint16 and frame.max() < 4095, "nothing saturated"


@pytest.mark.long
def test_the_recorded_session_is_what_its_script_records(script: ModuleType, tmp_path: Path) -> None:
    """Recorded anew for a few positions: the camera's noise belongs to the order of exposures, not to the clock."""
    plan = script.recorded_plan()
    with open_frames(RECORDED) as source:
        assert source.metadata.plan == plan and len(source) == plan.n_positions
        assert {source.info(k).exposure_s for k in range(len(source))} == {0.02}
        assert list(source.metadata.darks) == [0.02]
        assert all(source.samples(k).saturated == 0 for k in range(0, len(source), 60))
        optics = SimulatedCamera(plan, script.OPTICS, **script.FINELY, peak=0.8, seed=script.SEED)
        gain, black = plan.camera.sensor.electrons_per_count, plan.camera.sensor.black_level
        places = {tuple(optics.info(k).position): k for k in range(len(optics))}
        for k in (0, 300, 626):
            info = source.info(k)
            rows, columns = (slice(a, a + n) for a, n in zip(info.origin, source.shape, strict=True))
            light = optics.light(places[tuple(info.position)])[rows, columns] / gain
            error = (source.read(k) - black - light) / np.sqrt(light / gain + 5.0)
            assert abs(float(error.mean())) < 0.2 and float(error.std()) < 1.6
    assert sum(p.stat().st_size for p in RECORDED.iterdir()) < 4e6
    assert len(read_checks(RECORDED)) == 8
