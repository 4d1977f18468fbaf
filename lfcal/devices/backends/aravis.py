"""GigE Vision and USB3 Vision cameras through Aravis."""

from __future__ import annotations

import contextlib
import ctypes as c
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.devices.backends._aravis_lib import STATUS, AravisError, Library, library
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
from lfcal.devices.registry import number_option
from lfcal.devices.rig import Rig

__all__ = ["BACKEND", "AravisBackend"]

BUFFERS = 4
FREE_RUNNING_DISCARD = 2
"""Number of frames to skip without a trigger: one in transfer and one in exposure at the time of the request."""


class AravisBackend:
    """Backend for cameras that are accessed through Aravis."""

    name = "aravis"
    title = "GigE Vision and USB3 Vision (Aravis)"
    has_stage = False
    options: Mapping[str, str] = {
        "camera": "ID or network address of the camera; the only one found by default",
        "format": "pixel format, such as Mono8, Mono12p or BayerRG16; the camera's current format by default",
        "trigger": "software or none; by default software if the camera supports it",
        "packet_size": "bytes per network packet (GigE Vision)",
        "fake": "1 also finds Aravis's built-in fake camera",
    }

    def probe(self) -> str:
        """Return the version of libaravis."""
        return f"libaravis {library().version}"

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        """Return a rig with the camera that ``options`` select, but without a stage."""
        lib = library()
        if options.get("fake") == "1":
            lib.enable_interface(b"Fake")
        wanted = options.get("camera") or _only_camera(lib)
        packet = int(number_option(options, "packet_size", 0, low=0, high=65535))
        trigger = options.get("trigger", "")
        if trigger not in ("", "software", "none"):
            raise InputError.expected("option trigger", "software or none", repr(trigger), "choose one of these")
        try:
            return Rig(_Camera(lib, wanted, options.get("format", ""), trigger, packet), NoStage())
        except AravisError as error:
            raise DeviceMissing(f"Aravis camera {wanted}: {error}; check power, cable and address") from error


BACKEND = AravisBackend()


def _only_camera(lib: Library) -> str:
    lib.update_device_list()
    names = [lib.get_device_id(k).decode() for k in range(lib.get_n_devices())]
    if len(names) != 1:
        raise DeviceMissing.expected(
            "Aravis",
            "one camera",
            ", ".join(names) or "none",
            "choose a camera with the device option camera, or plug one in",
        )
    return str(names[0])


class _Camera(CameraFacts):
    """One camera with its stream; triggered by software, or free-running and flushed."""

    def __init__(self, lib: Library, wanted: str, pixel_format: str, trigger: str, packet_size: int) -> None:
        self._lib = lib
        self._stream: Any = None
        self._lost = False
        self._camera = lib.camera_new(wanted.encode())
        if not self._camera:
            raise AravisError("no such camera")
        try:
            self._configure(pixel_format, trigger, packet_size)
        except BaseException:
            self.close()
            raise

    def _configure(self, pixel_format: str, trigger: str, packet_size: int) -> None:
        lib, camera = self._lib, self._camera
        parts = [
            lib.camera_get_vendor_name(camera),
            lib.camera_get_model_name(camera),
            lib.camera_get_device_serial_number(camera),
        ]
        self.name = " ".join(part.decode(errors="replace") for part in parts if part)
        if pixel_format:
            lib.camera_set_pixel_format_from_string(camera, pixel_format.encode())
        name = lib.camera_get_pixel_format_as_string(camera).decode()
        self._format = PixelFormat.named(name, self.name)
        self._bits = self._format.bits
        width, height = c.c_int(), c.c_int()
        lib.camera_get_sensor_size(camera, c.byref(width), c.byref(height))
        self._shape = height.value, width.value
        # USB3 Vision has no packet size to set
        if packet_size and lib.camera_is_gv_device(camera):
            lib.camera_gv_set_packet_size(camera, packet_size)
        self._triggered = trigger == "software" or (
            not trigger and bool(lib.camera_is_software_trigger_supported(camera))
        )
        if self._triggered:
            lib.camera_set_trigger(camera, b"Software")
        else:
            lib.camera_clear_triggers(camera)
        switch_off(GENICAM, self._read, self._write)
        self._exposure = float(lib.camera_get_exposure_time(camera)) / 1e6
        self._number = 0
        self._dirty = False
        self._start()

    def set_exposure(self, seconds: float) -> Setting[float]:
        """Set the exposure (s)."""
        try:
            self._lib.camera_set_exposure_time(self._camera, seconds * 1e6)
            self._exposure = float(self._lib.camera_get_exposure_time(self._camera)) / 1e6
        except AravisError as error:
            raise self._explained(error) from error
        return Setting(seconds, self._exposure)

    def set_roi(self, roi: Roi) -> Setting[Roi]:
        """Read ``roi``, enlarged to the camera's increments; restarts the stream."""
        lib, camera = self._lib, self._camera
        try:
            self._stop()
            steps = [
                max(1, function(camera))
                for function in (
                    lib.camera_get_y_offset_increment,
                    lib.camera_get_x_offset_increment,
                    lib.camera_get_height_increment,
                    lib.camera_get_width_increment,
                )
            ]
            row, rows = _grown(roi.row, roi.rows, steps[0], steps[2], self._shape[0])
            column, columns = _grown(roi.column, roi.columns, steps[1], steps[3], self._shape[1])
            lib.camera_set_region(camera, column, row, columns, rows)
            taken = [c.c_int() for _ in range(4)]
            lib.camera_get_region(camera, *(c.byref(value) for value in taken))
            self._start()
        except AravisError as error:
            raise self._explained(error) from error
        x, y, w, h = (value.value for value in taken)
        return Setting(roi, Roi(y, x, h, w))

    def grab(self, timeout_s: float) -> Frame:
        """Trigger a frame, or skip frames that may be old, and return the next one."""
        lib = self._lib
        try:
            if self._dirty:  # a frame of an earlier call may still arrive
                self._stop()
                self._start()
                self._dirty = False
            self._drain()
            started = time.monotonic()
            if self._triggered:
                lib.camera_software_trigger(self._camera)
            else:
                # free running: pending frames were exposed before the call
                for _ in range(FREE_RUNNING_DISCARD):
                    lib.stream_push_buffer(self._stream, self._pop(timeout_s))
            buffer = self._pop(timeout_s)
        except AravisError as error:
            self._dirty = True
            raise self._explained(error) from error
        try:
            status = lib.buffer_get_status(buffer)
            text = STATUS[status] if 0 <= status < len(STATUS) else "unknown"
            data = self._copy(buffer) if status == 0 else np.zeros((0, 0), self._format.dtype)
        finally:
            lib.stream_push_buffer(self._stream, buffer)
        self._number += 1
        return Frame(data, self._number, self._exposure, started if self._triggered else None, text)

    def fixed_settings(self) -> dict[str, Setting[str | None]]:
        """Return required (None: only recorded) and current values of the settings that change pixel values."""
        try:
            return read_settings(GENICAM, RECORDED, self._read)
        except AravisError as error:
            raise self._explained(error) from error

    def close(self) -> None:
        """Stop and release the camera."""
        if self._camera:
            with contextlib.suppress(AravisError):
                self._stop()
            self._lib.unref(self._camera)
            self._camera = None

    # -- stream ----------------------------------------------------------------------------------------
    def _start(self) -> None:
        lib = self._lib
        payload = lib.camera_get_payload(self._camera)
        self._stream = lib.camera_create_stream(self._camera, None, None)
        for _ in range(BUFFERS):
            lib.stream_push_buffer(self._stream, lib.buffer_new_allocate(payload))
        lib.camera_start_acquisition(self._camera)

    def _stop(self) -> None:
        if self._stream is not None:
            try:
                if not self._lost:
                    self._lib.camera_stop_acquisition(self._camera)
            finally:
                self._lib.unref(self._stream)
                self._stream = None

    def _drain(self) -> None:
        while buffer := self._lib.stream_try_pop_buffer(self._stream):
            self._lib.stream_push_buffer(self._stream, buffer)

    def _pop(self, timeout_s: float) -> Any:
        buffer = self._lib.stream_timeout_pop_buffer(self._stream, int(timeout_s * 1e6))
        if buffer:
            return buffer
        self._dirty = True
        self._check_connected()
        raise FrameTimeout(f"{self.name}: no frame in {timeout_s:g} s; check trigger, light and cable")

    def _copy(self, buffer: Any) -> NDArray[Any]:
        lib, size = self._lib, c.c_size_t()
        address = lib.buffer_get_image_data(buffer, c.byref(size))
        shape = int(lib.buffer_get_image_height(buffer)), int(lib.buffer_get_image_width(buffer))
        padding, below = c.c_int(), c.c_int()
        lib.buffer_get_image_padding(buffer, c.byref(padding), c.byref(below))
        # the PFNC number of a format contains the bits per pixel
        bits = lib.buffer_get_image_pixel_format(buffer) >> 16 & 0xFF
        if bits != self._format.stored_bits:
            got = f"{bits} bits per pixel"
            raise CameraError.expected(
                f"{self.name}: frame",
                self._format.name,
                got,
                "set the device option format to the format of the frames",
            )
        raw = memoryview((c.c_char * size.value).from_address(address)).cast("B")
        try:
            # new arrays: the buffer goes back to the stream
            return self._format.samples(np.frombuffer(raw, np.uint8), shape, padding.value)
        except ValueError as error:
            raise CameraError(f"{self.name}: {error}; check the pixel format") from error

    # -- features --------------------------------------------------------------------------------------
    def _read(self, name: str) -> str | None:
        """Return a feature as text; None if the camera does not have it."""
        lib = self._lib
        if not lib.camera_is_feature_available(self._camera, name.encode()):
            return None
        try:
            text = lib.gc_feature_node_get_value_as_string(self._node(name))
        except AravisError as error:
            if error.silent:
                raise
            return UNREADABLE
        return UNREADABLE if text is None else str(text.decode(errors="replace"))

    def _write(self, name: str, text: str) -> None:
        """Set a feature if the camera allows it."""
        try:
            self._lib.gc_feature_node_set_value_from_string(self._node(name), text.encode())
        except AravisError as error:
            if error.silent:
                raise

    def _node(self, name: str) -> Any:
        return self._lib.device_get_feature(self._lib.camera_get_device(self._camera), name.encode())

    def _check_connected(self) -> None:
        """Raise `DeviceLost` unless the camera answers."""
        try:
            self._lib.camera_get_exposure_time(self._camera)
        except AravisError as error:
            raise self._gone(error) from error

    def _gone(self, error: AravisError) -> DeviceLost:
        self._lost = True  # every further request would wait for seconds
        return DeviceLost(f"{self.name}: no answer ({error}); check power and cable")

    def _explained(self, error: AravisError) -> CameraError | DeviceLost:
        if error.silent:
            return self._gone(error)
        try:
            self._check_connected()
        except DeviceLost as lost:
            return lost
        return CameraError(f"{self.name}: {error}; check the camera's settings")


def _grown(start: int, size: int, start_step: int, size_step: int, whole: int) -> tuple[int, int]:
    """Return the smallest allowed range that contains ``start, size``; the whole range if there is none."""
    first = start // start_step * start_step
    length = -(-(start + size - first) // size_step) * size_step
    return (first, length) if first + length <= whole else (0, whole)
