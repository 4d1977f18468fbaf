"""What the next step depends on, as it is on disk now."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal_gui.models.gathering import sitting_of
from lfcal_gui.models.next_step import next_step
from lfcal_gui.models.project import ProjectState
from tests.cli.conftest import small_plan


def test_a_folder_of_frames_that_is_gone_is_asked_for_again(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    plan = small_plan()
    project = ProjectState("gone", plan.camera, plan, frames=str(folder))

    def button() -> str:
        return next_step(sitting_of(project, {}, (), page="frames", place="record")).button

    assert button() == "Assemble H"
    shutil.rmtree(folder)
    assert button() == "Import folder …"


def test_the_time_of_the_scan_follows_the_speed_and_frame_rate_of_set_up() -> None:
    plan = small_plan()

    def seconds(**rates: Any) -> float:
        found = sitting_of(ProjectState("", plan.camera, plan, settings={"plan": rates}), {}, ()).record_s
        assert found is not None
        return found

    usual = seconds()
    assert seconds(frame_rate=2.0) - usual == pytest.approx(plan.n_positions / 2)
    steps_um = np.abs(np.diff(plan.stage_um(plan.order_indices()), axis=0)).max(axis=1)
    assert seconds(speed=10.0) - usual == pytest.approx(steps_um.sum() * (1 / 10 - 1 / 1000))
    assert seconds(speed=-1.0, frame_rate="fast") == usual, "refused values take their defaults"


@pytest.mark.parametrize(
    ("chosen", "button"),
    [({}, "Use the simulated rig"), ({"acquire": {"backend": "micromanager"}}, "Connect camera and stage")],
)
def test_the_devices_that_are_connected_next_are_named(chosen: dict[str, Any], button: str) -> None:
    """A new project connected "camera and stage", and got the simulated ones."""
    plan = small_plan()
    project = ProjectState(camera=plan.camera, plan=plan, settings=chosen)
    found = sitting_of(project, {}, (), page="acquire", place="record")
    step = next_step(replace(found, wrong="", white=True))
    assert (step.button, step.action) == (button, "acquire.connect")
