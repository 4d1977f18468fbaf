"""Storage: error of the stored type of H versus size of the file."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Patterns, Subject
from lfcal.base.h5 import encode_chunk, has_codecs
from lfcal.psf import PSFWriter, open_psf

__all__ = ["HALF", "PART", "relative_error"]

DTYPES = ("rounded", "float32", "float64")
"""Stored types that can represent any H, in the order of interest."""

COMPRESSIONS = ("gzip", "zstd", "none")
HALF = "float16 is shown only for comparison; H files never use it"


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error and size of patterns of H that were written with each type and compression and read again."""
    patterns = yield from subject.iter_patterns()
    values = patterns.values
    kind = "the values of H as read from the file" if subject.matrix is not None else "the simulated values"
    yield Truth(f"{kind}, {values.dtype}", (*patterns.notes, "bytes and times scaled to the complete H"))
    with TemporaryDirectory(prefix="lfcal-accuracy-") as folder:
        for dtype in DTYPES:
            for compression in COMPRESSIONS if has_codecs() else ("gzip", "none"):
                yield AccuracyStep(f"{dtype}, {compression}")
                yield _stored(Path(folder) / "H.h5", patterns, dtype, compression, subject.workers)
    yield AccuracyStep("float16")
    yield _half(patterns)


def _stored(path: Path, patterns: Patterns, dtype: str, compression: str, workers: int | None) -> CostPoint:
    values = patterns.values
    shape = (1, *values.shape)
    start = time.perf_counter()
    _write(path, values, dtype, compression, workers)
    wrote = time.perf_counter() - start
    size = path.stat().st_size
    start = time.perf_counter()
    with open_psf(path) as H:
        found = np.array(H.plane(0), np.float64)
    read = time.perf_counter() - start
    # other parts of the file do not grow with the samples
    _write(path, values, dtype, "none", workers)
    beside = path.stat().st_size - int(np.prod(shape)) * (8 if dtype == "float64" else 4)
    others = {"write (s)": wrote * patterns.scale, "read (s)": read * patterns.scale}
    cost = max(0.0, float(size - beside)) * patterns.scale
    settings = {"dtype": dtype, "compression": compression}
    return CostPoint(f"{dtype}, {compression}", settings, relative_error(found, values), cost, "bytes", others)


def _write(path: Path, values: NDArray[np.float32], dtype: str, compression: str, workers: int | None) -> None:
    with PSFWriter(path, (1, *values.shape), dtype=dtype, compression=compression, workers=workers) as writer:
        writer.write_plane(0, values)


def _half(patterns: Patterns) -> CostPoint:
    """Return the point for float16: values scaled to its range, each pattern encoded as a chunk of an H file."""
    values = patterns.values
    top = float(np.abs(values).max()) or 1.0
    # scaled to half of the largest value: nothing overflows, and small values keep the most digits
    half = (values * np.float32(2.0**15 / top)).astype(np.float16)
    start = time.perf_counter()
    size = sum(len(encode_chunk(half[at])) for at in np.ndindex(*half.shape[:2]))
    wrote = (time.perf_counter() - start) * patterns.scale
    error = relative_error(half.astype(np.float64) * (top / 2.0**15), values)
    settings = {"dtype": "float16", "compression": "gzip"}
    return CostPoint("float16, gzip", settings, error, size * patterns.scale, "bytes", {"write (s)": wrote}, HALF)


def relative_error(found: NDArray[Any], true: NDArray[Any]) -> float:
    """Return the sum of absolute differences divided by the sum of absolute true values; 0 if the latter is zero."""
    total = float(np.abs(true).sum(dtype=np.float64))
    off = float(np.abs(np.asarray(found, np.float64) - true).sum())
    return off / total if total > 0 else 0.0


PART = AccuracyPart(
    "storage",
    "H file: stored type and compression",
    "relative L1 error of H as read from its file",
    "size of the samples of H in the file",
    "bytes",
    measure,
    rank=60,
)
