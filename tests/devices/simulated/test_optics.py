"""What the simulated camera sees of a source between the planes of its plan."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.axes import centre
from lfcal.camera import ScanPlan
from lfcal.devices.protocols import Roi
from lfcal.devices.simulated._optics import FramesRenderer
from lfcal.devices.simulated.backend import SimBackend
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.sensor.responses import place
from lfcal.targets import Target
from tests.simulate.common import BASE, FAST, difference, small_plan


def renderer(plan: ScanPlan) -> FramesRenderer:
    return FramesRenderer(plan, SimulatedCamera(plan, BASE, sampling=FAST))


def seen(made: FramesRenderer, source_um: tuple[float, float, float], exposure_s: float = 0.02) -> np.ndarray:
    row, column, counts = made.render(source_um, exposure_s, Roi(0, 0, 1, 1))
    frame = np.zeros(made._plan.camera.sensor.shape, np.float32)
    place(frame, counts, row + centre(counts.shape[0]), column + centre(counts.shape[1]))
    return frame


def test_moving_the_source_away_changes_the_picture() -> None:
    """The picture of the nearest plane was shown, however far away that was."""
    plan = small_plan()
    made = renderer(plan)
    y, x = (n // 2 for n in plan.period)
    index = next(k for k in range(plan.n_positions) if tuple(plan.order_indices()[k]) == (0, y, x))
    right, down, away = plan.object_um(made._frames.info(index).position).tolist()
    in_plane = seen(made, (right, down, away))
    assert difference(seen(made, (right, down, away + 1.0)), in_plane) == 0, "a stage never stands quite in the plane"
    depth = plan.camera.depth_of(plan.camera.virtual_depth(away) + 0.7)
    there = seen(made, (right, down, depth))
    assert difference(there, in_plane) > 0.2
    assert np.allclose(seen(made, (right, down, depth), 0.04), 2 * there), "twice the exposure, twice the light"
    camera: SimulatedCamera = made._frames  # type: ignore[assignment]
    light = camera.light_of((round(right, 3), round(down, 3), round(depth, 3)))
    assert np.allclose(there * plan.camera.sensor.electrons_per_count, light * 0.02 / plan.exposures[0])


@pytest.mark.parametrize("optics", ["pattern", "geometric", "target"])
def test_the_source_is_equally_bright_whatever_the_plan_exposes(tmp_path: Path, optics: str) -> None:
    """The light jumped by 14 % where a session resumed, whose exposures had been measured between two connections."""
    plan, file = small_plan(), tmp_path / "target.json"
    file.write_text(json.dumps(Target("square", (2, 2), (1000.0, 1000.0)).to_dict()))
    options = {"optics": "geometric", "target": str(file)} if optics == "target" else {"optics": optics}
    planes = len(plan.depths_um)
    frames = []
    for exposures in (0.02, (0.0175, *(0.03,) * (planes - 1))):
        with SimBackend().open(replace(plan, exposure_s=exposures), options) as rig:
            rig.stage.move(tuple(plan.stage_um([0, 1, 1]).tolist()))
            while rig.stage.moving():
                rig.time.sleep(0.1)
            frames.append(rig.camera.grab(0.02).data)
    assert frames[0].max() > 1.5 * plan.camera.sensor.black_level
    np.testing.assert_array_equal(frames[0], frames[1])
