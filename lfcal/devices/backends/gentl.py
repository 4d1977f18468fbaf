"""Cameras with a GenTL producer (CoaXPress, Camera Link and many others) through harvesters."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.devices.backends._common import (
    GENICAM,
    RECORDED,
    UNREADABLE,
    CameraFacts,
    NoStage,
    read_settings,
    switch_off,
)
from lfcal.devices.backends._pixels import PixelFormat
from lfcal.devices.errors import CameraError, DeviceLost, DeviceMissing, FrameTimeout
from lfcal.devices.protocols import Frame, Roi, Setting
from lfcal.devices.rig import Rig

__all__ = ["BACKEND", "GenTLBackend"]

FREE_RUNNING_DISCARD = 2
NOT_AVAILABLE, WRITE_ONLY = 1, 2
"""Access modes of GenApi: features up to the first are not available, and features above the second are readable."""
INSTALL = 'run pip install "lfcal[acquire]"'


class GenTLBackend:
    """Backend for cameras with a GenTL producer."""

    name = "gentl"
    title = "GenTL producers (harvesters)"
    has_stage = False
    options: Mapping[str, str] = {
        "cti": "GenTL producer file (.cti) of the camera manufacturer; 'virtual' for the one included in genicam",
        "camera": "number of the camera in the producer's list, from 0, or its serial number",
        "format": "pixel format, such as Mono8, Mono12p or BayerRG16; the camera's current format by default",
        "set": "Feature=value separated by ';', settings to apply before the session",
        "trigger": "software or none; by default software if the camera supports it",
    }

    def probe(self) -> str:
        """Return the version of the library harvesters."""
        try:
            import genicam.gentl  # noqa: F401
            import harvesters
        except ImportError:
            raise DeviceMissing(f"harvesters: not installed; {INSTALL}") from None
        return f"harvesters {harvesters.__version__}"

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        """Return a rig with the camera that ``options`` select, but without a stage."""
        import genicam
        from harvesters.core import Harvester

        cti = options.get("cti", "")
        if cti == "virtual":
            cti = os.path.join(os.path.dirname(genicam.__file__), "viky.cti")
        if not os.path.isfile(cti):
            raise InputError.expected(
                "option cti", "a GenTL producer (.cti)", repr(cti), "give the manufacturer's file"
            )
        harvester = Harvester()
        try:
            harvester.add_file(cti)
            harvester.update()
            return Rig(_Camera(harvester, _chosen(harvester, options.get("camera", "0")), options), NoStage())
        except (InputError, DeviceMissing, CameraError):
            harvester.reset()
            raise
        except Exception as error:  # harvesters and producers raise other types of errors
            harvester.reset()
            raise DeviceMissing(f"GenTL camera: {type(error).__name__}: {error}; check the producer {cti}") from error


BACKEND = GenTLBackend()


def _chosen(harvester: Any, wanted: str) -> int:
    devices = harvester.device_info_list
    serials = [str(device.serial_number) for device in devices]
    if wanted.isdigit() and int(wanted) < len(devices):
        return int(wanted)
    if wanted in serials:
        return serials.index(wanted)
    if not devices:
        raise DeviceMissing.expected("GenTL camera", "a camera", "none", "check its power and cable")
    raise DeviceMissing.expected(
        "GenTL camera",
        f"a number from 0 to {len(devices) - 1}, or a serial number ({', '.join(serials)})",
        wanted,
        "choose one of these, or plug the camera in",
    )


def _buffer_value(source: Any, name: str, default: Any) -> Any:
    """Return a property of a buffer; ``default`` if the producer does not know it."""
    try:
        return getattr(source, name)
    except Exception:  # GenTL has its own types of errors
        return default


class _Camera(CameraFacts):
    """One device of a producer; triggered by software, or free-running and flushed."""

    def __init__(self, harvester: Any, number: int, options: Mapping[str, str]) -> None:
        from genicam.gentl import TimeoutException
        from harvesters.util.pfnc import dict_by_ints

        self._timeout_error, self._format_names = TimeoutException, dict_by_ints
        self._harvester = harvester
        info = harvester.device_info_list[number]
        self.name = f"{info.vendor} {info.model} {info.serial_number}"
        self._device = harvester.create(number)
        self._nodes = self._device.remote_device.node_map
        given = [entry.partition("=") for entry in options.get("set", "").split(";") if entry]
        for key, _, value in given:
            self._set(key.strip(), value.strip())
        # keep what the user set explicitly
        chosen = {key.strip() for key, _, _ in given}
        switch_off({key: value for key, value in GENICAM.items() if key not in chosen}, self._read, self._write)
        if options.get("format"):
            self._set("PixelFormat", options["format"])
        self._format = PixelFormat.named(str(self._nodes.PixelFormat.value), self.name)
        self._bits = self._format.bits
        self._shape = self._size("HeightMax", "Height"), self._size("WidthMax", "Width")
        self._number = 0
        self._exposure = self._read_exposure()
        self._triggered = options.get("trigger", "") != "none" and self._arm_trigger()
        self._device.start()

    def set_exposure(self, seconds: float) -> Setting[float]:
        """Set the exposure (s); a camera without this feature keeps its exposure."""
        if self._nodes.has_node("ExposureTime"):
            # microseconds in the GenICam standard (SFNC), seconds here
            self._set("ExposureTime", seconds * 1e6)
        self._exposure = self._read_exposure()
        return Setting(seconds, self._exposure if self._exposure > 0 else seconds)

    def set_roi(self, roi: Roi) -> Setting[Roi]:
        """Return the whole sensor, because the increments of regions differ between manufacturers."""
        # the session crops the region from the whole sensor
        return Setting(roi, Roi(0, 0, *self._shape))

    def grab(self, timeout_s: float) -> Frame:
        """Trigger a frame, or skip frames that may be old, and return the next one."""
        # frames in the buffers were exposed before the call
        while self._device.num_holding_filled_buffers:
            self._fetch(timeout_s)
        started = time.monotonic()
        if self._triggered:
            self._command("TriggerSoftware")
        else:
            for _ in range(FREE_RUNNING_DISCARD):
                self._fetch(timeout_s)
        data, status = self._fetch(timeout_s)
        self._number += 1
        exposure = self._exposure if self._exposure > 0 else 0.0
        return Frame(data, self._number, exposure, started if self._triggered else None, status)

    def fixed_settings(self) -> dict[str, Setting[str | None]]:
        """Return required (None: only recorded) and current values of the features that change pixel values."""
        return read_settings(GENICAM, RECORDED, self._read)

    def close(self) -> None:
        """Stop and release the device and the producer."""
        if self._device is not None:
            device, self._device = self._device, None
            try:
                device.stop()
                device.destroy()
            finally:
                self._harvester.reset()

    # -- frames ----------------------------------------------------------------------------------------
    def _fetch(self, timeout_s: float) -> tuple[Any, str]:
        """Return the next frame as a separate array, and the fault of its buffer."""
        try:
            # raw, because harvesters cannot unpack lines with padding or an odd number of pixels
            buffer = self._device.fetch(timeout=timeout_s, is_raw=True)
        except self._timeout_error:
            raise FrameTimeout(f"{self.name}: no frame in {timeout_s:g} s; check trigger, light and cable") from None
        except Exception as error:
            raise DeviceLost(f"{self.name}: {type(error).__name__}: {error}; check power and cable") from error
        try:
            if not buffer.is_complete():
                return np.zeros((0, 0), self._format.dtype), "parts are missing"
            return self._samples(buffer), "complete"
        finally:
            buffer.parent.queue_buffer(buffer)

    def _samples(self, buffer: Any) -> NDArray[Any]:
        """Return the samples of a buffer, or of its first part, as a new array; the driver reuses the buffer."""
        part = next(iter(_buffer_value(buffer, "parts", ())), None)
        if part is None:
            names = ("pixel_format", "image_offset", "data_size", "padding_x")
        else:
            names = ("data_format", "data_offset", "data_size", "x_padding")
        source = buffer if part is None else part
        number, first, size, padding = (int(_buffer_value(source, name, 0)) for name in names)
        shape = tuple(int(_buffer_value(source, name.lower(), 0)) or self._size(name) for name in ("Height", "Width"))
        raw = np.frombuffer(buffer.raw_buffer, np.uint8)
        data = raw[first : first + (size or int(_buffer_value(buffer, "size_filled", 0)) or len(raw))]
        try:
            return self._format_of(number).samples(data, (shape[0], shape[1]), padding)
        except ValueError as error:
            raise CameraError(f"{self.name}: {error}; check the pixel format") from error

    def _format_of(self, number: int) -> PixelFormat:
        """Return the format of a buffer by its PFNC number (0: unknown), which a frame grabber may have changed."""
        name = self._format_names.get(number)
        found = self._format if name is None else PixelFormat.named(name, self.name)
        if found.bits != self._bits or (number and number >> 16 & 0xFF != found.stored_bits):
            raise CameraError.expected(
                f"{self.name}: frame",
                self._format.name,
                name or f"format {number:#x}",
                "set the device option format to the format of the frames",
            )
        return found

    # -- features --------------------------------------------------------------------------------------
    def _read(self, name: str) -> str | None:
        """Return a feature as text; None if the camera does not have it, or not at present."""
        if not self._nodes.has_node(name):
            return None
        node = self._nodes.get_node(name)
        mode = node.get_access_mode()
        if mode <= NOT_AVAILABLE:
            return None
        try:
            return UNREADABLE if mode == WRITE_ONLY else str(node.to_string())
        except Exception:  # GenApi has its own types of errors; a lost camera fails in the next frame
            return UNREADABLE

    def _write(self, name: str, text: str) -> None:
        """Set a feature if the camera allows it."""
        with contextlib.suppress(CameraError):
            self._set(name, text)

    def _set(self, name: str, value: Any) -> None:
        try:
            node = self._nodes.get_node(name)
            if isinstance(value, str):
                node.from_string(value)
            else:
                node.value = value
        except Exception as error:
            raise CameraError(
                f"{self.name}: {name} = {value}: {error}; check that the camera has this feature and accepts this value"
            ) from error

    def _command(self, name: str) -> None:
        try:
            self._nodes.get_node(name).execute()
        except Exception as error:
            raise DeviceLost(f"{self.name}: {name}: {error}; check power and cable") from error

    def _size(self, *names: str) -> int:
        return int(next(self._nodes.get_node(name).value for name in names if self._nodes.has_node(name)))

    def _read_exposure(self) -> float:
        if not self._nodes.has_node("ExposureTime"):
            return 0.0
        return float(self._nodes.ExposureTime.value) / 1e6

    def _arm_trigger(self) -> bool:
        """Set the camera to expose on command; return whether it can."""
        if not all(self._nodes.has_node(name) for name in ("TriggerMode", "TriggerSource", "TriggerSoftware")):
            return False
        self._set("TriggerSource", "Software")
        self._set("TriggerMode", "On")
        return True
