"""Compute on an accelerator: a device of an array library, used through the array API standard.

PyTorch and CuPy are used through array-api-compat (https://data-apis.org/array-api). Without an accelerator, numpy and
array-api-strict can do the same arithmetic in host memory.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, free_memory

__all__ = ["DEVICES", "ArrayDevice", "check_arithmetic", "device_count", "driver_present", "find_device"]

DEVICES = "auto, cpu, cuda or cuda:NUMBER"
"""Values that `find_device` accepts."""

LIBRARIES = ("torch", "cupy")
"""Libraries that compute on accelerators, in the order in which they are tried."""


@dataclass(frozen=True)
class ArrayDevice:
    """Device for array computations; it can be pickled.

    Attributes
    ----------
    library
        ``torch``, ``cupy``, ``numpy`` or ``array_api_strict``.
    index
        Index of the accelerator; None for the CPU.
    room
        Memory that may be used on the device (bytes); by default all free memory.
    """

    library: str
    index: int | None = None
    room: int | None = None

    @property
    def xp(self) -> Any:
        """Array API namespace of the library."""
        return _namespace(self.library)

    @property
    def name(self) -> str:
        """Name of the device as in ``--device``, followed by the library."""
        return f"{self.text} ({self.library})"

    @property
    def text(self) -> str:
        """Name of the device as in ``--device``, such as ``cpu`` or ``cuda:0``."""
        return "cpu" if self.index is None else f"cuda:{self.index}"

    @property
    def place(self) -> Any:
        """Device as the library expects it: an object for CuPy, a name for PyTorch; None for other libraries."""
        if self.library == "cupy":
            return self.xp.cuda.Device(self.index or 0)
        return self.text if self.library == "torch" else None

    def active(self) -> AbstractContextManager[Any]:
        """Return a context in which this device is CuPy's current one; for other libraries, it has no effect."""
        found: AbstractContextManager[Any] = self.place if self.library == "cupy" else nullcontext()
        return found

    def free_bytes(self) -> int:
        """Return the memory (bytes) that may be used now: free memory, and what the library has reserved but not used.

        The result is at most `room`.
        """
        if self.library == "torch" and self.index is not None:
            cuda = importlib.import_module("torch").cuda
            reserve = cuda.memory_reserved(self.index) - cuda.memory_allocated(self.index)
            free = int(cuda.mem_get_info(self.index)[0] + reserve)
        elif self.library == "cupy":
            with self.active():
                free = int(self.place.mem_info[0] + self.xp.get_default_memory_pool().free_bytes())
        else:
            free = free_memory()
        return free if self.room is None else min(free, self.room)

    def most_bytes(self) -> int:
        """Return the peak memory (bytes) that the library has reserved on the accelerator; 0 without an accelerator."""
        if self.library == "torch" and self.index is not None:
            return int(importlib.import_module("torch").cuda.max_memory_reserved(self.index))
        if self.library == "cupy":
            with self.active():
                return int(self.xp.get_default_memory_pool().total_bytes())
        return 0

    # -- arrays ----------------------------------------------------------------------------------------
    def dtype(self, dtype: Any) -> Any:
        """Return the library's data type with the name of the numpy type ``dtype``."""
        return getattr(self.xp, np.dtype(dtype).name)

    def moved(self, array: NDArray[Any]) -> Any:
        """Return ``array`` as an array on the device; do not write to the result, because both may share memory."""
        # PyTorch accepts neither read-only arrays nor negative strides
        return self.xp.asarray(np.require(array, requirements=("C", "W")), device=self.place)

    def zeros(self, shape: tuple[int, ...], dtype: Any) -> Any:
        """Return zeros with the numpy type ``dtype`` on the device."""
        return self.xp.zeros(shape, dtype=self.dtype(dtype), device=self.place)

    def buffer(self, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
        """Return an uninitialised host array to which `fetched` copies fastest (page-locked for accelerators)."""
        if self.index is None:
            return np.empty(shape, dtype)
        if self.library == "torch":
            torch = importlib.import_module("torch")
            return np.asarray(torch.empty(shape, dtype=self.dtype(dtype), pin_memory=True).numpy())
        return np.asarray(importlib.import_module("cupyx").empty_pinned(shape, np.dtype(dtype)))

    def fetched(self, array: Any, out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return an array of the device as a writable numpy array; it is copied to ``out`` if ``out`` is given."""
        found = np.empty(array.shape, _numpy_type(array)) if out is None else out
        if self.library == "torch":
            importlib.import_module("torch").from_numpy(found).copy_(array)
        elif self.library == "cupy":
            array.get(out=found)
        else:
            np.copyto(found, np.from_dlpack(array))
        return found


def _numpy_type(array: Any) -> np.dtype[Any]:
    return np.dtype(str(array.dtype).rpartition(".")[2])


@lru_cache(maxsize=8)
def _namespace(library: str) -> Any:
    name = f"array_api_compat.{library}" if library in LIBRARIES else library
    return importlib.import_module(name)


def device_count(library: str) -> int:
    """Return the number of accelerators that a library in `LIBRARIES` can use; 0 if the library is unusable."""
    if importlib.util.find_spec(library) is None or importlib.util.find_spec("array_api_compat") is None:
        return 0
    try:
        if library == "torch":
            cuda = importlib.import_module("torch").cuda
            return int(cuda.device_count()) if cuda.is_available() else 0
        return int(importlib.import_module("cupy").cuda.runtime.getDeviceCount())
    except Exception:  # any error, such as that of a library built for another driver: it cannot be used here
        return 0


def find_device(text: str, *, worker: int = 0) -> ArrayDevice | None:
    """Return the device for the value of ``--device``; None for the CPU.

    Parameters
    ----------
    text
        ``cpu``: the CPU. ``cuda``: an accelerator, chosen by the worker's number if there are several. ``cuda:1``: this
        accelerator. ``auto``: like ``cuda`` if there is an accelerator that computes correctly, otherwise the CPU.
    worker
        Number of this process among the processes that share the work, from 0.

    Raises
    ------
    InputError
        If the text is invalid. For ``cuda``, if there is no such accelerator, or it computes incorrectly.
    """
    kind, _, number = text.partition(":")
    if kind not in ("auto", "cpu", "cuda") or (number and kind != "cuda") or (":" in text and not number.isdecimal()):
        raise InputError.expected("device", DEVICES, repr(text), "choose one of these")
    # do not import a large library unnecessarily
    if kind == "cpu" or (kind == "auto" and not driver_present()):
        return None
    for library in LIBRARIES:
        if count := device_count(library):
            index = int(number) if number else worker % count
            if index >= count:
                raise InputError.expected("device", f"a number below {count}", text, "choose another device")
            return _trusted(ArrayDevice(library, index), must=kind == "cuda")
    if kind == "auto":
        return None
    raise InputError.expected(
        f"device {text}",
        "an accelerator and PyTorch or CuPy that can use it",
        _lacking(),
        'install them with pip install "lfcal[gpu]" and torch or cupy, or choose cpu',
    )


def check_arithmetic(device: ArrayDevice) -> None:
    """Compare the single-precision operations of the engines (products, transforms, gathering) with those of numpy.

    Raises
    ------
    InputError
        If results differ by more than rounding errors, for example because products use a format of lower precision.
    """
    xp, rng = device.xp, np.random.default_rng(0)
    a, b = (rng.random((3, 64, 64), np.float32) for _ in range(2))
    which = rng.integers(0, 64, 40).astype(np.int32)
    with device.active():
        there, other = device.moved(a), device.moved(b)
        spectra = xp.fft.rfftn(there, s=(64, 3), axes=(1, 0))
        found = {
            "products": (xp.matmul(there, other), np.matmul(a, b)),
            "transforms": (xp.fft.irfftn(spectra, s=(64, 3), axes=(1, 0)), a),
            "gathering": (xp.take(there, device.moved(which), axis=1), a[:, which]),
        }
        for what, (values, truth) in found.items():
            error = float(np.abs(device.fetched(values) - truth).max() / truth.max())
            if not error < 1e-5:
                raise InputError.expected(
                    f"{what} on {device.name}",
                    "agreement with NumPy to 1e-5",
                    f"a relative error of {error:.1g}",
                    "disable reduced-precision arithmetic for this device",
                )


def _trusted(device: ArrayDevice, *, must: bool) -> ArrayDevice | None:
    """Return ``device`` if it computes correctly; otherwise raise `InputError` if it ``must``, or return None."""
    try:
        check_arithmetic(device)
    except InputError:
        if must:
            raise
        return None
    except Exception as error:  # libraries raise various errors if driver and device do not match
        if not must:
            return None
        said = f"{type(error).__name__}: {error}"
        raise InputError.expected(device.name, "a working accelerator", said, "choose cpu") from error
    return device


def driver_present() -> bool:
    """Return whether this computer has a driver for accelerators; the accelerator may still be unusable."""
    if sys.platform == "win32":
        return Path(r"C:\Windows\System32\nvcuda.dll").exists()
    # NVIDIA, AMD, and Windows Subsystem for Linux
    return any(Path("/dev").glob("nvidia[0-9]*")) or Path("/dev/kfd").exists() or Path("/dev/dxg").exists()


def _lacking(libraries: Sequence[str] = LIBRARIES) -> str:
    if importlib.util.find_spec("array_api_compat") is None:
        return "array-api-compat is not installed"
    found = [library for library in libraries if importlib.util.find_spec(library) is not None]
    return f"{' and '.join(found)} without an accelerator" if found else "neither library"
