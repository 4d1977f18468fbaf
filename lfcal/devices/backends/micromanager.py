"""Micro-Manager's device drivers: through pymmcore with a configuration file, or the running core of pymmcore-plus."""

from __future__ import annotations

import contextlib
import importlib
import os
import re
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.devices.backends._common import CameraFacts, off_value, read_settings, switch_off
from lfcal.devices.errors import CameraError, DeviceError, DeviceLost, DeviceMissing, FrameTimeout, StageError
from lfcal.devices.protocols import Frame, Limits, Point, Roi, Setting
from lfcal.devices.registry import limits_option
from lfcal.devices.rig import Rig

__all__ = ["BACKEND", "MicroManagerBackend", "SharedCoreBackend"]

T = TypeVar("T")
AUTOMATIC = re.compile(
    r"exposure|(?<!auto)(?<!auto.)shutter|gain|brightness|black.?level|offset|white.?balance|balance.?white|gamma"
)
CURVES = re.compile(r"(gamma|lut|sharpening|denoise).?enabled?|black.?level.?clamping.*")
RECORDED = re.compile(r"(analog.|digital.|pre.?amp.)?gain|offset|black.?level|gamma|pixel.?type|binning")
"""Names of properties in various drivers: automatic settings, nonlinear response, and settings that are only recorded.

The automatic shutter is not included; it is the mechanical one, which opens for each exposure.
"""

INSTALL = 'run pip install "lfcal[acquire]", and install Micro-Manager for its drivers'


class MicroManagerBackend:
    """Backend for the device drivers of Micro-Manager."""

    name = "micromanager"
    title = "Micro-Manager drivers (pymmcore)"
    has_stage = True
    options: Mapping[str, str] = {
        "config": "configuration file (.cfg) made with Micro-Manager; 'demo' for its demo devices",
        "adapters": "folder of Micro-Manager's device adapters",
        "camera": "label of the camera; by default that of the configuration",
        "xy": "label of the XY stage; by default that of the configuration",
        "z": "label of the Z stage; by default that of the configuration",
        "light": "label of a shutter in front of the source, for dark frames",
        "limits": "travel x0:x1,y0:y1,z0:z1 (µm); required, because Micro-Manager does not know it",
        "set": "Device.Property=value separated by ';', settings to apply before the session",
    }

    def probe(self) -> str:
        """Return the version of MMCore, the core library of Micro-Manager."""
        try:
            import pymmcore
        except ImportError:
            raise DeviceMissing(f"pymmcore: not installed; {INSTALL}") from None
        return f"pymmcore {pymmcore.__version__}"

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        """Load the configuration file, and return a rig with the camera and stages that ``options`` select."""
        import pymmcore

        limits = _limits(options)
        core = pymmcore.CMMCore()
        config, folder = _config(options)
        if folder:
            core.setDeviceAdapterSearchPaths([folder])
        with _opening(core.reset, f"the configuration {config}"):
            core.loadSystemConfiguration(config)
            return _rig(core, options, limits, core.reset)


class SharedCoreBackend:
    """Backend for the running core of pymmcore-plus in this process; its devices stay loaded after a session."""

    name = "pymmcore-plus"
    title = "running core of pymmcore-plus"
    has_stage = True
    options: Mapping[str, str] = {
        "config": "configuration file (.cfg), to load only if the core has no devices yet",
        **{key: words for key, words in MicroManagerBackend.options.items() if key not in ("config", "adapters")},
    }

    def probe(self) -> str:
        """Return the version of pymmcore-plus."""
        try:
            found = importlib.import_module("pymmcore_plus")
        except ImportError:
            raise DeviceMissing(
                "pymmcore-plus: not installed; run pip install pymmcore-plus where your program runs"
            ) from None
        return f"pymmcore-plus {found.__version__}"

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        """Return a rig with camera and stages of the running core, which loads ``config`` if it has no devices."""
        limits = _limits(options)
        core = importlib.import_module("pymmcore_plus").CMMCorePlus.instance()
        loaded, config = [label for label in core.getLoadedDevices() if label != "Core"], options.get("config", "")
        if bool(loaded) == bool(config):
            wanted, got = ("nothing", config) if loaded else ("a configuration file (.cfg)", "nothing")
            remedy = "leave it out: the core has devices" if loaded else "or load the devices in this process first"
            raise InputError.expected("option config", wanted, got, remedy)
        with _opening(lambda: None, "the loaded devices"):
            if config:
                core.loadSystemConfiguration(config)
            if core.isSequenceRunning():
                raise DeviceError("Micro-Manager: the camera is recording a sequence; stop the live view first")
            restore = _restoring(core, options)
        with _opening(restore, "the loaded devices"):
            return _rig(core, options, limits, restore)


def _limits(options: Mapping[str, str]) -> Limits:
    limits = limits_option(options)
    if limits is None:
        raise InputError.expected(
            "option limits", "x0:x1,y0:y1,z0:z1 in µm", "nothing", "give the travel of your stage"
        )
    return limits


@contextlib.contextmanager
def _opening(undo: Callable[[], None], what: str) -> Iterator[None]:
    """Call ``undo`` after an error, and convert an error of the core to a `DeviceError`."""
    try:
        yield
    except BaseException as error:
        undo()
        if isinstance(error, RuntimeError):
            raise DeviceError(f"Micro-Manager: {error}; check {what}") from error
        raise


def _settings(options: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Return device, property and value of every entry of the option ``set``."""
    found = []
    for entry in filter(None, options.get("set", "").split(";")):
        label, _, rest = entry.partition(".")
        key, _, value = rest.partition("=")
        found.append((label.strip(), key.strip(), value.strip()))
    return found


def _restoring(core: Any, options: Mapping[str, str]) -> Callable[[], None]:
    """Return a function that restores everything a rig changes in a running core."""
    before, shutter = core.getCameraDevice(), core.getAutoShutter()
    camera = options.get("camera") or before
    # of another camera, the region and the exposure can be read only once it is chosen
    if camera:
        core.setCameraDevice(camera)
    roi, exposure = (core.getROI(), core.getExposure()) if camera else (None, None)
    changed = [(label, key) for label, key, _ in _settings(options)]
    changed += [(camera, key) for key in _settings_of(core, camera)[0]] if camera else []
    values = {(label, key): core.getProperty(label, key) for label, key in changed}
    light = options.get("light", "")
    was_open = core.getShutterOpen(light) if light else None

    def restore() -> None:
        with contextlib.suppress(RuntimeError):  # devices may be gone
            for (label, key), value in values.items():
                if not core.isPropertyReadOnly(label, key):
                    core.setProperty(label, key, value)
            if roi is not None:
                core.setROI(*roi)
                core.setExposure(exposure)
            if was_open is not None:
                core.setShutterOpen(light, was_open)
            core.setAutoShutter(shutter)
            core.setCameraDevice(before)

    return restore


def _rig(core: Any, options: Mapping[str, str], limits: Limits, end: Callable[[], None]) -> Rig:
    """Return the devices of a core with ``options``; ``end`` is called when they are closed."""
    chosen = set()
    for label, key, value in _settings(options):
        core.setProperty(label, key, value)
        chosen.add((label, key))
    # the session switches the light; an automatic shutter would open in dark frames
    core.setAutoShutter(False)
    labels = {
        key: options.get(key) or default()
        for key, default in (
            ("camera", core.getCameraDevice),
            ("xy", core.getXYStageDevice),
            ("z", core.getFocusDevice),
        )
    }
    for key, label in labels.items():
        if label not in core.getLoadedDevices():
            raise DeviceMissing.expected(
                f"Micro-Manager {key}",
                f"one of {', '.join(core.getLoadedDevices())}",
                label or "none",
                "choose one of these",
            )
    core.setCameraDevice(labels["camera"])
    light = _Shutter(core, options["light"]) if options.get("light") else None
    own = {key for label, key in chosen if label == labels["camera"]}
    camera = _Camera(core, labels["camera"], own, end)
    return Rig(camera, _Stage(core, labels["xy"], labels["z"], limits), light)


BACKEND = (MicroManagerBackend(), SharedCoreBackend())


def _config(options: Mapping[str, str]) -> tuple[str, str]:
    """Return configuration file and adapter folder."""
    folder = options.get("adapters", "")
    config = options.get("config", "")
    if config == "demo" and not folder:
        try:
            adapters: Any = importlib.import_module("mm_test_adapters")
        except ImportError:
            raise DeviceMissing("mm-test-adapters: not installed; run pip install mm-test-adapters") from None
        folder = str(adapters.device_adapter_path())
    if config == "demo":
        config = os.path.join(folder, "MMConfig_demo.cfg")
    if not Path(config).is_file():
        raise InputError.expected("option config", "a configuration file (.cfg)", repr(config), "check the path")
    return config, folder


class _Camera(CameraFacts):
    """The camera of a core; snapping starts the exposure, so a frame is never stale."""

    def __init__(
        self, core: Any, label: str, chosen: Collection[str] = (), end: Callable[[], None] | None = None
    ) -> None:
        self._core, self._label, self._end = core, label, end or core.reset
        library, device = core.getDeviceLibrary(label), core.getDeviceName(label)
        serial = _property(core, label, "SerialNumber") or _property(core, label, "Serial Number")
        self.name = " ".join(filter(None, ("Micro-Manager", library, device, label, serial)))
        self._off, self._noted = _settings_of(core, label)
        # keep what the user set explicitly
        switch_off({key: value for key, value in self._off.items() if key not in chosen}, self._read, self._write)
        core.clearROI()
        self._shape = int(core.getImageHeight()), int(core.getImageWidth())
        self._bits = int(core.getImageBitDepth())
        if core.getNumberOfComponents() != 1:
            raise CameraError.expected(label, "grey pixels", "colour", "set a grey PixelType with option set")
        self._number = 0
        # a hanging driver must not block the session
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="micromanager")
        self._pending: Future[Any] | None = None

    def set_exposure(self, seconds: float) -> Setting[float]:
        """Set the exposure (s)."""
        # milliseconds in Micro-Manager, seconds here
        self._call(self._core.setExposure, seconds * 1e3)
        return Setting(seconds, float(self._call(self._core.getExposure)) / 1e3)

    def set_roi(self, roi: Roi) -> Setting[Roi]:
        """Read only ``roi``; for the whole sensor, the region is cleared."""
        if roi.shape == self._shape:
            self._call(self._core.clearROI)
        else:
            self._call(self._core.setROI, roi.column, roi.row, roi.columns, roi.rows)
        # Micro-Manager uses (x, y), a region (row, column)
        column, row, columns, rows = self._call(self._core.getROI)
        return Setting(roi, Roi(row, column, rows, columns))

    def grab(self, timeout_s: float) -> Frame:
        """Snap a frame."""
        if self._pending is not None and not self._pending.done():
            raise DeviceLost(
                f"{self.name}: the driver has not returned from the last frame; switch the camera off and on"
            )
        started = time.monotonic()
        self._pending = self._pool.submit(self._snap)
        try:
            data, exposure = self._pending.result(timeout_s)
        except FutureTimeout:
            raise FrameTimeout(f"{self.name}: no frame in {timeout_s:g} s; check trigger and cable") from None
        except RuntimeError as error:
            raise CameraError(f"{self.name}: {error}; check the camera") from error
        self._number += 1
        return Frame(data, self._number, exposure, started)

    def fixed_settings(self) -> dict[str, Setting[str | None]]:
        """Return required (None: only recorded) and current values of the properties that change pixel values."""
        return read_settings(self._off, self._noted, self._read)

    def close(self) -> None:
        """Unload all devices of the core, or restore the settings of a running core."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        # a reset during a hanging frame would also hang
        if self._pending is None or self._pending.done():
            self._end()

    def _read(self, key: str) -> str | None:
        return str(self._call(self._core.getProperty, self._label, key))

    def _write(self, key: str, value: str) -> None:
        with contextlib.suppress(RuntimeError):  # may be read-only now
            self._core.setProperty(self._label, key, value)

    def _snap(self) -> tuple[Any, float]:
        self._core.snapImage()
        data = np.asarray(self._core.getImage())
        return data.astype(np.uint8 if self._bits <= 8 else np.uint16, copy=False), self._core.getExposure() / 1e3

    def _call(self, function: Callable[..., T], *args: Any) -> T:
        try:
            return function(*args)
        except RuntimeError as error:
            raise CameraError(f"{self.name}: {error}; check the camera") from error


class _Stage:
    """An XY stage and a focus drive as one stage."""

    def __init__(self, core: Any, xy: str, z: str, limits: Limits) -> None:
        self._core, self._xy, self._z = core, xy, z
        self.limits = limits
        self.name = f"Micro-Manager {core.getDeviceName(xy)} {xy}, {core.getDeviceName(z)} {z}"

    def move(self, target: Point) -> None:
        """Begin to move to ``target`` (µm)."""
        self._call(self._core.setXYPosition, self._xy, target[0], target[1])
        self._call(self._core.setPosition, self._z, target[2])

    def moving(self) -> bool:
        """Return whether either of the two stages is busy."""
        return bool(self._call(self._core.deviceBusy, self._xy) or self._call(self._core.deviceBusy, self._z))

    def position(self) -> Point:
        """Return the position read back from both stages (µm)."""
        x = float(self._call(self._core.getXPosition, self._xy))
        y = float(self._call(self._core.getYPosition, self._xy))
        return x, y, float(self._call(self._core.getPosition, self._z))

    def stop(self) -> None:
        """Stop both stages."""
        self._call(self._core.stop, self._xy)
        self._call(self._core.stop, self._z)

    def home(self) -> None:
        """Begin to move both stages to their reference switches."""
        self._call(self._core.home, self._xy)
        self._call(self._core.home, self._z)

    def close(self) -> None:
        """Do nothing: the camera closes the core."""

    def _call(self, function: Callable[..., T], *args: Any) -> T:
        try:
            return function(*args)
        except RuntimeError as error:
            raise StageError(f"{self.name}: {error}; check the stage") from error


class _Shutter:
    """A shutter in front of the source."""

    def __init__(self, core: Any, label: str) -> None:
        self._core, self._label = core, label
        self.switch(True)

    def switch(self, on: bool) -> None:
        """Open or close the shutter, and return when that is done."""
        try:
            self._core.setShutterOpen(self._label, on)
            self._core.waitForDevice(self._label)
        except RuntimeError as error:
            raise DeviceError(f"shutter {self._label}: {error}; check its connection and configuration") from error


def _settings_of(core: Any, label: str) -> tuple[dict[str, str], list[str]]:
    """Return the properties of a camera that change pixel values, with their values for off, and names to record."""
    wanted: dict[str, str] = {}
    noted = []
    for key in core.getDevicePropertyNames(label):
        name = key.lower()
        off = off_value(core.getAllowedPropertyValues(label, key))
        if off is not None and (CURVES.fullmatch(name) or ("auto" in name and AUTOMATIC.search(name))):
            wanted[key] = off
        elif name == "gamma" and core.hasPropertyLimits(label, key) and core.getPropertyUpperLimit(label, key) <= 10:
            wanted[key] = "1"  # the scale depends on the driver, so only some have a gamma of 1
        elif RECORDED.fullmatch(name):
            noted.append(key)
    # a switch for gamma comes first; the value then has no effect
    return dict(sorted(wanted.items(), key=lambda pair: pair[0].lower() == "gamma")), noted


def _property(core: Any, label: str, key: str) -> str:
    return str(core.getProperty(label, key)) if core.hasProperty(label, key) else ""
