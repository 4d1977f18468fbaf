"""Projection for a Raytrix R29: 95 x 55 positions, 181 x 181 pixels, 11 planes that are read one by one."""

from __future__ import annotations

import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray

from lfcal.base.system import peak_memory
from lfcal.reconstruct import Projector
from lfcal.reconstruct.projectors.device import ArrayDevice, find_device

__all__ = ["R29Result", "run_r29"]

PERIOD, CUTOUT, PLANES = (55, 95), (181, 181), 11
FRAME = (4384, 6576)
LIMIT = 12 * 10**9


@dataclass(frozen=True, slots=True)
class R29Result:
    """Forecast and measurement; times are in seconds for all 11 planes."""

    shape: tuple[int, int]
    device: str
    planes_measured: int
    density: float
    method: str
    forecast_forward_s: float
    forecast_adjoint_s: float
    forward_s: float
    adjoint_s: float
    prepare_s: float
    forecast_bytes: int
    peak_bytes: int
    forecast_device_bytes: int
    peak_device_bytes: int
    all_planes: str
    whole_frame: str

    def show(self) -> None:
        """Print forecast and measurement side by side."""
        from lfcal.base.units import format_bytes
        from lfcal.base.units import format_seconds as seconds
        from lfcal.cli._console import print_table

        scaled = "" if self.planes_measured == PLANES else f" ({self.planes_measured} measured, scaled)"
        rows = [
            [what, seconds(a), seconds(b), f"{b / a:.2f}"]
            for what, a, b in (
                ("forward", self.forecast_forward_s, self.forward_s),
                ("adjoint", self.forecast_adjoint_s, self.adjoint_s),
            )
        ]
        memory = [("memory", self.forecast_bytes, self.peak_bytes)]
        if self.forecast_device_bytes:
            memory.append(("memory of the device", self.forecast_device_bytes, self.peak_device_bytes))
        rows += [[what, format_bytes(a), format_bytes(b), f"{b / a:.2f}"] for what, a, b in memory]
        print_table(
            ["R29, 11 planes", "forecast", "measured", "ratio"],
            rows,
            title=f"{self.shape[0]} x {self.shape[1]} px, method {self.method} on {self.device}{scaled}, "
            f"{100 * self.density:.3g} % of H filled",
        )
        typer.echo(f"all 11 planes, by forecast: {self.all_planes}")
        typer.echo(f"whole frame of 29 megapixels, by forecast: {self.whole_frame}")


class _Repeated:
    """H whose planes are all read from one stored plane: the reading time is realistic, the file is small."""

    def __init__(self, plane: NDArray[Any], planes: int) -> None:
        self.data = plane
        self.shape = (planes, *plane.shape[1:])

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z``."""
        del z
        plane: NDArray[Any] = self.data[0]
        return plane

    def __getitem__(self, key: Any) -> Any:
        """Return values of the stored plane."""
        return self.data[(0, *key[1:])]


def run_r29(
    shape: tuple[int, int],
    density: float,
    full: bool,
    folder: Path | None,
    workers: int,
    device: str | ArrayDevice = "cpu",
) -> R29Result:
    """Measure one forward and one back projection, and compare them with the forecast.

    A synthetic uint16 plane (342 MB) is written to ``folder`` and read as a memory map, one plane at a time.
    ``full`` projects all 11 planes; otherwise, the times of one plane are scaled.
    """
    found = find_device(device) if isinstance(device, str) else device
    place = Path(tempfile.mkdtemp(prefix="lfcal_r29_", dir=folder))
    try:
        _write_plane(place / "H.npy", density)
        stored = np.load(place / "H.npy", mmap_mode="r")
        planes = PLANES if full else 1
        before = peak_memory()
        at = "cpu" if found is None else found
        P = Projector(_Repeated(stored, planes), shape, workers=workers, memory_limit=LIMIT, device=at)
        # one after the other: the peak memory is that of all three
        seconds = _time(P)
        peak = max(0, peak_memory() - before)
        cost, scale = P.forecast().chosen, PLANES / planes
        whole = [_forecast(stored, size, P.method, workers, at) for size in (shape, FRAME)]
        use = P.forecast().device
        return R29Result(
            shape=shape,
            device="cpu" if P.device is None else P.device.name,
            planes_measured=planes,
            density=density,
            method=P.method,
            forecast_forward_s=scale * cost.forward_s,
            forecast_adjoint_s=scale * cost.adjoint_s,
            forward_s=scale * seconds[1],
            adjoint_s=scale * seconds[2],
            prepare_s=scale * seconds[0],
            forecast_bytes=cost.memory_bytes,
            peak_bytes=peak,
            forecast_device_bytes=0 if use is None else use.memory_bytes,
            peak_device_bytes=0 if P.device is None else P.device.most_bytes(),
            all_planes=whole[0],
            whole_frame=whole[1],
        )
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _time(P: Projector) -> tuple[float, float, float]:
    """Return the seconds to prepare, to project forward, and to project back."""
    nz = P.volume_shape[0]
    start = time.perf_counter()
    P.prepare()
    prepared = time.perf_counter() - start
    volume = np.random.default_rng(0).random((1, *P.image_shape), np.float32).repeat(nz, axis=0)
    forward = adjoint = np.inf
    # the first run on an accelerator includes its initialisation, and the others are short
    for _ in range(1 if P.device is None else 3):
        start = time.perf_counter()
        image = P.forward(volume)
        ahead = time.perf_counter()
        P.adjoint(image)
        forward, adjoint = min(forward, ahead - start), min(adjoint, time.perf_counter() - ahead)
    return prepared, forward, adjoint


def _forecast(
    stored: NDArray[Any], shape: tuple[int, int], method: str, workers: int, device: str | ArrayDevice
) -> str:
    """Return the forecast of all 11 planes for an image of ``shape``, as text."""
    H = _Repeated(stored, PLANES)
    return str(Projector(H, shape, method=method, workers=workers, memory_limit=LIMIT, device=device).forecast())


def _write_plane(path: Path, density: float) -> None:
    rng = np.random.default_rng(1)
    stored = np.lib.format.open_memmap(path, "w+", np.uint16, (1, *PERIOD, *CUTOUT))
    for y in range(PERIOD[0]):
        values = rng.integers(1, 4096, (PERIOD[1], *CUTOUT), dtype=np.uint16)
        if density < 1:
            values[rng.random(values.shape, np.float32) >= density] = 0
        stored[0, y] = values
    stored.flush()
