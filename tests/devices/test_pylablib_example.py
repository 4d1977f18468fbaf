"""The example package for pylablib, with simulated devices that have the methods which its documentation describes."""

from __future__ import annotations

import importlib.util
import sys
import tomllib
import types
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session import record
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan
from lfcal.devices import CameraError, DeviceMissing, FrameTimeout, Roi, StageError, open_rig
from tests.acquire.rigs import CAREFUL, small_plan
from tests.architecture.sources import ROOT

FOLDER = ROOT / "packaging" / "examples" / "lfcal-pylablib"
OPTIONS = {
    **{"camera": "Maker.Camera", "x": "Maker.Motor:1", "y": "Maker.Motor:2", "z": "Maker.Motor:3"},
    "limits": "-1e5:1e5,-1e5:1e5,-1e5:1e5",
}


class Camera:
    """A sensor of 70 columns and 60 rows; regions are (first column, end, first row, end) and begin at even pixels."""

    TimeoutError = type("TimeoutError", (Exception,), {})

    def __init__(self) -> None:
        self.roi, self.exposure, self.closed, self.fault = (0, 70, 0, 60), 0.1, False, ""
        self.sensor = np.arange(60 * 70, dtype=np.int32).reshape(60, 70) % 4000

    def get_detector_size(self) -> tuple[int, int]:
        return 70, 60

    def set_exposure(self, seconds: float) -> float:
        self.exposure = round(seconds, 4)
        return self.exposure

    def get_exposure(self) -> float:
        return self.exposure

    def set_roi(self, hstart: int = 0, hend: int | None = None, vstart: int = 0, vend: int | None = None) -> Any:
        self.roi = (hstart // 2 * 2, hend or 70, vstart // 2 * 2, vend or 60)
        return self.get_roi()

    def get_roi(self) -> tuple[int, ...]:
        return (*self.roi, 1, 1)

    def snap(self, timeout: float = 5.0) -> Any:
        if self.fault:
            raise self.TimeoutError("late") if self.fault == "late" else RuntimeError(self.fault)
        left, right, top, bottom = self.roi
        return self.sensor[top:bottom, left:right]

    def close(self) -> None:
        self.closed = True


class Motor:
    """A motor that counts in metres."""

    made: ClassVar[dict[str, Motor]] = {}

    def __init__(self, serial: str) -> None:
        if serial == "none":
            raise RuntimeError("no such device")
        self.place, self.closed = 0.0, False
        self.made[serial] = self

    def move_to(self, position: float) -> None:
        self.place = position

    def get_position(self) -> float:
        return self.place

    def is_moving(self) -> bool:
        return False

    def stop(self) -> None: ...

    def home(self, sync: bool = True, force: bool = False) -> None:
        self.place = 0.0

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def backend(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Yield the backend of the package, with a pylablib of one maker."""
    monkeypatch.setattr(Motor, "made", {})
    maker = types.SimpleNamespace(Camera=Camera, Motor=Motor)
    for name, module in (("pylablib", types.SimpleNamespace(__version__="1.4")), ("pylablib.devices.Maker", maker)):
        monkeypatch.setitem(sys.modules, name, module)
    yield package().PylablibBackend()


def package() -> Any:
    """Load the module that the entry point of the package names."""
    said = tomllib.loads((FOLDER / "pyproject.toml").read_text())["project"]
    module, _, name = said["entry-points"]["lfcal.devices"]["pylablib"].partition(":")
    spec = importlib.util.spec_from_file_location(module, FOLDER / f"{module}.py")
    assert spec is not None and spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    assert hasattr(made, name)
    return made


def plan_of_camera() -> ScanPlan:
    return small_plan(shape=(60, 70), exposure_s=0.001, settle_s=0.0)


def test_a_scan_is_recorded(tmp_path: Path, backend: Any) -> None:
    plan = plan_of_camera()
    with open_rig(plan, backend, OPTIONS) as rig:
        options = replace(CAREFUL, origin_tolerance_px=None, on_suspect="flag", tolerance_um=(0.1, 0.1, 0.1))
        assert record(tmp_path, plan, rig, options).how == "complete"
        camera: Any = rig.camera
    assert all(motor.closed for motor in Motor.made.values()) and len(Motor.made) == 3
    sensor = Camera().sensor
    with RecordingSource(tmp_path) as source:
        for k in range(len(source)):
            row, column = source.info(k).origin
            nt, ns = source.shape
            np.testing.assert_array_equal(source.read(k), sensor[row : row + nt, column : column + ns])
    assert camera.name == "pylablib Maker.Camera"


def test_regions_units_and_errors(backend: Any) -> None:
    with open_rig(plan_of_camera(), backend, {**OPTIONS, "um_per_unit": "1e6"}) as rig:
        taken = rig.camera.set_roi(Roi(5, 11, 20, 30)).actual
        assert taken == Roi(4, 10, 21, 31)
        np.testing.assert_array_equal(rig.camera.grab(1.0).data, Camera().sensor[4:25, 10:41])
        assert rig.camera.set_exposure(0.01234).actual == 0.0123
        rig.stage.move((100.0, -50.0, 3.0))
        assert [Motor.made[name].place for name in "123"] == pytest.approx([1e-4, -5e-5, 3e-6])
        assert rig.stage.position() == pytest.approx((100.0, -50.0, 3.0))
        Motor.made["2"].get_position = lambda: 1 / 0  # type: ignore[method-assign]
        with pytest.raises(StageError, match="check the device"):
            rig.stage.position()
        device = rig.camera._camera  # type: ignore[attr-defined]
        for fault, kind in (("late", FrameTimeout), ("unplugged", CameraError)):
            device.fault = fault
            with pytest.raises(kind):
                rig.camera.grab(1.0)


def test_what_cannot_be_opened_leaves_nothing_open(backend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_of_camera()
    with pytest.raises(InputError, match=r"option y: expected MAKER\.CLASS .*got 'Other\.Motor'"):
        open_rig(plan, backend, {**OPTIONS, "y": "Other.Motor"})
    with pytest.raises(Exception, match="no such device"):
        open_rig(plan, backend, {**OPTIONS, "z": "Maker.Motor:none"})
    assert all(motor.closed for motor in Motor.made.values())
    monkeypatch.setitem(sys.modules, "pylablib", None)
    with pytest.raises(DeviceMissing, match="install it with pip install pylablib"):
        open_rig(plan, backend, OPTIONS)
