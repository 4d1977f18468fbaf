"""The same 27 positions with real components: Micro-Manager's demo devices, Aravis's fake camera, a GenTL producer."""

from __future__ import annotations

import importlib.util
import itertools
import shutil
import subprocess
import sys
import time
import types
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.errors import AcquisitionStopped
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session import record
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan
from lfcal.devices.errors import CameraError, DeviceError, DeviceLost, DeviceMissing, StageError
from lfcal.devices.protocols import CameraDevice, Roi, Setting, StageDevice
from lfcal.devices.registry import find_backends, open_rig
from lfcal.devices.rig import Rig
from tests.acquire.rigs import CAREFUL, small_plan

REASONS = {finding.name: finding.reason for finding in find_backends()}
FAKE = shutil.which("arv-fake-gv-camera-0.8")
ADDRESS = "127.0.0.1"
# test cameras show their own picture wherever the stage is
OPTIONS = replace(CAREFUL, origin_tolerance_px=None, retries=2, on_suspect="flag")


def needs(name: str, extra: str = "") -> Any:
    reason = REASONS.get(name, "") or extra
    return pytest.mark.skipif(bool(reason), reason=reason or "here")


def missing(module: str, remedy: str) -> str:
    return "" if importlib.util.find_spec(module) else f"{module} is not installed: {remedy}"


def plan_for(shape: tuple[int, int], bits: int) -> ScanPlan:
    plan = small_plan(shape=shape, exposure_s=0.001, settle_s=0.0)
    sensor = replace(plan.camera.sensor, bit_depth=bits, black_level=0.0)
    return replace(plan, camera=replace(plan.camera, sensor=sensor))


def check_session(folder: Path, plan: ScanPlan) -> None:
    tolerance = np.array(OPTIONS.motion(plan).tolerance_um)
    with RecordingSource(folder) as source:
        assert len(source) == 27 and source.read(26).shape == (21, 21)
        for k in range(27):
            away = source.record(k)["stage_um"] - plan.stage_um(np.array(source.info(k).position))
            assert np.all(np.abs(away) <= tolerance)


def check_camera(rig: Rig, bits: int) -> None:
    camera, roi = rig.camera, Roi(10, 20, 33, 45)
    assert isinstance(camera, CameraDevice) and isinstance(rig.stage, StageDevice)
    assert (camera.bit_depth, camera.max_value) == (bits, 2**bits - 1)
    setting = camera.set_exposure(0.002)
    assert setting.requested == 0.002 and setting.actual == pytest.approx(0.002, rel=0.1)
    taken = camera.set_roi(roi)
    assert taken.requested == roi and taken.actual.holds(roi)
    first, second = camera.grab(5.0), camera.grab(5.0)
    assert first.data.shape == second.data.shape == taken.actual.shape
    assert second.number > first.number and first.status == "complete"


# -- Micro-Manager -------------------------------------------------------------------------------------
MM = needs("micromanager", missing("mm_test_adapters", "pip install mm-test-adapters"))
MM_OPTIONS = {
    "config": "demo",
    "limits": "-1e5:1e5,-1e5:1e5,-1e5:1e5",
    "light": "White Light Shutter",
    "set": "Camera.PixelType=16bit;Camera.BitDepth=12;XY.Velocity=10000",
}


@contextmanager
def micromanager(plan: ScanPlan, **changes: str) -> Iterator[Rig]:
    options = {**MM_OPTIONS, **changes}
    try:
        rig = open_rig(plan, "micromanager", options)
    except DeviceMissing:
        raise
    except Exception:
        # not every version of the demo stage has a velocity
        options["set"] = options["set"].replace(";XY.Velocity=10000", "")
        rig = open_rig(plan, "micromanager", options)
    with rig:
        yield rig


@MM
def test_micromanager_demo_records_27_positions(tmp_path: Path) -> None:
    plan = replace(plan_for((512, 512), 12), depths_um=(0.0, 60.0, 120.0))
    with micromanager(plan) as rig:
        check_camera(rig, 12)
        assert "DemoCamera" in rig.camera.name
        assert rig.camera.fixed_settings()["Gain"] == Setting(None, "0")  # type: ignore[attr-defined]
        options = replace(OPTIONS, darks=2, tolerance_um=(1.0, 1.0, 1.0))
        assert record(tmp_path, plan, rig, options).how == "complete"
    check_session(tmp_path, plan)


@pytest.fixture(params=["pymmcore", "pymmcore-plus"])
def running(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Open the demo devices in the core of pymmcore-plus, or in a core that it would return."""
    pymmcore, adapters = pytest.importorskip("pymmcore"), pytest.importorskip("mm_test_adapters")
    if request.param == "pymmcore-plus":
        core = pytest.importorskip("pymmcore_plus", reason="pymmcore-plus is not installed").CMMCorePlus.instance()
    else:
        core = pymmcore.CMMCore()
        module = types.SimpleNamespace(__version__="0.1", CMMCorePlus=types.SimpleNamespace(instance=lambda: core))
        monkeypatch.setitem(sys.modules, "pymmcore_plus", module)
    core.setDeviceAdapterSearchPaths([str(adapters.device_adapter_path())])
    core.loadSystemConfiguration(str(Path(str(adapters.device_adapter_path())) / "MMConfig_demo.cfg"))
    yield core
    core.reset()


def state_of(core: Any) -> dict[str, Any]:
    labels = core.getLoadedDevices()
    values = {
        f"{label}.{key}": core.getProperty(label, key)
        for label in labels
        for key in core.getDevicePropertyNames(label)
        if "Position" not in key and not core.isPropertyReadOnly(label, key)
    }
    return {"labels": labels, "roi": core.getROI(), "exposure": core.getExposure(), **values}


@MM
def test_a_running_core_is_shared_and_left_as_it_was(tmp_path: Path, running: Any) -> None:
    plan = replace(plan_for((512, 512), 12), depths_um=(0.0, 60.0, 120.0))
    running.setExposure(17.0)
    running.setROI(8, 16, 128, 64)
    running.setAutoShutter(True)
    before = state_of(running)
    options = {"limits": MM_OPTIONS["limits"], "set": "Camera.PixelType=16bit;Camera.BitDepth=12"}
    with open_rig(plan, "pymmcore-plus", options) as rig:
        check_camera(rig, 12)
        assert running.getAutoShutter() is False
        taken = replace(OPTIONS, tolerance_um=(1.0, 1.0, 1.0))
        assert record(tmp_path, plan, rig, taken).how == "complete"
    check_session(tmp_path, plan)
    assert running.getAutoShutter() is True and state_of(running) == before


@MM
def test_a_running_core_without_devices_or_in_live_view_is_refused(running: Any) -> None:
    plan, limits = plan_for((512, 512), 12), {"limits": MM_OPTIONS["limits"]}
    with pytest.raises(InputError, match="expected nothing, got demo; leave it out: the core has devices"):
        open_rig(plan, "pymmcore-plus", {**limits, "config": "demo"})
    before = state_of(running)
    with pytest.raises(DeviceMissing, match="Nikon"):
        open_rig(plan, "pymmcore-plus", {**limits, "xy": "Nikon"})
    assert state_of(running) == before
    running.startContinuousSequenceAcquisition(1.0)
    with pytest.raises(DeviceError, match="stop the live view first"):
        open_rig(plan, "pymmcore-plus", limits)
    running.stopSequenceAcquisition()
    running.unloadAllDevices()
    with pytest.raises(InputError, match="or load the devices in this process first"):
        open_rig(plan, "pymmcore-plus", limits)


def test_a_missing_pymmcore_plus_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymmcore_plus", None)
    with pytest.raises(DeviceMissing, match="pymmcore-plus: not installed; run pip install pymmcore-plus"):
        open_rig(plan_for((512, 512), 12), "pymmcore-plus", {})


@MM
def test_micromanager_faults_are_typed() -> None:
    plan = plan_for((512, 512), 12)
    with micromanager(plan) as rig:
        with pytest.raises(StageError, match="out of range"):
            rig.stage.move((0.0, 0.0, 1e9))
        rig.stage.stop()
        rig.camera._core.unloadDevice("Camera")  # type: ignore[attr-defined]
        with pytest.raises(CameraError, match="check the camera"):
            rig.camera.grab(1.0)
    for options, error, words in (
        ({"config": "demo"}, InputError, "give the travel"),
        ({"config": "/nowhere.cfg", "limits": MM_OPTIONS["limits"]}, InputError, "check the path"),
        ({**MM_OPTIONS, "camera": "Nikon"}, DeviceMissing, "Micro-Manager camera"),
    ):
        with pytest.raises(error, match=words):
            open_rig(plan, "micromanager", options)


# -- Aravis --------------------------------------------------------------------------------------------
FAKE_REASON = "" if FAKE else "arv-fake-gv-camera-0.8 is not installed: apt-get install aravis-tools"
ARAVIS = needs("aravis", FAKE_REASON)


@contextmanager
def fake_camera(lost_per_thousand: int = 0, description: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Run Aravis's GigE Vision camera on the loopback interface, with features of its own or as described."""
    assert FAKE is not None
    command = [FAKE, "-i", ADDRESS, "-s", "TEST", "-r", str(lost_per_thousand)]
    command += [] if description is None else ["-g", str(description)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        time.sleep(0.2)
        assert process.poll() is None
        yield process
    finally:
        process.kill()
        process.wait()


def aravis(plan: ScanPlan, **changes: str) -> Rig:
    options = {"camera": ADDRESS, "format": "Mono8", "sim.velocity": "1e6", **changes}
    return open_rig(plan, "aravis", options, stage="sim")


@ARAVIS
@pytest.mark.parametrize("trigger", ["software", "none"])
def test_aravis_records_27_positions(tmp_path: Path, trigger: str) -> None:
    plan = plan_for((2048, 2048), 8)
    with fake_camera(), aravis(plan, trigger=trigger) as rig:
        check_camera(rig, 8)
        if trigger == "software":
            assert record(tmp_path, plan, rig, OPTIONS).how == "complete"
            check_session(tmp_path, plan)


@pytest.mark.long
@ARAVIS
def test_aravis_losing_packets_retries_and_keeps_only_whole_frames(tmp_path: Path) -> None:
    plan = plan_for((2048, 2048), 8)
    with fake_camera(20), aravis(plan, packet_size="1400") as rig:
        rig.camera.set_roi(Roi(0, 0, 200, 200))
        assert {rig.camera.grab(5.0).status for _ in range(12)} != {"complete"}
        stubborn = replace(OPTIONS, retries=40, overshoot_um=(0.0, 0.0, 0.0))
        assert record(tmp_path, plan, rig, stubborn).how == "complete"
    check_session(tmp_path, plan)


@ARAVIS
@pytest.mark.long
def test_aravis_camera_killed_in_the_middle_stops_and_resumes(tmp_path: Path) -> None:
    plan, taken = plan_for((2048, 2048), 8), itertools.count(1)
    options = replace(OPTIONS, grab_timeout_s=0.3)
    with fake_camera() as process, aravis(plan) as rig:
        watch = lambda *_: process.kill() if next(taken) == 8 else None  # noqa: E731
        with pytest.raises(AcquisitionStopped, match="no answer") as caught:
            record(tmp_path, plan, rig, options, observers=(watch,))
    assert isinstance(caught.value.cause, DeviceLost) and 8 <= caught.value.acknowledged < 27
    with fake_camera(), aravis(plan) as rig:
        assert record(tmp_path, plan, rig, options, resume=True).how == "complete"
    check_session(tmp_path, plan)


@ARAVIS
def test_aravis_names_what_is_missing() -> None:
    plan = plan_for((2048, 2048), 8)
    with pytest.raises(DeviceMissing, match="check power, cable and address"):
        aravis(plan, camera="127.0.0.99")
    with fake_camera():
        with pytest.raises(InputError, match=r"expected Mono or Bayer.* 12Packed, got R"):
            aravis(plan, format="RGB8")
        with pytest.raises(InputError, match="choose a backend"):
            open_rig(plan, "aravis", {"camera": ADDRESS})


# -- GenTL ---------------------------------------------------------------------------------------------
GENTL = needs("gentl")
GENTL_OPTIONS = {
    "cti": "virtual",
    "format": "Mono8",
    "set": "AcquisitionFrameRate=200;Width=320;Height=320",
    "sim.velocity": "1e6",
}


@GENTL
def test_gentl_records_27_positions(tmp_path: Path) -> None:
    plan = plan_for((320, 320), 8)
    with open_rig(plan, "gentl", GENTL_OPTIONS, stage="sim") as rig:
        check_camera(rig, 8)
        assert "Viky" in rig.camera.name
        assert record(tmp_path, plan, rig, OPTIONS).how == "complete"
    check_session(tmp_path, plan)


@GENTL
def test_gentl_names_what_is_missing() -> None:
    for options, error, words in (
        ({"cti": "/nowhere.cti"}, InputError, "give the manufacturer's file"),
        ({**GENTL_OPTIONS, "camera": "77"}, DeviceMissing, "0 to 2"),
        ({**GENTL_OPTIONS, "format": "RGBa8"}, InputError, r"expected Mono or Bayer.* 12Packed, got R"),
        ({**GENTL_OPTIONS, "set": "NoSuchFeature=1"}, CameraError, "check that the camera has this feature"),
    ):
        with pytest.raises(error, match=words):
            open_rig(plan_for((320, 320), 8), "gentl", options, stage="sim")
