"""Speed of this machine: measured once, stored in the user's cache, and corrected by simulations.

`lfcal.simulate.accuracy.cost` forecasts the time on a reference machine. Two factors convert it to this machine. The
first is the ratio of the speeds of matrix products. The second is the median ratio of measured to forecast time of the
last planes that an engine computed here. Runs of the same plane count once, because they err alike. All times are
processor times.
"""

from __future__ import annotations

import json
import math
import os
import platform
import statistics
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import LfcalError, full_version, one_blas_thread, parse_json, read_text, replace_whole

__all__ = ["CACHE", "MachineSpeed", "machine_speed", "speed_file"]

CACHE = "LFCAL_CACHE"
"""Environment variable with the folder of the stored speed, instead of the user's cache; if empty, nothing is stored.
"""

TIMINGS = 5
"""Number of timings, of which the fastest counts: other programs can only slow one down."""

TICKS = 20
"""Smallest duration of a timing in ticks of the clock."""

PLANES = 9
"""Number of planes of an engine whose median corrects its forecasts."""

ASSUMED = 3
"""Number of assumed planes that take as long as forecast, so that the first measurements do not count alone."""

MAX_CORRECTION = 5.0
"""Largest factor by which simulations correct the forecasts."""

SPEEDS = (1e7, 1e14)
"""Smallest and largest plausible number of complex multiply-adds per second."""


class MachineSpeed:
    """Speed of this machine, and how much longer engines take on it than their number of operations suggests.

    Parameters
    ----------
    file
        File in which the speed is stored. None: it is kept for this process only. A file that is damaged, or that
        another version or processor wrote, is replaced. If it cannot be written, nothing is stored.
    """

    def __init__(self, file: Path | None) -> None:
        self.file = file
        self._lock = threading.Lock()
        self._rate, self._ratios = _stored(file)

    @property
    def measured(self) -> bool:
        """Whether the speed is already known, so that `rate` measures nothing."""
        return self._rate > 0

    def rate(self) -> float:
        """Return the complex multiply-adds per CPU-second of one thread; measure them at the first use."""
        with self._lock:
            if not self.measured:
                self._rate = max(_timed_rate() for _ in range(TIMINGS))
                self._store()
            return self._rate

    def ratio(self, engine: str) -> float:
        """Return the ratio of measured to forecast time of an engine; 1 before any of its planes was measured.

        It is the median over the last `PLANES` planes and `ASSUMED` ratios of 1. It differs from 1 by a factor of at
        most `MAX_CORRECTION`.
        """
        known = self._ratios.get(engine)
        if not known:
            return 1.0
        ratios = [*known.values(), *[1.0] * ASSUMED]
        return min(max(statistics.median(ratios), 1 / MAX_CORRECTION), MAX_CORRECTION)

    def planes(self, engine: str) -> int:
        """Return the number of measured planes of ``engine``, at most `PLANES`, from which `ratio` is computed."""
        return len(self._ratios.get(engine, ()))

    @property
    def engines(self) -> tuple[str, ...]:
        """Names of the engines of which planes were measured, sorted."""
        return tuple(sorted(self._ratios))

    def correct(self, engine: str, plane: str, forecast_s: float, took_s: float) -> None:
        """Add a plane to those that determine `ratio`.

        ``took_s`` is its measured time, and ``forecast_s`` its forecast without earlier corrections (CPU-seconds).
        ``plane`` identifies the plane of the engine; an earlier ratio of the same plane is replaced. Times that are not
        positive are ignored.
        """
        if forecast_s > 0 and took_s > 0:
            with self._lock:
                others = {name: ratio for name, ratio in self._ratios.get(engine, {}).items() if name != plane}
                self._ratios[engine] = _last({**others, plane: took_s / forecast_s})
                self._store()

    def _store(self) -> None:
        if self.file is None or not self.measured:
            return
        text = json.dumps({"machine": _machine(), "rate": self._rate, "ratios": self._ratios})
        with suppress(LfcalError, OSError), replace_whole(self.file) as part:
            part.write_text(text, encoding="utf-8")


_LOADING = threading.Lock()
_SPEED: MachineSpeed | None = None


def machine_speed() -> MachineSpeed:
    """Return the speed of this machine: always the same object, unless `speed_file` changes."""
    global _SPEED
    file = speed_file()
    with _LOADING:
        if _SPEED is None or _SPEED.file != file:
            _SPEED = MachineSpeed(file)
        return _SPEED


def speed_file() -> Path | None:
    """Return the file in which the speed is stored; None if the environment variable `CACHE` is set but empty."""
    folder = os.environ.get(CACHE)
    if folder is not None:
        return Path(folder) / "speed.json" if folder else None
    from platformdirs import user_cache_path

    return user_cache_path("lfcal", appauthor=False) / "speed.json"


def _machine() -> str:
    """Return what the speed depends on: versions and processor."""
    name = platform.processor()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name)
    return f"lfcal {full_version()}, numpy {np.__version__}, {platform.machine()}, {name}"


def _stored(file: Path | None) -> tuple[float, dict[str, dict[str, float]]]:
    """Return the stored rate and ratios; no rate (0) if there are none of this machine."""
    nothing: tuple[float, dict[str, dict[str, float]]] = (0.0, {})
    if file is None:
        return nothing
    try:
        found = parse_json(read_text(file, limit=1 << 16), str(file))
        if found["machine"] != _machine() or not SPEEDS[0] < found["rate"] < SPEEDS[1]:
            return nothing
        return float(found["rate"]), {str(name): _ratios(values) for name, values in found["ratios"].items()}
    except (LfcalError, OSError, LookupError, TypeError, ValueError, AttributeError):
        return nothing


def _ratios(values: Any) -> dict[str, float]:
    """Return stored ratios by plane; raise `ValueError` if one is not a positive number."""
    ratios = _last({str(plane): float(value) for plane, value in values.items()})
    if not ratios or not all(0 < ratio < math.inf for ratio in ratios.values()):
        raise ValueError("ratios")
    return ratios


def _last(ratios: dict[str, float]) -> dict[str, float]:
    return dict(list(ratios.items())[-PLANES:])


def _timed_rate() -> float:
    """Return complex multiply-adds per CPU-second of this thread; the time of other programs is not counted."""
    n, count = 96, 0
    a = np.ones((n, n), np.complex64)
    least = max(4e-3, TICKS * time.get_clock_info("thread_time").resolution)
    with one_blas_thread():
        a @ a  # the first product fills caches
        start = time.thread_time()
        while (took := time.thread_time() - start) < least:
            a @ a
            count += 1
    return n**3 * count / took
