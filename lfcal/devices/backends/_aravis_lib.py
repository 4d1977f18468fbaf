"""Call the functions of libaravis-0.8 through ctypes, without introspection and without a build step."""

from __future__ import annotations

import ctypes as c
import ctypes.util
import functools
from collections.abc import Callable
from typing import Any

from lfcal.devices.errors import DeviceMissing

__all__ = ["STATUS", "AravisError", "library"]

NAMES = ("libaravis-0.8.so.0", "libaravis-0.8.0.dylib", "libaravis-0.8-0.dll", "aravis-0.8-0.dll")
GOBJECT = ("libgobject-2.0.so.0", "libgobject-2.0.0.dylib", "libgobject-2.0-0.dll", "gobject-2.0-0.dll")
INSTALL = "run apt install libaravis-0.8-0 (Debian, Ubuntu), brew install aravis (macOS)"

STATUS = (
    "complete",
    "cleared",
    "timed out while filling",
    "packets are missing",
    "wrong packet",
    "wrong size",
    "still filling",
    "aborted",
    "payload not supported",
)
"""Meaning of a buffer's status codes, from 0."""

SILENT = (2, 4, 5)
"""Codes of ``ARV_DEVICE_ERROR``: not connected, transfer error, timeout."""

_P, _I, _U, _D, _S = c.c_void_p, c.c_int, c.c_uint, c.c_double, c.c_char_p
_PLAIN: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "update_device_list": (None, ()),
    "get_n_devices": (_U, ()),
    "get_device_id": (_S, (_U,)),
    "enable_interface": (None, (_S,)),
    "get_major_version": (_U, ()),
    "get_minor_version": (_U, ()),
    "get_micro_version": (_U, ()),
    "buffer_new_allocate": (_P, (c.c_size_t,)),
    "buffer_get_status": (_I, (_P,)),
    "buffer_get_image_data": (_P, (_P, c.POINTER(c.c_size_t))),
    "buffer_get_image_width": (_I, (_P,)),
    "buffer_get_image_height": (_I, (_P,)),
    "buffer_get_image_pixel_format": (c.c_uint32, (_P,)),
    "buffer_get_image_padding": (None, (_P, c.POINTER(_I), c.POINTER(_I))),
    "buffer_get_frame_id": (c.c_uint64, (_P,)),
    "stream_push_buffer": (None, (_P, _P)),
    "stream_try_pop_buffer": (_P, (_P,)),
    "stream_timeout_pop_buffer": (_P, (_P, c.c_uint64)),
    "camera_is_gv_device": (_I, (_P,)),
    "camera_get_device": (_P, (_P,)),
    "device_get_feature": (_P, (_P, _S)),
}
"""Functions that cannot fail: result and arguments."""

_FAILING: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "camera_new": (_P, (_S,)),
    "camera_get_vendor_name": (_S, (_P,)),
    "camera_get_model_name": (_S, (_P,)),
    "camera_get_device_serial_number": (_S, (_P,)),
    "camera_get_sensor_size": (None, (_P, c.POINTER(_I), c.POINTER(_I))),
    "camera_get_region": (None, (_P, *([c.POINTER(_I)] * 4))),
    "camera_set_region": (None, (_P, _I, _I, _I, _I)),
    "camera_get_width_increment": (_I, (_P,)),
    "camera_get_height_increment": (_I, (_P,)),
    "camera_get_x_offset_increment": (_I, (_P,)),
    "camera_get_y_offset_increment": (_I, (_P,)),
    "camera_is_region_offset_available": (_I, (_P,)),
    "camera_set_pixel_format_from_string": (None, (_P, _S)),
    "camera_get_pixel_format_as_string": (_S, (_P,)),
    "camera_set_exposure_time": (None, (_P, _D)),
    "camera_get_exposure_time": (_D, (_P,)),
    "camera_is_software_trigger_supported": (_I, (_P,)),
    "camera_set_trigger": (None, (_P, _S)),
    "camera_clear_triggers": (None, (_P,)),
    "camera_software_trigger": (None, (_P,)),
    "camera_get_payload": (_U, (_P,)),
    "camera_create_stream": (_P, (_P, _P, _P)),
    "camera_start_acquisition": (None, (_P,)),
    "camera_stop_acquisition": (None, (_P,)),
    "camera_gv_set_packet_size": (None, (_P, _I)),
    "camera_is_feature_available": (_I, (_P, _S)),
    "gc_feature_node_get_value_as_string": (_S, (_P,)),
    "gc_feature_node_set_value_from_string": (None, (_P, _S)),
}
"""Functions that report through a ``GError``: result and arguments before it."""


class AravisError(Exception):
    """Message of a ``GError``; ``silent`` if the device did not respond at all."""

    def __init__(self, message: str, *, silent: bool = False) -> None:
        super().__init__(message)
        self.silent = silent


class _GError(c.Structure):
    _fields_ = (("domain", c.c_uint32), ("code", _I), ("message", _S))


class Library:
    """Functions of libaravis as attributes, without the prefix ``arv_``; a ``GError`` becomes `AravisError`."""

    def __init__(self) -> None:
        arv = _load("aravis-0.8", NAMES)
        gobject = _load("gobject-2.0", GOBJECT)
        gobject.g_object_unref.argtypes, gobject.g_object_unref.restype = [_P], None
        self.unref: Callable[[Any], None] = gobject.g_object_unref
        glib = _load("glib-2.0", tuple(name.replace("gobject", "glib") for name in GOBJECT))
        glib.g_error_free.argtypes, glib.g_error_free.restype = [_P], None
        self._functions: dict[str, Callable[..., Any]] = {}
        for name, (result, arguments) in _PLAIN.items():
            function = getattr(arv, f"arv_{name}")
            function.restype, function.argtypes = result, list(arguments)
            self._functions[name] = function
        for name, (result, arguments) in _FAILING.items():
            function = getattr(arv, f"arv_{name}")
            function.restype, function.argtypes = result, [*arguments, c.POINTER(c.POINTER(_GError))]
            self._functions[name] = _checked(name, function, glib.g_error_free)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        """Return a function of the library."""
        try:
            return self._functions[name]
        except KeyError:
            raise AttributeError(name) from None

    @property
    def version(self) -> str:
        """Version of libaravis."""
        return ".".join(str(self._functions[f"get_{part}_version"]()) for part in ("major", "minor", "micro"))


def _checked(name: str, function: Any, free: Any) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        # GLib functions report errors through a last argument, a pointer to a GError pointer
        error = c.POINTER(_GError)()
        result = function(*arguments, c.byref(error))
        if error:
            message = (error.contents.message or b"").decode(errors="replace")
            silent = error.contents.code in SILENT and "timeout" in message
            # the caller owns an error of GLib and must free it
            free(error)
            raise AravisError(f"{name}: {message}", silent=silent)
        return result

    return call


def _load(name: str, files: tuple[str, ...]) -> Any:
    for candidate in (*files, ctypes.util.find_library(name)):
        if candidate:
            try:
                return c.CDLL(candidate)
            except OSError:
                continue
    raise DeviceMissing(f"lib{name}: not installed; {INSTALL}")


@functools.cache
def library() -> Library:
    """Return libaravis, loaded once; raises `DeviceMissing` if it is not installed."""
    return Library()
