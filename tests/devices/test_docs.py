"""The backend shown in the documentation is complete and records a session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from lfcal.acquire.session import record
from lfcal.devices.protocols import CameraDevice, StageDevice
from lfcal.devices.registry import Backend
from tests.acquire.rigs import CAREFUL, frames_of, small_plan
from tests.distribution import code_of


def test_the_documented_backend_works(tmp_path: Path) -> None:
    blocks = code_of("extending.md", "A device")
    assert len(blocks) == 1
    lines = [line for line in blocks[0].splitlines() if line.strip()]
    assert len(lines) <= 40
    names: dict[str, Any] = {}
    exec(blocks[0], names)
    backend = names["CountingBackend"]()
    assert isinstance(backend, Backend)
    plan = small_plan(shape=(320, 320), settle_s=0.0)
    with backend.open(plan, {}) as rig:
        assert isinstance(rig.camera, CameraDevice)
        assert isinstance(rig.stage, StageDevice)
        assert record(tmp_path, plan, rig, replace(CAREFUL, origin_tolerance_px=None)).how == "complete"
    frames = frames_of(tmp_path)
    assert len({frame.tobytes() for frame in frames.values()}) == 27
