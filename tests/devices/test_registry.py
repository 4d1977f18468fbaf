"""Backends found by name, absent ones with their reason, those of other packages."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import label

from lfcal.acquire.session import record
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.devices import registry
from lfcal.devices.backends import _aravis_lib
from lfcal.devices.errors import DeviceMissing
from lfcal.devices.protocols import CameraDevice, Light, StageDevice
from lfcal.devices.registry import Backend, find_backends, get_backend, open_rig
from lfcal.devices.rig import Rig
from lfcal.devices.simulated._camera import SimCamera
from tests.acquire.rigs import CAREFUL, frames_of, rig_for, small_plan
from tests.distribution import code_of

PLAN = small_plan()


def test_all_own_backends_are_listed_and_the_simulated_devices_fulfil_the_protocols() -> None:
    found = {finding.name: finding for finding in find_backends()}
    names = ["sim", "aravis", "folder", "gentl", "micromanager"]
    assert list(found)[:5] == names and found["sim"].available
    for name in names:
        backend = get_backend(name)
        assert isinstance(backend, Backend) and backend.name == name
        assert found[name].available == bool(found[name].version)
    rig = rig_for(PLAN)
    for device, protocol in ((rig.camera, CameraDevice), (rig.stage, StageDevice), (rig.light, Light)):
        assert isinstance(device, protocol)


def test_absence_has_a_reason_and_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymmcore", None)
    monkeypatch.setitem(sys.modules, "harvesters", None)
    monkeypatch.setattr(_aravis_lib, "NAMES", ("libnothing.so",))
    monkeypatch.setattr(_aravis_lib.ctypes.util, "find_library", lambda _: None)
    _aravis_lib.library.cache_clear()
    try:
        found = {finding.name: finding for finding in find_backends()}
        for name, what in (("micromanager", "pip install"), ("gentl", "pip install"), ("aravis", "apt install")):
            assert not found[name].available
            assert what in found[name].reason
        with pytest.raises(DeviceMissing, match="apt install"):
            open_rig(PLAN, "aravis", stage="sim")
    finally:
        _aravis_lib.library.cache_clear()


class Foreign:
    """A backend of another package."""

    name, title, has_stage = "foreign", "camera of another maker", True
    options: Mapping[str, str] = {"gain": "gain (dB)"}

    def probe(self) -> str:
        return "1.0"

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        return rig_for(plan)


class Named(Foreign):
    """A backend whose name is known once it is made."""

    def __init__(self) -> None:
        self.name = "late"


def points(monkeypatch: pytest.MonkeyPatch, **values: Any) -> None:
    """Pretend that other packages declare these entry points."""

    def load(value: Any) -> Any:
        if isinstance(value, Exception):
            raise value
        return value

    made = [SimpleNamespace(name=name, load=partial(load, value)) for name, value in values.items()]
    monkeypatch.setattr(metadata, "entry_points", lambda group: made)
    monkeypatch.setattr(registry, "BACKENDS", registry.backend_registry())


def test_another_package_registers_a_class_or_an_object_through_an_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    points(monkeypatch, foreign=Foreign(), late=Named)
    assert isinstance(get_backend("late"), Named)
    with open_rig(PLAN, "foreign", {"gain": "3"}) as rig:
        assert rig.camera.sensor_shape == (96, 96)
    with pytest.raises(InputError, match="option of foreign: expected gain"):
        open_rig(PLAN, "foreign", {"brightness": "3"})


def test_broken_packages_are_named_and_leave_the_others_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    points(monkeypatch, broken=ImportError("no libfoo.so"), wrong=object(), sim=Foreign)
    found = {finding.name: finding for finding in find_backends()}
    assert "no libfoo.so" in found["broken"].reason
    assert "expected a backend with name" in found["wrong"].reason
    assert found["sim"].title == "simulated camera and stage"
    for name, reason in (("broken", "ImportError: no libfoo.so"), ("wrong", "expected a backend with name")):
        with pytest.raises(DeviceMissing, match=f"device backend {name}: .*{reason}.*; update or remove"):
            get_backend(name)


BENCH = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0]), period=(2, 3))


def simulated_frame(**options: str) -> np.ndarray:
    """Return a frame of the simulator, less its black level."""
    with open_rig(BENCH, "sim", options) as rig:
        rig.stage.move(tuple(BENCH.stage_um(np.array([0, 1, 1])).tolist()))
        rig.time.sleep(1e4)
        rig.camera.set_exposure(BENCH.exposures[0])
        return rig.camera.grab(1.0).data.astype(float) - BENCH.camera.sensor.black_level


def test_the_simulator_shows_plenoptic_frames() -> None:
    """The lenslets image the pupil: many separate spots, where the quick pattern is a single blurred one."""
    light = [simulated_frame(optics=optics) for optics in ("geometric", "wave")]
    assert min(int(label(frame > 0.3 * frame.max())[1]) for frame in light) >= 5
    assert np.corrcoef(light[0].ravel(), light[1].ravel())[0, 1] > 0.5


def test_the_simulator_takes_the_effects_of_a_file(tmp_path: Path) -> None:
    """Crosstalk of 20 % to each neighbour of two lines leaves (1 - 0.4)² in the middle and spreads the rest."""
    path = tmp_path / "effects.json"
    path.write_text('[{"name": "crosstalk", "share": 0.2}, {"name": "lenslet_diffraction", "setting": "off"}]')
    plain, spread = simulated_frame(optics="geometric"), simulated_frame(optics="geometric", effects=str(path))
    assert (spread > 0.1 * spread.max()).sum() > 1.5 * (plain > 0.1 * plain.max()).sum()


def test_stage_of_another_backend_and_its_options() -> None:
    with open_rig(PLAN, "folder", {"path": ".", "sim.velocity": "1e6"}, stage="sim") as rig:
        assert rig.stage.name == "simulated stage"
        assert rig.camera.name.startswith("files")
        assert len(rig.others) == 2
        others = [getattr(device, "device", device) for device in rig.others]
        unused = next(device for device in others if isinstance(device, SimCamera))
        assert unused.optics == "pattern", "no optics are computed for a camera that takes no frames"
    with pytest.raises(InputError, match="option of folder"):
        open_rig(PLAN, "folder", {"path": ".", "nonsense": "1"}, stage="sim")
    with pytest.raises(InputError, match="a backend with a stage"):
        open_rig(PLAN, "sim", stage="gentl")
    with pytest.raises(InputError, match="choose one of these"):
        open_rig(PLAN, "nothing")


def test_bad_options_of_the_simulator_are_refused() -> None:
    for options in (
        {"velocity": "fast"},
        {"limits": "0:1"},
        {"limits": "1:0,0:1,0:1"},
        {"axes": "+x"},
        {"faults": "times out"},
        {"faults": "explodes@3"},
        {"time": "never"},
        {"optics": "magic"},
        {"seed": "-1"},
        {"optics": "pattern", "effects": "effects.json"},
    ):
        with pytest.raises(InputError, match="expected"):
            open_rig(PLAN, "sim", options)


# -- the backend of the documentation --------------------------------------------------------------------
def test_the_documented_backend_works(tmp_path: Path) -> None:
    (block,) = code_of("extending.md", "A device")
    assert len([line for line in block.splitlines() if line.strip()]) <= 40
    names: dict[str, Any] = {}
    exec(block, names)
    backend, plan = names["CountingBackend"](), small_plan(shape=(320, 320), settle_s=0.0)
    assert isinstance(backend, Backend)
    with backend.open(plan, {}) as rig:
        assert isinstance(rig.camera, CameraDevice) and isinstance(rig.stage, StageDevice)
        assert record(tmp_path, plan, rig, replace(CAREFUL, origin_tolerance_px=None)).how == "complete"
    assert len({frame.tobytes() for frame in frames_of(tmp_path).values()}) == 27
