"""Wrappers of camera, stage and light: each call has a time limit, and each answer is checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property
from numbers import Integral, Real
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from lfcal.devices.calling import CANCELLED, Caller, never
from lfcal.devices.errors import CameraError, DeviceError, StageError, driver_errors
from lfcal.devices.protocols import (
    CameraDevice,
    Frame,
    Light,
    Limits,
    MovedElsewhere,
    Point,
    Rendered,
    Roi,
    Setting,
    StageDevice,
)

__all__ = ["CheckedCamera", "CheckedLight", "CheckedStage"]

SETTING_S, LIGHT_S, MOVE_S = 10.0, 30.0, 60.0
"""Time limits for a setting of the camera, for switching the light and for a move (s)."""

D = TypeVar("D")

POINT = [float, float, float]
"""Types of a position from most drivers, for a quick check twice per frame."""

REMEDY = "update or correct the driver"


def _name(device: object, usual: str) -> str:
    """Return the name of a device whose answers are not checked yet."""
    with driver_errors(usual):
        name = getattr(device, "name", None)
    if not isinstance(name, str) or not name.strip():
        raise DeviceError.expected(f"name of the {usual}", "a text of at least one letter", repr(name), REMEDY)
    return name


def _whole(value: object, low: int) -> bool:
    if type(value) is int:  # called for every frame: the general test takes a microsecond
        return value >= low
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= low


def _number(value: object) -> bool:
    return type(value) is float or (isinstance(value, Real) and not isinstance(value, bool))


class _Checked(Generic[D]):
    """A device whose answers are checked; its other attributes are available through this object."""

    usual: ClassVar[str]

    def __init__(self, device: D) -> None:
        self.device = device
        # a light has no name
        self.name = self.usual if self.usual == "light" else _name(device, self.usual)
        self._caller = Caller(device, self.name)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the device that is not part of the protocol."""
        if name == "device":  # not yet set while this object is copied
            raise AttributeError(name)
        return getattr(self.device, name)

    @classmethod
    def of(cls, device: D) -> Self:
        """Return a device wrapped in its checks; a wrapped device is returned unchanged."""
        return device if isinstance(device, cls) else cls(device)

    @property
    def hangs(self) -> bool:
        """Whether the driver still hangs in an abandoned call."""
        return self._caller.hangs

    def close(self) -> None:
        """Release the device, unless its driver hangs, because closing would then hang too."""
        if not self.hangs:
            self._caller.call("close", self.device.close)  # type: ignore[attr-defined]  # a light is not closed


class CheckedCamera(_Checked[CameraDevice]):
    """A camera whose calls have a time limit and whose answers are checked.

    Parameters
    ----------
    device
        The camera; its other attributes are available through this object.

    Raises
    ------
    CameraError
        In any call, if the answer is not allowed by the protocol.
    DeviceLost
        In any call, if the driver does not return in time.
    """

    usual = "camera"

    @cached_property
    def sensor_shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of the whole sensor (px)."""
        shape = self._ask("sensor_shape")
        if not (isinstance(shape, tuple | list) and len(shape) == 2 and all(_whole(n, 1) for n in shape)):
            raise self._wrong("sensor_shape", "rows and columns", shape)
        return int(shape[0]), int(shape[1])

    @cached_property
    def bit_depth(self) -> int:
        """Number of bits per sample."""
        bits = self._ask("bit_depth")
        if not _whole(bits, 1) or bits > 16:
            raise self._wrong("bit_depth", "1 to 16", bits)
        return int(bits)

    @cached_property
    def max_value(self) -> int:
        """Sample value of a saturated pixel."""
        value = self._ask("max_value")
        if not _whole(value, 1) or value > 65535:
            raise self._wrong("max_value", "1 to 65535", value)
        return int(value)

    def set_exposure(self, seconds: float) -> Setting[float]:
        """Set the exposure time; return the requested and the actual value (s)."""
        found = self._caller.call("set_exposure", self.device.set_exposure, seconds, seconds=SETTING_S)
        if not (isinstance(found, Setting) and _number(found.actual) and 0 < found.actual < math.inf):
            raise self._wrong("set_exposure", "a Setting with an exposure above 0 s", found)
        return found

    def set_roi(self, roi: Roi) -> Setting[Roi]:
        """Set the region of interest; return the requested and the actual region, which may be larger."""
        found = self._caller.call("set_roi", self.device.set_roi, roi, seconds=SETTING_S)
        if not (isinstance(found, Setting) and isinstance(found.actual, Roi) and _is_region(found.actual)):
            raise self._wrong("set_roi", "a Setting with a Roi", found)
        return found

    def fixed_settings(self) -> dict[str, Setting[str | None]]:
        """Return the requested and actual values of the settings by which the camera may change pixel values.

        The result is empty if the driver does not report them.
        """
        method = self._caller.call("fixed_settings", getattr, self.device, "fixed_settings", None)
        if method is None:
            return {}
        found = self._caller.call("fixed_settings", method, seconds=SETTING_S)
        if not (isinstance(found, Mapping) and all(map(_is_fixed_setting, found.items()))):
            raise self._wrong("fixed_settings", "names, each with a Setting of texts", found)
        return dict(found)

    @property
    def optics(self) -> str:
        """Method by which the simulator computes frames (`Rendered.optics`); empty for a real camera."""
        return self.device.optics if isinstance(self.device, Rendered) else ""

    def grab(self, timeout_s: float, cancelled: Callable[[], bool] = never) -> Frame | None:
        """Return a frame whose exposure started after this call; None as soon as ``cancelled`` returns True.

        The camera raises `FrameTimeout` if no frame arrives within ``timeout_s`` (s).
        """
        frame = self._caller.call("grab", self.device.grab, timeout_s, seconds=timeout_s, cancelled=cancelled)
        if frame is CANCELLED:
            return None
        wrong = _wrong_frame(frame)
        if wrong:
            raise self._wrong("grab", *wrong)
        return frame  # type: ignore[no-any-return]

    def _ask(self, name: str) -> Any:
        return self._caller.call(name, getattr, self.device, name)

    def _wrong(self, what: str, wanted: str, got: object) -> CameraError:
        return CameraError.expected(f"{self.name}: {what}", wanted, _words(got), REMEDY)


def _words(got: object) -> str:
    """Return the ``repr`` of a value for a message, or the name of its type if ``repr`` fails."""
    try:
        return repr(got)
    except Exception:  # a type of the driver
        return type(got).__name__


def _is_fixed_setting(named: tuple[object, object]) -> bool:
    name, setting = named
    if not (isinstance(name, str) and isinstance(setting, Setting)):
        return False
    return isinstance(setting.actual, str) and isinstance(setting.requested, str | None)


def _is_region(roi: Roi) -> bool:
    return all(_whole(n, 0) for n in (roi.row, roi.column)) and all(_whole(n, 1) for n in roi.shape)


def _wrong_frame(frame: object) -> tuple[str, object] | None:
    """Return the expected form of a wrong part of a frame, and that part; None if all parts are valid."""
    if not isinstance(frame, Frame):
        return "a Frame", frame
    data = frame.data
    if not (isinstance(data, np.ndarray) and data.ndim == 2 and data.dtype.kind in "uif"):
        shape = (getattr(data, "shape", None), str(getattr(data, "dtype", "")))
        return "data: an array of rows and columns", f"{type(data).__name__} {shape}"
    if not _whole(frame.number, 0):
        return "number: a whole number", frame.number
    if not _number(frame.exposure_s) or not 0 <= frame.exposure_s < math.inf:
        return "exposure_s: seconds", frame.exposure_s
    if frame.started_s is not None and not (_number(frame.started_s) and math.isfinite(frame.started_s)):
        return "started_s: seconds, or None", frame.started_s
    return None if isinstance(frame.status, str) else ("status: a text", frame.status)


class CheckedStage(_Checked[StageDevice]):
    """A stage whose calls have a time limit and whose answers are checked.

    Parameters
    ----------
    device
        The stage; its other attributes are available through this object.

    Raises
    ------
    StageError
        In any call, if the answer is not allowed by the protocol.
    DeviceLost
        In any call, if the driver does not return in time.
    """

    usual = "stage"

    @property
    def limits(self) -> Limits:
        """Lowest and highest position of each axis (x, y, z) (µm), ``((low, high), ...)``; infinite if unknown."""
        found = self._caller.call("limits", getattr, self.device, "limits")
        try:
            axes = tuple((float(low), float(high)) for low, high in found)
        except (TypeError, ValueError):
            axes = ()
        if len(axes) != 3 or not all(low <= high for low, high in axes):
            raise self._wrong("limits", "lowest and highest µm of three axes", found)
        return axes

    @property
    def moved_elsewhere(self) -> bool:
        """Whether another program moves the stage."""
        return isinstance(self.device, MovedElsewhere) and self.device.moved_elsewhere

    def move(self, target: Point, *, seconds: float = MOVE_S, cancelled: Callable[[], bool] = never) -> None:
        """Begin to move to ``target`` (x, y, z) (µm); a driver that waits for arrival may take ``seconds``.

        The call ends early, without stopping the stage, if ``cancelled`` returns True.
        """
        self._caller.call("move", self.device.move, target, seconds=seconds, cancelled=cancelled)

    def moving(self, cancelled: Callable[[], bool] = never) -> bool:
        """Return whether any axis is moving; False if ``cancelled`` returns True."""
        found = self._caller.call("moving", self.device.moving, cancelled=cancelled)
        if found is True or found is False:  # the usual answers, needed several times per frame
            return found
        if found is CANCELLED:
            return False
        if not isinstance(found, np.bool_ | Integral):
            raise self._wrong("moving", "True or False", found)
        return bool(found)

    def position(self) -> Point:
        """Return the position (x, y, z) read back from the device (µm)."""
        found = self._caller.call("position", self.device.position)
        if type(found) is tuple and [*map(type, found)] == POINT:
            return found
        if isinstance(found, np.ndarray):
            found = tuple(found.tolist())
        if not (isinstance(found, tuple | list) and len(found) == 3 and all(_number(value) for value in found)):
            raise self._wrong("position", "x, y, z in µm", found)
        x, y, z = found
        return float(x), float(y), float(z)

    def stop(self) -> None:
        """Stop all axes now; a hanging driver is not called."""
        if not self.hangs:
            self._caller.call("stop", self.device.stop)

    def home(self) -> None:
        """Begin to move to the reference switches, and return without waiting."""
        self._caller.call("home", self.device.home)

    def _wrong(self, what: str, wanted: str, got: object) -> StageError:
        return StageError.expected(f"{self.name}: {what}", wanted, _words(got), REMEDY)


class CheckedLight(_Checked[Light]):
    """A light source whose calls have a time limit; a call that exceeds it raises `DeviceLost`."""

    usual = "light"

    def switch(self, on: bool) -> None:
        """Switch the light on or off, and return when that is done."""
        self._caller.call("switch", self.device.switch, on, seconds=LIGHT_S)
