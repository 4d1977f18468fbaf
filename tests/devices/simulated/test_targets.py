"""A target before the simulated camera shows what the frames of the simulator show."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan
from lfcal.devices.protocols import Roi
from lfcal.devices.simulated._targets import TargetPattern, TargetRenderer, simulated_target
from lfcal.targets import Pose, Target, TargetCamera, TargetPlan
from tests.targets.common import small


@pytest.fixture(scope="module")
def plan() -> TargetPlan:
    scan = ScanPlan.for_camera(small(160), virtual_depths=(4.0,), cutout=31)
    step = scan.camera.step_um(scan.depths_um[0])
    target = Target("square", (2, 2), (60 * step, 62 * step), pose=Pose(rotation_rad=0.02))
    return TargetPlan(scan, target, (((0.0, 0.0), (3.3, -5.25)),), 0.1, (0.0,), "geometric")


def place(plan: TargetPlan, k: int) -> tuple[float, float, float]:
    right, down = plan.offsets_um(0)[k].tolist()
    return right, down, plan.scan.depths_um[0]


@pytest.mark.parametrize("k", [0, 1])
def test_the_stage_moves_the_target_as_planned(plan: TargetPlan, k: int) -> None:
    frames = TargetCamera(plan, ())
    patch = TargetRenderer(frames).render(place(plan, k), 2 * plan.scan.exposures[0], Roi(0, 0, 160, 160))
    gain = plan.scan.camera.sensor.electrons_per_count
    np.testing.assert_allclose(patch.counts * gain / 2, frames.light(k), rtol=1e-5, atol=1e-3)


def test_a_depth_that_is_no_plane_is_refused(plan: TargetPlan) -> None:
    x, y, z = place(plan, 0)
    with pytest.raises(InputError, match="a plane of the plan"):
        TargetRenderer(TargetCamera(plan, ())).render((x, y, z + 1000.0), 0.02, Roi(0, 0, 160, 160))


def test_the_quick_pattern_lies_at_every_hole_as_bright_as_it_is(plan: TargetPlan) -> None:
    light = np.array([1.0, 0.0, 1.0, 2.0])
    patch = TargetPattern(plan.scan, plan.target, light).render(place(plan, 1), 0.02, Roi(10, 20, 140, 120))
    sums = []
    images = plan.images(0)
    for row, column in np.rint(images.moved(np.array([3.3, -5.25]))).astype(int).tolist():
        sums.append(patch.counts[row - 22 : row + 3, column - 32 : column - 7].sum())
    np.testing.assert_allclose(np.array(sums) / sums[0], light, rtol=0.1)


def test_effects_change_the_frame_where_they_act(plan: TargetPlan, tmp_path: Path) -> None:
    """With the distortion of a main lens the images away from the axis move; noise is left to the camera."""
    (tmp_path / "plan.json").write_text(plan.to_json())
    (tmp_path / "effects.json").write_text(json.dumps([{"name": "distortion", "relative": -0.05, "radius_um": 300.0}]))
    file, whole = str(tmp_path / "plan.json"), Roi(0, 0, 160, 160)
    straight, bent = (
        simulated_target(plan.scan, file, "geometric", effects).render(place(plan, 0), 0.02, whole)
        for effects in ("", str(tmp_path / "effects.json"))
    )
    assert np.abs(bent.counts - straight.counts).sum() > 0.1 * straight.counts.sum()
    assert bent.counts.sum() == pytest.approx(float(straight.counts.sum()), rel=0.2)
