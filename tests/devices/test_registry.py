"""Backends found by name, absent ones with their reason, those of other packages."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import label

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.devices import registry
from lfcal.devices.backends import _aravis_lib
from lfcal.devices.errors import DeviceMissing
from lfcal.devices.protocols import CameraDevice, Light, StageDevice
from lfcal.devices.registry import Backend, find_backends, get_backend, open_rig
from lfcal.devices.rig import Rig
from lfcal.devices.simulated._camera import SimCamera
from tests.acquire.rigs import rig_for, small_plan

PLAN = small_plan()


def test_all_own_backends_are_listed() -> None:
    found = {finding.name: finding for finding in find_backends()}
    assert list(found)[:5] == ["sim", "aravis", "folder", "gentl", "micromanager"]
    for name in list(found)[:5]:
        backend = get_backend(name)
        assert isinstance(backend, Backend)
        assert backend.name == name
        assert found[name].available == bool(found[name].version)
    assert found["sim"].available


def test_simulated_devices_fulfil_the_protocols() -> None:
    rig = rig_for(PLAN)
    assert isinstance(rig.camera, CameraDevice)
    assert isinstance(rig.stage, StageDevice)
    assert isinstance(rig.light, Light)


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

    name = "foreign"
    title = "camera of somebody else"
    has_stage = True
    options: Mapping[str, str] = {"gain": "gain (dB)"}

    def probe(self) -> str:
        return "1.0"

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        return rig_for(plan)


def points(monkeypatch: pytest.MonkeyPatch, **values: Any) -> None:
    """Pretend that other packages declare these entry points."""

    class Point:
        def __init__(self, name: str, value: Any) -> None:
            self.name, self.value = name, value

        def load(self) -> Any:
            if isinstance(self.value, Exception):
                raise self.value
            return self.value

    monkeypatch.setattr(metadata, "entry_points", lambda group: [Point(k, v) for k, v in values.items()])
    monkeypatch.setattr(registry, "BACKENDS", registry.backend_registry())


def test_another_package_registers_through_an_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    points(monkeypatch, foreign=Foreign)
    with open_rig(PLAN, "foreign", {"gain": "3"}) as rig:
        assert rig.camera.sensor_shape == (96, 96)
    with pytest.raises(InputError, match="option of foreign: expected gain"):
        open_rig(PLAN, "foreign", {"brightness": "3"})


def test_broken_packages_are_named_and_harm_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    points(monkeypatch, broken=ImportError("no libfoo.so"), wrong=object(), sim=Foreign)
    found = {finding.name: finding for finding in find_backends()}
    assert "no libfoo.so" in found["broken"].reason
    assert "expected a backend with name" in found["wrong"].reason
    assert found["sim"].title == "simulated camera and stage"
    for name, reason in (("broken", "ImportError: no libfoo.so"), ("wrong", "expected a backend with name")):
        with pytest.raises(DeviceMissing, match=f"device backend {name}: .*{reason}.*; update or remove"):
            get_backend(name)


class Named:
    """A backend whose name is known once it is made."""

    title, has_stage, options = "made late", True, Foreign.options

    def __init__(self) -> None:
        self.name = "late"

    probe, open = Foreign.probe, Foreign.open


def test_an_entry_point_may_be_an_object_or_a_class(monkeypatch: pytest.MonkeyPatch) -> None:
    points(monkeypatch, foreign=Foreign(), late=Named)
    assert isinstance(get_backend("foreign"), Foreign)
    assert isinstance(get_backend("late"), Named)


def test_the_simulator_shows_plenoptic_frames_to_whoever_opens_it() -> None:
    """The lenslets image the pupil: many separate spots, where the quick pattern is a single blurred one."""
    camera = preset("bench")
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[4.0]), period=(2, 3))
    light = []
    for optics in ("geometric", "wave"):
        with open_rig(plan, "sim", {"optics": optics}) as rig:
            x, y, z = plan.stage_um(np.array([0, 1, 1])).tolist()
            rig.stage.move((x, y, z))
            rig.time.sleep(1e4)
            rig.camera.set_exposure(plan.exposures[0])
            light.append(rig.camera.grab(1.0).data.astype(float) - camera.sensor.black_level)
    with pytest.raises(InputError, match="option optics"):
        open_rig(plan, "sim", {"optics": "magic"})
    spots = [int(label(frame > 0.3 * frame.max())[1]) for frame in light]
    assert min(spots) >= 5
    assert np.corrcoef(light[0].ravel(), light[1].ravel())[0, 1] > 0.5


def test_the_simulator_takes_the_effects_of_a_file(tmp_path: Path) -> None:
    """Crosstalk of 20 % to each neighbour of two lines leaves (1 - 0.4)² in the middle and spreads the rest."""
    camera = preset("bench")
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[4.0]), period=(2, 3))
    path = tmp_path / "effects.json"
    path.write_text('[{"name": "crosstalk", "share": 0.2}, {"name": "lenslet_diffraction", "setting": "off"}]')
    spread = []
    for options in ({}, {"effects": str(path)}):
        with open_rig(plan, "sim", {"optics": "geometric", **options}) as rig:
            x, y, z = plan.stage_um(np.array([0, 1, 1])).tolist()
            rig.stage.move((x, y, z))
            rig.time.sleep(1e4)
            rig.camera.set_exposure(plan.exposures[0])
            frame = rig.camera.grab(1.0).data.astype(float) - camera.sensor.black_level
            spread.append(int((frame > 0.1 * frame.max()).sum()))
    assert spread[1] > 1.5 * spread[0]


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


@pytest.mark.parametrize(
    "options",
    [
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
    ],
)
def test_bad_options_of_the_simulator_are_refused(options: dict[str, str]) -> None:
    with pytest.raises(InputError):
        open_rig(PLAN, "sim", options)
