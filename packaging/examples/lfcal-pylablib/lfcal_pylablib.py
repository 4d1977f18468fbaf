"""Cameras and motors of pylablib (https://pylablib.readthedocs.io/) as devices of lfcal.

lfcal uses micrometres, seconds and (row, column). pylablib gives regions as (first column, end column, first row, end
row) and the positions of a motor in the unit of its driver.
"""

from __future__ import annotations

import contextlib
import importlib
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from lfcal.base import InputError
from lfcal.devices import (
    CameraError,
    DeviceMissing,
    Frame,
    FrameTimeout,
    Rig,
    Roi,
    Setting,
    StageError,
    limits_option,
    number_option,
)

INSTALL = "install it with pip install pylablib"


class PylablibBackend:
    """Backend for a camera and three motors of pylablib."""

    name, title, has_stage = "pylablib", "cameras and motors of pylablib", True
    options: Mapping[str, str] = {
        "camera": "class of the camera and its arguments, such as Thorlabs.ThorlabsTLCamera:serial",
        "bits": "bits per sample of the camera; by default those of the sensor in the plan",
        "x": "class of the motor of the x axis and its arguments, such as Thorlabs.KinesisMotor:27000001",
        "y": "the same for y",
        "z": "the same for z",
        "um_per_unit": "micrometres per unit of the motor positions; by default 1e6, for metres",
        "limits": "travel x0:x1,y0:y1,z0:z1 (µm)",
    }

    def probe(self) -> str:
        """Return the version of pylablib; raises `DeviceMissing` if it is not installed."""
        try:
            return f"pylablib {getattr(importlib.import_module('pylablib'), '__version__', '')}".strip()
        except ImportError:
            raise DeviceMissing(f"pylablib: not installed; {INSTALL}") from None

    def open(self, plan: Any, options: Mapping[str, str]) -> Rig:
        """Open the camera and the motors."""
        limits = limits_option(options)
        if limits is None:
            raise InputError.expected("option limits", "x0:x1,y0:y1,z0:z1 in µm", "nothing", "give the travel")
        scale = number_option(options, "um_per_unit", 1e6, low=1e-9)
        bits = int(number_option(options, "bits", plan.camera.sensor.bit_depth, low=1, high=16))
        with contextlib.ExitStack() as stack:  # if a device cannot be opened, those opened before are closed
            camera, *motors = [_opened(options, key, stack) for key in ("camera", "x", "y", "z")]
            stack.pop_all()
        return Rig(_Camera(camera, options["camera"], bits), _Stage(motors, options, limits, scale))


class _Camera:
    """A camera of pylablib; `snap` starts the exposure, so that each frame is new."""

    def __init__(self, camera: Any, name: str, bits: int) -> None:
        self._camera, self.name = camera, f"pylablib {name}"
        self.bit_depth, self.max_value = bits, (1 << bits) - 1
        width, height = camera.get_detector_size()
        self.sensor_shape = (int(height), int(width))
        camera.set_roi()
        self._number = 0

    def set_exposure(self, seconds: float) -> Setting[float]:
        """Set the exposure time (s)."""
        with _errors(self.name, CameraError):
            self._camera.set_exposure(seconds)
            return Setting(seconds, float(self._camera.get_exposure()))

    def set_roi(self, roi: Roi) -> Setting[Roi]:
        """Set the region that the camera reads; it may choose a larger one."""
        with _errors(self.name, CameraError):
            self._camera.set_roi(roi.column, roi.column + roi.columns, roi.row, roi.row + roi.rows)
            left, right, top, bottom = self._camera.get_roi()[:4]
        return Setting(roi, Roi(int(top), int(left), int(bottom - top), int(right - left)))

    def grab(self, timeout_s: float) -> Frame:
        """Take a frame."""
        started = time.monotonic()
        with _errors(self.name, CameraError):
            try:
                data = self._camera.snap(timeout=timeout_s)
            except getattr(self._camera, "TimeoutError", TimeoutError):
                raise FrameTimeout(f"{self.name}: no frame in {timeout_s:g} s; check trigger and cable") from None
            exposure = float(self._camera.get_exposure())
        self._number += 1
        frame = np.array(data).astype(np.uint8 if self.bit_depth <= 8 else np.uint16, copy=False)
        return Frame(frame, self._number, exposure, started)

    def close(self) -> None:
        """Close the camera."""
        self._camera.close()


class _Stage:
    """Three motors, one for each axis."""

    def __init__(self, motors: list[Any], options: Mapping[str, str], limits: Any, scale: float) -> None:
        self._motors, self.limits, self._scale = motors, limits, scale
        self.name = "pylablib " + ", ".join(options[axis] for axis in "xyz")

    def move(self, target: tuple[float, float, float]) -> None:
        """Begin to move to ``target`` (µm)."""
        self._each(lambda motor, at: motor.move_to(at / self._scale), target)

    def moving(self) -> bool:
        """Return whether any motor is moving."""
        return any(self._each(lambda motor, _: bool(motor.is_moving())))

    def position(self) -> tuple[float, float, float]:
        """Return the position that the motors report (µm)."""
        x, y, z = self._each(lambda motor, _: float(motor.get_position()) * self._scale)
        return x, y, z

    def stop(self) -> None:
        """Stop all motors."""
        self._each(lambda motor, _: motor.stop())

    def home(self) -> None:
        """Begin to move all motors to their reference switches."""
        self._each(lambda motor, _: motor.home(sync=False))

    def close(self) -> None:
        """Close all motors."""
        self._each(lambda motor, _: motor.close())

    def _each(self, call: Callable[[Any, float], Any], values: tuple[float, ...] = (0.0, 0.0, 0.0)) -> list[Any]:
        with _errors(self.name, StageError):
            return [call(motor, value) for motor, value in zip(self._motors, values, strict=True)]


@contextlib.contextmanager
def _errors(name: str, kind: type[Exception]) -> Iterator[None]:
    """Convert the errors of a driver to ``kind``, after which lfcal retries."""
    try:
        yield
    except (CameraError, StageError, FrameTimeout):
        raise
    except Exception as error:  # each driver of pylablib defines its own errors
        raise kind(f"{name}: {error}; check the device and its cable") from error


def _opened(options: Mapping[str, str], key: str, stack: contextlib.ExitStack) -> Any:
    """Open the device named by the option ``key``; ``stack`` closes it."""
    place, _, given = options.get(key, "").partition(":")
    maker, _, name = place.partition(".")
    try:
        kind = getattr(importlib.import_module(f"pylablib.devices.{maker}"), name) if maker and name else None
    except (ImportError, AttributeError):
        kind = None
    if kind is None:
        wanted, remedy = "MAKER.CLASS of pylablib.devices, or MAKER.CLASS:ARGUMENTS", "see the pages of pylablib"
        raise InputError.expected(f"option {key}", wanted, repr(options.get(key, "")), remedy)
    device = kind(*filter(None, given.split(",")))
    stack.callback(device.close)
    return device
