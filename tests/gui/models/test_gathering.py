"""What the next step depends on, as it is on disk now."""

from __future__ import annotations

import shutil
from pathlib import Path

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
