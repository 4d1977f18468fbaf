"""Which way frames lie, of simulated R29 and microscope sessions with noise, dead frames and cells off the middle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.frames import ORIENTATIONS, ArraySource, FrameSource, OrientedSource, open_frames
from lfcal.psf._spot_path import path_frames
from lfcal.psf.orientation import find_orientation


def looked_at(plan: ScanPlan, folder: Path) -> FrameSource:
    """Return the frames of a plan that are looked at, as the simulated camera records them, two of them dark."""
    (folder / "plan.json").write_text(plan.to_json())
    with open_frames(folder / "plan.json") as source:
        infos = [source.info(k) for k in range(len(source))]
        chosen = path_frames(infos, plan.shape[:3])
        frames = np.stack([source.read(k) for k in chosen]).astype(np.float32)
    frames += 4.0 * np.random.default_rng(0).standard_normal(frames.shape)
    frames[[1, 9]] = np.median(frames) + 4.0 * np.random.default_rng(1).standard_normal(frames[:2].shape)
    return ArraySource(frames, [infos[k].position for k in chosen])


def plan_of(name: str, shape: tuple[int, int], **options: Any) -> ScanPlan:
    camera = preset(name)
    return ScanPlan.for_camera(replace(camera, sensor=replace(camera.sensor, shape=shape)), **options)


SESSIONS = {
    "microscope": lambda: plan_of("lfm_20x05", (260, 340), depths_um=[-20.0, 0.0, 20.0], anchor=(100.0, 120.0)),
    "r29": lambda: plan_of("r29", (420, 520), virtual_depths=[-3.0, 2.2, 4.0], anchor=(110.0, 150.0)),
}


@pytest.mark.long
@pytest.mark.parametrize("session", ["microscope", "r29"])
def test_all_eight_are_recognised(session: str, tmp_path: Path) -> None:
    plan = SESSIONS[session]()
    frames = looked_at(plan, tmp_path)
    for name, one in ORIENTATIONS.items():
        found = find_orientation(OrientedSource(frames, one.inverse), plan)
        assert found.name == name, found
        assert found.cause == ("" if name == "as is" else "frames"), found
