"""The sample session of an installed package: frames made from compact light equal those of the checkout."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import platformdirs
import pytest

from lfcal.base import read_text
from lfcal.camera import ScanPlan
from lfcal.frames import open_frames
from lfcal.simulate import sample, sample_session
from lfcal.simulate.sample import pack_light, unpack_light

DATA = Path(__file__).resolve().parents[2] / "sample_data"
OTHER = ("camera.json", "plan.json", "truth.json", "dark", "white")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the cache folder of a package that contains only what the wheel contains."""
    session = tmp_path / "lfcal" / "_sample_session"
    session.mkdir(parents=True)
    for name in OTHER:
        (shutil.copytree if (DATA / "session" / name).is_dir() else shutil.copyfile)(
            DATA / "session" / name, session / name
        )
    shutil.copyfile(DATA / "light.xz", session / "light.xz")
    monkeypatch.setattr(sample, "__file__", str(tmp_path / "lfcal" / "simulate" / "sample.py"))
    cache = tmp_path / "cache"
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda name: cache)
    return cache


def frame(folder: Path, name: str) -> np.ndarray:
    image = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16
    return image.astype(int)


@pytest.mark.long
def test_frames_are_those_of_the_checkout_within_a_fraction_of_the_noise(installed: Path) -> None:
    found, kept = sample_session(), DATA / "session"
    assert found.parent == installed
    plan = ScanPlan.from_json(read_text(kept / "plan.json"))
    names = {str(path.relative_to(kept)) for path in kept.rglob("*")}
    assert names <= {str(path.relative_to(found)) for path in found.rglob("*")}
    assert (found / "frames/manifest.csv").read_text() == (kept / "frames/manifest.csv").read_text()
    gain, black = plan.camera.sensor.electrons_per_count, plan.camera.sensor.black_level
    for path in sorted(kept.glob("frames/*.png"))[::50]:
        one, other = frame(found, f"frames/{path.name}"), frame(kept, f"frames/{path.name}")
        electrons = np.maximum(other - black, 0) * gain
        noise = np.sqrt(plan.camera.sensor.read_noise_e**2 + electrons) / gain
        # half a step of the stored light, and rounding to counts
        assert (np.abs(one - other) <= 0.5 * sample.STEP * noise + 1).all()
        assert (one != other).mean() < 0.1 and abs((one - other).mean()) < 0.05
    with open_frames(found / "frames", plan_shape=plan.shape[:3]) as source:
        assert len(source) == plan.n_positions
    # they are made once, and again where one was lost, as after a power failure
    first = found / "frames" / "z0_y00_x00.png"
    made, content = first.stat().st_mtime_ns, first.read_bytes()
    assert sample_session() == found and first.stat().st_mtime_ns == made
    first.write_bytes(b"")
    assert sample_session() == found and first.read_bytes() == content
    assert [path.name for path in installed.iterdir()] == [found.name]


@pytest.mark.long
def test_without_a_cache_folder_the_frames_are_temporary(installed: Path, tmp_path: Path) -> None:
    installed.write_text("a file in place of the folder")
    found = sample_session()
    assert tmp_path not in found.parents and len(list((found / "frames").glob("*.png"))) == 1254
    assert sample_session() == found


def test_packed_light_is_within_half_a_step_of_its_noise() -> None:
    plan = ScanPlan.from_json(read_text(DATA / "session" / "plan.json"))
    plan = replace(plan, depths_um=plan.depths_um[:1], exposure_s=plan.exposures[:1])
    (nz, ny, nx), sensor = plan.shape[:3], plan.camera.sensor
    light = np.random.default_rng(1).gamma(0.2, 400, (nz, 1, 2, *sensor.shape)).astype(np.float32)
    light[0, 0, 0] = 0
    wanted = light.repeat(ny, 1).repeat((nx + 1) // 2, 2)[:, :, :nx]
    unpacked = unpack_light(pack_light(wanted, plan), plan)
    assert (unpacked[0, 0, 0] == 0).all()
    noise = np.sqrt(sensor.read_noise_e**2 + np.maximum(wanted, unpacked))
    assert (np.abs(unpacked - wanted) <= 0.5 * sample.STEP * noise * (1 + 1e-6)).all()
