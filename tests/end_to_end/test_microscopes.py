"""Microscope presets and periods of broken numbers of pixels, from the plan to the volume, as a user runs them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.camera import ScanPlan, preset
from lfcal.psf import open_psf
from lfcal.simulate import plan_effects
from lfcal.simulate.response import PlaneResponse
from tests.cli.conftest import Lfcal, Run

ALARMS = {"period", "stage_gain", "position", "jitter", "pitch", "seam", "hot", "order"}
"""Metrics that would be wrong, not only strict, about frames that were scaled."""


def described(name: str, side: int, folder: Path) -> Path:
    """Write the preset with a small sensor; return its file."""
    camera = preset(name)
    path = folder / "camera.json"
    path.write_text(replace(camera, sensor=replace(camera.sensor, shape=(side, side))).to_json())
    return path


def succeeded(run: Run) -> Run:
    assert run.code == 0, run.err
    return run


@pytest.mark.long
def test_a_deep_range_of_the_preset_is_simulated(lfcal: Lfcal, tmp_path: Path) -> None:
    out = tmp_path / "H.h5"
    succeeded(lfcal("simulate", "lfm_20x05", "--depths", "-30:30:30", "-o", out))
    with open_psf(out) as H:
        light = [H.plane(z).sum(axis=(2, 3)) for z in range(3)]
    assert all(0.98 < part.min() <= part.max() <= 1.005 for part in light)


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("name", "side", "planes", "cutout", "bound"),
    [
        ("lfm_60x12", 100, ("--depths", "-1.5"), "61", 0.08),
        pytest.param("lfm_20x05", 110, ("--depths", "-10,12"), "75", 0.05, marks=pytest.mark.long),
    ],
)
def test_frames_of_a_resampled_plan_become_the_simulated_h(
    lfcal: Lfcal, tmp_path: Path, name: str, side: int, planes: tuple[str, str], cutout: str, bound: float
) -> None:
    camera, plan, session = described(name, side, tmp_path), tmp_path / "plan.json", tmp_path / "session"
    succeeded(lfcal("plan", camera, *planes, "--cutout", cutout, "--resample", "-o", plan))
    succeeded(lfcal("simulate", plan, "-o", tmp_path / "H.h5"))
    succeeded(lfcal("simulate", plan, "--frames", session))
    succeeded(lfcal("assemble", session / "frames", "--dark", session / "dark", "-o", tmp_path / "A.h5"))
    with open_psf(tmp_path / "H.h5") as direct, open_psf(tmp_path / "A.h5") as assembled:
        assert direct.shape == assembled.shape and direct.pixel_scale == pytest.approx(assembled.pixel_scale)
        for z in range(direct.shape[0]):
            wanted, found = (H.plane(z).astype(float) for H in (direct, assembled))
            found *= wanted.sum() / found.sum()
            assert np.abs(found - wanted).sum() < bound * wanted.sum()
    report = succeeded(lfcal("inspect", tmp_path / "A.h5", "--json")).json
    merits = {m["key"]: m["merit"] for m in report["metrics"]}
    assert {key: merits[key] for key in ALARMS & set(merits) if merits[key] in ("fair", "bad")} == {}


def light_of(plan: ScanPlan, points: list[tuple[int, float, float]]) -> np.ndarray:
    """Return the sensor's light of points (plane, row, column) anywhere between the positions of the plan."""
    effects = plan_effects(plan, 0.03).effects
    rows, columns = plan.camera.sensor.shape
    image = np.zeros((rows + 200, columns + 200))
    for z, y, x in points:
        fy, fx = plan.resample_factors
        response = PlaneResponse(plan, z, effects, cutout=(91, 91), on_sensor=True)
        for row, column, values in response.point(y / fy, x / fx):
            top, left = (int(a) + k + 100 - 45 for a, k in zip(plan.anchor, (row, column), strict=True))
            image[top : top + 91, left : left + 91] += values
    return image[100:-100, 100:-100]


@pytest.mark.long
def test_points_between_the_voxels_are_found_where_they_are(lfcal: Lfcal, tmp_path: Path) -> None:
    """A noisy frame on the sensor's own pixels, reconstructed with the resampled H from the camera alone."""
    camera, plan_file, volume = described("lfm_60x12", 130, tmp_path), tmp_path / "plan.json", tmp_path / "v.npy"
    planes = "-1.5,-0.75,0.75,1.5"
    succeeded(lfcal("plan", camera, "--depths", planes, "--cutout", "75", "--resample", "-o", plan_file))
    succeeded(lfcal("simulate", plan_file, "-o", tmp_path / "H.h5"))
    plan = ScanPlan.from_json(plan_file.read_text())
    points = [(0, -10.3, 12.4), (1, 22.6, -14.2), (2, 20.3, 28.7), (3, -13.4, -11.2)]
    noise = np.random.default_rng(5)
    light = noise.poisson(4e5 * light_of(plan, points)) + 100 + noise.normal(0, 1.5, plan.camera.sensor.shape)
    tifffile.imwrite(tmp_path / "frame.tif", light.clip(0, 65535).round().astype(np.uint16))
    frame = tmp_path / "frame.tif"
    run = lfcal("reconstruct", tmp_path / "H.h5", frame, "--background", 100, "-n", 10, "-o", volume)
    succeeded(run)
    found = np.load(volume)
    # position (0, 0) of H is where the frame's chief ray goes: a whole pixel of the result (see `Resampling`)
    origin = np.array([c - (n - 1) / 2 for c, n in zip((0, 0), plan.period, strict=True)])
    middle = (np.array(found.shape[1:]) - 1) / 2
    for z, y, x in points:
        near = middle + origin + (y, x)
        top, left = (max(0, round(v) - 5) for v in near)
        window = found[:, top : top + 11, left : left + 11]
        k, row, column = np.unravel_index(int(window.argmax()), window.shape)
        assert k == z and np.abs(np.array([top + row, left + column]) - near).max() <= 2.0


@pytest.mark.long
@pytest.mark.parametrize("by", ["camera", "white"])
def test_a_three_type_array_of_broken_period_from_the_plan_to_the_volume(lfcal: Lfcal, tmp_path: Path, by: str) -> None:
    """A light field on the sensor's own pixels, by the lattice that the camera states or a white frame shows."""
    camera = preset("bench")
    camera_file, plan_file, session = tmp_path / "camera.json", tmp_path / "plan.json", tmp_path / "session"
    camera_file.write_text(replace(camera, sensor=replace(camera.sensor, shape=(140, 140))).to_json())
    planes = ("--virtual-depths", 4, "--cutout", 49)
    succeeded(lfcal("plan", camera_file, *planes, "--resample", "-o", plan_file))
    succeeded(lfcal("simulate", plan_file, "--frames", session))
    succeeded(lfcal("assemble", session / "frames", "--dark", session / "dark", "-o", tmp_path / "H.h5"))
    report = succeeded(lfcal("inspect", tmp_path / "H.h5", "--json")).json
    assert {m["key"]: m["value"] for m in report["metrics"] if m["merit"] == "bad"} == {}
    plan = ScanPlan.from_json(plan_file.read_text())
    ny, nx = plan.period
    points = [(0, 0.3 * ny + 0.4, 0.2 * nx + 0.3), (0, 0.7 * ny - 0.2, 0.75 * nx + 0.4)]
    noise = np.random.default_rng(5)
    black = plan.camera.sensor.black_level
    light = noise.poisson(2e5 * light_of(plan, points)) / 10 + black
    frame = tmp_path / "frame.tif"
    tifffile.imwrite(frame, light.clip(0, 65535).round().astype(np.uint16))
    # the lattice's type-0 lenslet at the middle of the sensor is the origin of the grid, on its own scale
    scale, zero = np.array(plan.resample_factors), np.array(plan.camera.sensor.centre_px)
    volume = tmp_path / "volume.npy"
    work = ("reconstruct", tmp_path / "H.h5", frame, "--resample", "always", "--background", black)
    own = ("--white", session / "white") if by == "white" else ()
    succeeded(lfcal(*work, *own, "-n", 30, "-o", volume))
    found = np.load(volume)[0]
    # the first pixel: as far up and left as the frame goes, whole pixels from position (0, 0)
    about = np.array(plan.lattice_anchor) * scale
    first = np.ceil(-zero * scale - about - 1e-9) + about
    for _, y, x in points:
        near = (np.array(plan.anchor) + np.array([y, x]) / scale - zero) * scale - first
        top, left = (max(0, round(v) - 6) for v in near)
        window = found[top : top + 13, left : left + 13]
        at = np.unravel_index(int(window.argmax()), window.shape)
        assert np.abs(np.array([top, left]) + at - near).max() <= 2.0


def test_a_frame_of_another_grid_is_resampled(lfcal: Lfcal, tmp_path: Path) -> None:
    camera, plan = described("lfm_60x12", 90, tmp_path), tmp_path / "plan.json"
    succeeded(lfcal("plan", camera, "--depths", "1", "--cutout", "41", "--resample", "-o", plan))
    succeeded(lfcal("simulate", plan, "-o", tmp_path / "H.h5"))
    tifffile.imwrite(tmp_path / "frame.tif", np.ones((90, 90), np.uint16))
    run = lfcal("reconstruct", tmp_path / "H.h5", tmp_path / "frame.tif", "-n", "1", "-o", tmp_path / "v.npy")
    assert run.code == 0 and "px over the frame relative to H's period" in run.err and "are resampled" in run.err
