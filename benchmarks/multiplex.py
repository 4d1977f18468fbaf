"""``python -m benchmarks multiplex``: demosaicing and views of 29 megapixels, compared with OpenCV and copies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import typer

from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

BOUND = 5.0
FULL = (4384, 6576)
VIEWS = 31


@dataclass(frozen=True, slots=True)
class Timing:
    """Times (s) of one method, of OpenCV's bilinear demosaic and of a copy of the output; PSNR of colours (dB)."""

    name: str
    seconds: float
    opencv: float
    copy: float
    megabytes: float
    psnr_db: float | None = None

    @property
    def ratio(self) -> float:
        """Time divided by that of OpenCV and the copy together."""
        return self.seconds / (self.opencv + self.copy)


def register(bench: typer.Typer) -> None:
    """Add ``multiplex`` to the benchmarks."""
    bench.command("multiplex")(command)


def bayer_frame(shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Return a smooth 12-bit test frame with noise."""
    import numpy as np

    rng = np.random.default_rng(0)
    y, x = np.ogrid[: shape[0], : shape[1]]
    scene = 1500 + 1000 * np.sin(y / 37.0) * np.cos(x / 53.0)
    return (scene + rng.integers(0, 200, shape)).astype(np.uint16)


def measure(shape: tuple[int, int], filters: list[str], workers: int | None, rounds: int) -> list[Timing]:
    """Return the times of each method, with outputs that were allocated and written before."""
    import cv2
    import numpy as np

    from benchmarks._transposers import copy_parallel, interleaved
    from benchmarks.demosaic import mean_psnr
    from lfcal.camera import preset
    from lfcal.lattice import lattice_of
    from lfcal.multiplex import cfa, demultiplex, lattice_channels

    frame = bayer_frame(shape)
    bayer = cfa("GRBG")
    lattice = lattice_of(preset("r29"))
    colours = np.ones((3, *shape), np.float32)
    spare = np.ones_like(colours)
    bgr = np.ones((*shape, 3), np.uint16)
    views = lattice_channels(frame, lattice, VIEWS, workers=workers)
    # written before, because the first write to new memory takes longer than the copy
    spare_views = np.ones_like(views)
    if workers is not None:
        cv2.setNumThreads(workers)
    works: dict[str, Any] = {
        "opencv": lambda: cv2.demosaicing(frame, cv2.COLOR_BayerGRBG2BGR, bgr),
        "copy colours": lambda: copy_parallel(colours, spare, workers),
        "copy views": lambda: copy_parallel(views, spare_views, workers),
    }
    for name in filters:
        works[f"demosaic, {name}"] = lambda f=name: demultiplex(frame, bayer, filter=f, out=colours, workers=workers)
    for name in ("linear", "cubic"):
        works[f"{VIEWS} x {VIEWS} views, {name}"] = lambda f=name: lattice_channels(
            frame, lattice, VIEWS, filter=f, out=views, workers=workers
        )
    times = interleaved(works, rounds)
    rows = []
    for name, seconds in times.items():
        if name.startswith(("demosaic", str(VIEWS))):
            kind, array = ("colours", colours) if name.startswith("demosaic") else ("views", views)
            quality = mean_psnr(name.removeprefix("demosaic, "), workers=workers) if kind == "colours" else None
            rows.append(Timing(name, seconds, times["opencv"], times[f"copy {kind}"], array.nbytes / 1e6, quality))
    return rows


def command(
    *,
    quick: bool = typer.Option(False, "--quick", help="One round on a quarter of the frame."),
    filters: str = typer.Option("linear,cubic,lmmse,directional", help="Filters for demosaicing."),
    rounds: int = typer.Option(5, min=1, help="Runs of each method; the fastest counts."),
    workers: int | None = typer.Option(
        None, min=1, help="Number of threads, including those of OpenCV; default: every processor."
    ),
    json: JsonOption = False,
) -> None:
    """Compare demosaicing and 31 x 31 views of a 6576 x 4384 frame with OpenCV's bilinear demosaic and a copy.

    Example: `python -m benchmarks multiplex --quick`
    """
    from lfcal.base.threads import worker_count

    shape = (FULL[0] // 2, FULL[1] // 2) if quick else FULL
    rows = measure(shape, [f.strip() for f in filters.split(",")], workers, 1 if quick else rounds)
    if json:
        print_json(
            [
                {
                    "name": r.name,
                    "seconds": r.seconds,
                    "opencv_seconds": r.opencv,
                    "copy_seconds": r.copy,
                    "output_megabytes": r.megabytes,
                    "ratio": r.ratio,
                    "bound": BOUND,
                    "psnr_db": r.psnr_db,
                }
                for r in rows
            ]
        )
        return
    _show(rows, f"{shape[1]} x {shape[0]} px, {worker_count(workers)} threads, shortest times")


def _show(rows: list[Timing], title: str) -> None:
    table = [
        [
            r.name,
            f"{r.megabytes:.0f}",
            f"{1e3 * r.seconds:.0f}",
            f"{1e3 * r.opencv:.0f}",
            f"{1e3 * r.copy:.0f}",
            f"{r.ratio:.2f}",
            "—" if r.psnr_db is None else f"{r.psnr_db:.2f}",
        ]
        for r in rows
    ]
    headers = [
        "method",
        "output (MB)",
        "lfcal (ms)",
        "OpenCV bilinear demosaic (ms)",
        "copy of the output (ms)",
        f"lfcal ÷ (OpenCV + copy), bound {BOUND:g}",
        "PSNR, photographs (dB)",
    ]
    print_table(headers, table, title=title)
