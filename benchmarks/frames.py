"""``python -m benchmarks frames``: reading and correcting a frame, compared with plain decoding and copying."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lfcal.base.progress import Clock, Work
from lfcal.base.units import format_seconds
from lfcal.cli._console import print_json, print_table, run_work
from lfcal.cli._options import JsonOption

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def register(bench: typer.Typer) -> None:
    """Add ``frames`` to the benchmarks."""
    bench.command("frames")(command)


@dataclass(frozen=True, slots=True)
class Row:
    """One comparison: time of lfcal and time of the reference (s)."""

    what: str
    seconds: float
    against: str
    reference_s: float

    @property
    def ratio(self) -> float:
        """Time of lfcal divided by that of the reference."""
        return self.seconds / self.reference_s


def command(
    *,
    megapixels: float = typer.Option(29.0, min=0.01, max=200.0, help="Size of the frame (megapixels)."),
    repeats: int = typer.Option(5, min=1, max=100, help="Runs of each; the fastest counts."),
    json: JsonOption = False,
) -> None:
    """Compare the time of readers with that of plain decoders, and the time of corrections with that of a copy.

    Example: `python -m benchmarks frames --megapixels 29`
    """
    rows = run_work(iter_compare(megapixels, repeats), quiet=json)
    if json:
        print_json(
            [
                {
                    "what": r.what,
                    "seconds": r.seconds,
                    "against": r.against,
                    "reference_seconds": r.reference_s,
                    "ratio": r.ratio,
                }
                for r in rows
            ]
        )
        return
    print_table(
        ["task", "time", "reference", "its time", "ratio"],
        [[r.what, format_seconds(r.seconds), r.against, format_seconds(r.reference_s), f"{r.ratio:.3g}"] for r in rows],
        title=f"One 16-bit frame of {megapixels:g} megapixels, one thread, fastest of {repeats}",
    )


def iter_compare(megapixels: float, repeats: int) -> Work[list[Row]]:
    """Run all comparisons; return one row each."""
    import numpy as np

    columns = max(64, round((megapixels * 1.5e6) ** 0.5))
    frame = np.random.default_rng(1).poisson(300, (max(64, columns * 2 // 3), columns)).astype(np.uint16)
    clock = Clock("compare", 2)
    yield clock.at(0, "corrections")
    rows = corrections(frame, repeats)
    yield clock.at(1, "readers")
    with tempfile.TemporaryDirectory(prefix="lfcal-bench-") as folder:
        rows += readers(frame, repeats, Path(folder))
    yield clock.at(2)
    return rows


def fastest(function: Callable[[], Any], repeats: int) -> float:
    """Return the shortest of ``repeats`` times of ``function`` after one run to warm up (s)."""
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    # the fastest run is the least disturbed one
    return min(times)


def corrections(frame: NDArray[np.uint16], repeats: int) -> list[Row]:
    """Return the rows for whole frames and for the region of one cutout."""
    import numpy as np

    from lfcal.frames import Background, CorrectionChain, Dark, Defects, White

    rng = np.random.default_rng(2)
    dark = rng.normal(100, 2, frame.shape).astype(np.float32)
    white = White(rng.normal(9000, 90, frame.shape), dark)
    out = np.empty(frame.shape, np.float32)
    pixels = rng.integers(0, frame.shape, (frame.size // 10_000, 2))
    short = CorrectionChain((Dark(dark), white))
    full = CorrectionChain((Dark(dark), white, Defects(pixels, (frame.shape[0], frame.shape[1])), Background("plane")))
    floats = frame.astype(np.float32)

    cast = fastest(lambda: np.copyto(out, frame, casting="unsafe"), repeats)
    add = fastest(lambda: np.add(floats, dark, out=out), repeats)
    numpy = fastest(lambda: (frame - dark) * white.gain, repeats)
    both = fastest(lambda: short.apply(frame, out=out), repeats)
    whole = fastest(lambda: full.apply(frame, out=out), repeats)
    side = min(181, *frame.shape)
    region = (slice(0, side), slice(0, side))
    part = np.ascontiguousarray(frame[region])
    small = fastest(lambda: short.apply_region(part, region), 20 * repeats)
    return [
        Row("dark + white", both, "uint16 to float32 alone", cast),
        Row("dark + white", both, "sum of two float32 frames", add),
        Row("dark + white", both, "numpy (frame - dark) * gain", numpy),
        Row("dark + white + defects + plane", whole, "uint16 to float32 alone", cast),
        Row(f"dark + white of {side} x {side} px", small, "the whole frame", both),
    ]


def readers(frame: NDArray[np.uint16], repeats: int, folder: Path) -> list[Row]:
    """Return the rows for files, each read by a frame source and by the plain decoder."""
    import cv2
    import numpy as np
    import tifffile

    from lfcal.frames import FolderSource, FrameEntry, Manifest, Position

    cv2.imwrite(str(folder / "a.png"), frame)
    tifffile.imwrite(folder / "plain.tif", frame)
    tifffile.imwrite(folder / "deflate.tif", frame, compression="zlib")
    np.save(folder / "a.npy", frame)
    bare: dict[str, Callable[[], Any]] = {
        "a.png": lambda: cv2.imread(str(folder / "a.png"), cv2.IMREAD_UNCHANGED),
        "plain.tif": lambda: tifffile.imread(folder / "plain.tif"),
        "deflate.tif": lambda: tifffile.imread(folder / "deflate.tif", maxworkers=1),
        "a.npy": lambda: np.load(folder / "a.npy"),
    }
    rows = []
    for name, decode in bare.items():
        source = FolderSource(folder, Manifest((FrameEntry(name, Position(0, 0, 0)),)))
        rows.append(
            Row(
                f"read {name}, checked",
                fastest(partial(source.read, 0), repeats),
                "plain decoder",
                fastest(decode, repeats),
            )
        )
    return rows
