"""``python -m benchmarks transpose``: Table 1 of M. Eberhart, arXiv:2003.09133, on this machine."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from statistics import median
from typing import TYPE_CHECKING

import typer

from lfcal.base.errors import InputError
from lfcal.base.progress import Clock, Work
from lfcal.base.units import format_bytes
from lfcal.cli._options import JsonOption, WorkersOption

if TYPE_CHECKING:
    from benchmarks._transposers import Scaled

PLANES = 11


@dataclass(frozen=True, slots=True)
class Size:
    """One row of the paper's Table 1: pixels and positions, and the seconds printed there."""

    pixels: int
    ny: int
    nx: int
    printed: tuple[float | None, float | None, float | None, float | None] = (None, None, None, None)

    @property
    def name(self) -> str:
        """The name for the command line, ``pixels/positions``."""
        return f"{self.pixels}/{self.nx}" if self.ny == self.nx else f"{self.pixels}/{self.ny}x{self.nx}"

    @property
    def plane_bytes(self) -> int:
        """Bytes of one float32 depth plane."""
        return 4 * self.ny * self.nx * self.pixels**2


TABLE_1 = (
    Size(111, 11, 11, (29.0, 1.3, 14.5, 0.2)),
    Size(221, 11, 11, (60.7, 6.2, 29.1, 1.0)),
    Size(331, 11, 11, (166.3, 14.3, 61.7, 2.9)),
    Size(551, 11, 11, (839.0, 48.0, 198.4, 9.1)),
    Size(771, 11, 11, (1679.3, 96.1, 658.3, 19.6)),
    Size(1101, 11, 11, (4382.0, 241.3, 1164.9, 42.6)),
    Size(127, 21, 21, (467.3, 3.5, 208.7, 1.2)),
    Size(187, 31, 31, (4239.0, 15.5, 1289.0, 5.3)),
    Size(307, 51, 51, (88425.0, 363.5, 25493.0, 74.7)),
    Size(181, 55, 95, (None, None, None, 24.4)),
)
"""Printed seconds: references 17, 13, 19 and the paper's own algorithm; Matlab 2019a, i7-6700K, 11 planes."""


@dataclass(frozen=True, slots=True)
class Row:
    """One size measured: seconds for all planes, scaled from ``planes_run`` of them.

    ``processor_ratio`` is the processor time of lfcal divided by that of the copy on one thread. Other load hardly
    changes this ratio.
    """

    size: Size
    planes: int
    planes_run: int
    nbytes: int
    lfcal: float | None = None
    copy_parallel: float | None = None
    copy: float | None = None
    processor_ratio: float | None = None
    paper_loop: Scaled | None = None

    @property
    def ratio(self) -> float | None:
        """Time of lfcal divided by that of the faster copy."""
        if self.lfcal is None or self.copy is None or self.copy_parallel is None:
            return None
        return self.lfcal / min(self.copy, self.copy_parallel)


@dataclass(frozen=True, slots=True)
class Settings:
    """Extent of the measurement."""

    planes: int
    memory: int
    workers: int | None
    rounds: int
    loop_seconds: float
    pyolaf_pixels: int


def register(bench: typer.Typer) -> None:
    """Add ``transpose`` to the benchmarks."""
    bench.command("transpose")(command)


def chosen(text: str | None) -> tuple[Size, ...]:
    """Return the sizes named in ``text``: ``111/11,181/55x95``; those of Table 1 keep their printed seconds."""
    if not text:
        return TABLE_1
    known = {size.name: size for size in TABLE_1}
    return tuple(known.get(part) or _parsed(part) for part in text.replace(" ", "").split(","))


def _parsed(text: str) -> Size:
    try:
        pixels, positions = text.split("/")
        ny, _, nx = positions.partition("x")
        size = Size(int(pixels), int(ny), int(nx or ny))
    except ValueError:
        size = Size(0, 0, 0)
    if size.pixels < 1 or size.pixels % 2 == 0 or min(size.ny, size.nx) < 1:
        raise InputError.expected(
            "size", "odd pixels/positions such as 111/11 or 181/55x95", repr(text), "name it like these"
        )
    return size


def iter_rows(sizes: tuple[Size, ...], settings: Settings) -> Work[list[Row]]:
    """Measure ``sizes`` one after the other."""
    clock = Clock("transpose", len(sizes))
    rows = []
    for k, size in enumerate(sizes):
        yield clock.at(k, size.name)
        rows.append(measure(size, settings))
    yield clock.at(len(sizes))
    return rows


def measure(size: Size, settings: Settings) -> Row:
    """Return the times of one size; all methods write into the same memory, which was written before."""
    import numpy as np

    from benchmarks import _transposers as ways
    from lfcal.psf import transpose

    run = min(settings.planes, settings.memory // (2 * size.plane_bytes))
    row = Row(size, settings.planes, run, size.plane_bytes * settings.planes)
    if run == 0:
        return row
    H = ways.random_matrix((run, size.ny, size.nx, size.pixels, size.pixels))
    out = np.zeros_like(H)
    out.fill(1)
    transpose(H, out=out, workers=settings.workers)
    ways.check_transposed(H, out)
    works = {
        "lfcal": lambda: transpose(H, out=out, workers=settings.workers),
        "copy_parallel": lambda: ways.copy_parallel(H, out, settings.workers),
        "copy": lambda: np.copyto(out, H),
    }
    times = ways.interleaved(works, settings.rounds)
    busy = ways.interleaved(works, settings.rounds, time.process_time)
    loop = None
    if size.ny % 2 and size.nx % 2:
        found = ways.paper_loop(H, out, settings.loop_seconds)
        loop = ways.Scaled(found.seconds * settings.planes / run, found.share * run / settings.planes)
    seconds = {name: value * settings.planes / run for name, value in times.items()}
    ratio = busy["lfcal"] / busy["copy"] if busy["copy"] else None  # the clock of some systems is coarse
    return Row(size, settings.planes, run, row.nbytes, **seconds, processor_ratio=ratio, paper_loop=loop)


@dataclass(frozen=True, slots=True)
class PlaneTimes:
    """Work on one R29 plane in memory (float32): 55 x 95 positions, 181 x 181 pixels."""

    nbytes: int
    slice_median: float
    slice_slowest: float
    depth_sum: float
    read_once: float


def measure_plane(settings: Settings) -> PlaneTimes | None:
    """Return the times of single HT slices at random positions and of a depth-plane sum; None: no memory."""
    import numpy as np

    from benchmarks import _transposers as ways
    from lfcal.psf._transpose import depth_sum, ht_slice

    size = TABLE_1[-1]
    if size.plane_bytes > settings.memory:
        return None
    plane = ways.random_matrix((1, size.ny, size.nx, size.pixels, size.pixels))[0]
    ht_slice(plane, 0, 0)
    slices = []
    for position in np.random.default_rng(2).integers(0, (size.ny, size.nx), (200, 2)).tolist():
        start = time.perf_counter()
        ht_slice(plane, *position)
        slices.append(time.perf_counter() - start)
    times = ways.interleaved(
        {
            "depth_sum": lambda: depth_sum(plane, workers=settings.workers),
            "read_once": lambda: ways.read_once(plane, settings.workers),
        },
        settings.rounds,
    )
    return PlaneTimes(plane.nbytes, median(slices), max(slices), **times)


@dataclass(frozen=True, slots=True)
class Pyolaf:
    """Result of pyolaf 0.2.1 for 111/11 with 11 planes, or the reason why it was not run."""

    version: str = ""
    missing: str = ""
    found: Scaled | None = None
    same_as_paper: bool = False


def measure_pyolaf(settings: Settings) -> Pyolaf:
    """Return the time of pyolaf, and whether its values equal those of ``method="paper"`` (a part of HT)."""
    import numpy as np

    from benchmarks import _transposers as ways
    from lfcal.psf import transpose

    size = TABLE_1[0]
    try:
        import pyolaf
        import pyolaf.lf
    except ImportError as error:
        return Pyolaf(missing=str(error))
    H = ways.random_matrix((1, size.ny, size.nx, size.pixels, size.pixels))
    values, found = ways.pyolaf_backward(H, settings.pyolaf_pixels, PLANES)
    paper = transpose(H, method="paper")[0, : settings.pyolaf_pixels, : settings.pyolaf_pixels]
    same = bool(np.allclose(values, paper, rtol=1e-6))
    return Pyolaf(getattr(pyolaf, "__version__", ""), found=found, same_as_paper=same)


def command(
    *,
    sizes: str | None = typer.Option(
        None, help="Sizes as pixels/positions, such as 111/11,181/55x95; default: all of Table 1."
    ),
    planes: int = typer.Option(PLANES, min=1, help="Number of depth planes."),
    quick: bool = typer.Option(
        False, "--quick", help="Use fewer planes, rounds and steps of the loop of the paper; takes about a minute."
    ),
    memory: float | None = typer.Option(
        None, min=0.0, help="Memory for H and HT together (GB); default: 60 % of the free memory."
    ),
    workers: WorkersOption = None,
    markdown: bool = typer.Option(False, "--markdown", help="Print the table as Markdown."),
    json: JsonOption = False,
) -> None:
    """Compare the transpose with memory copies, the loop of the paper, pyolaf and the times printed in the paper.

    Example: `python -m benchmarks transpose --quick --sizes 111/11,187/31`
    """
    from lfcal.base.system import free_memory
    from lfcal.cli._console import print_json, run_work

    # not all of the free memory, because swapping would measure the disk
    limit = int(memory * 1e9) if memory is not None else int(0.6 * free_memory())
    settings = (
        Settings(planes, min(limit, 1_500_000_000), workers, 3, 0.3, 1)
        if quick
        else Settings(planes, limit, workers, 7, 3.0, TABLE_1[0].nx)
    )
    rows = run_work(iter_rows(chosen(sizes), settings), quiet=json)
    plane = measure_plane(settings)
    pyolaf = measure_pyolaf(settings)
    if json:
        print_json({"rows": [{**asdict(r), "ratio": r.ratio} for r in rows], "plane": plane, "pyolaf": pyolaf})
    else:
        show(rows, plane, pyolaf, settings, markdown=markdown)


HEADERS = (
    "ns",
    "ny x nx",
    "H",
    "lfcal",
    "copy, all threads",
    "copy, 1 thread",
    "lfcal ÷ faster copy",
    "processor time ÷ copy",
    "paper's loop in numpy",
    "[17]",
    "[13]",
    "[19]",
    "paper",
)


def cells(row: Row) -> list[str]:
    """Return a row of the table; ``*`` marks scaled values."""
    part = "*" if row.planes_run < row.planes else ""
    loop = row.paper_loop
    return [
        str(row.size.pixels),
        f"{row.size.ny} x {row.size.nx}",
        format_bytes(row.nbytes),
        *(_seconds(value, part) for value in (row.lfcal, row.copy_parallel, row.copy)),
        *("—" if value is None else f"{value:.2f}" for value in (row.ratio, row.processor_ratio)),
        "—" if loop is None else _seconds(loop.seconds, "*" if loop.share < 1 else ""),
        *("—" if value is None else f"{value:.1f}" for value in row.size.printed),
    ]


def _seconds(value: float | None, mark: str) -> str:
    return "—" if value is None else f"{value:.3g}{mark}" if value < 1000 else f"{value:.0f}{mark}"


def show(rows: list[Row], plane: PlaneTimes | None, pyolaf: Pyolaf, settings: Settings, *, markdown: bool) -> None:
    """Print the table and the notes."""
    from lfcal.base.threads import worker_count
    from lfcal.cli._console import print_table

    table = [cells(row) for row in rows]
    threads = worker_count(settings.workers)
    title = f"Transpose of float32 H, {settings.planes} depth planes: shortest times (s), {threads} threads"
    if markdown:
        for line in (HEADERS, ["--:"] * len(HEADERS), *table):
            typer.echo(f"| {' | '.join(line)} |")
    else:
        print_table(list(HEADERS), table, title=title)
    for line in notes(rows, plane, pyolaf):
        typer.echo(line)


def notes(rows: list[Row], plane: PlaneTimes | None, pyolaf: Pyolaf) -> list[str]:
    """Return the notes on the table and the other measurements, one line each."""
    lines = [
        "All methods write into the same memory, which was written before. Columns [17], [13], [19] and paper: seconds "
        "printed in Table 1 of arXiv:2003.09133 (Matlab 2019a, i7-6700K)."
    ]
    scaled = [
        f"{row.size.name} ({row.planes_run} of {row.planes} planes)" for row in rows if 0 < row.planes_run < row.planes
    ]
    if scaled:
        lines.append(f"* scaled, because not all planes fit into the memory: {', '.join(scaled)}.")
    loops = [row.paper_loop.share for row in rows if row.paper_loop is not None and row.paper_loop.share < 1]
    if loops:
        lines.append(
            f"* the loop of the paper was stopped after {min(loops):.2%} or more of its assignments, and scaled."
        )
    left_out = [row.size.name for row in rows if row.planes_run == 0]
    if left_out:
        lines.append(f"Not run, because two copies of a plane do not fit into the memory: {', '.join(left_out)}.")
    if plane is None:
        lines.append("HT slice and depth sum: not run, because an R29 plane does not fit into the memory.")
    else:
        lines += [
            f"HT slice of an R29 plane ({format_bytes(plane.nbytes)}): median {1e3 * plane.slice_median:.2f} ms, "
            f"slowest of 200 {1e3 * plane.slice_slowest:.2f} ms (bound 2 ms).",
            f"Depth-plane sum: {1e3 * plane.depth_sum:.1f} ms; reading once {1e3 * plane.read_once:.1f} ms; ratio "
            f"{plane.depth_sum / plane.read_once:.2f} (bound 2).",
        ]
    ours = next((row.lfcal for row in rows if row.size == TABLE_1[0] and row.planes == PLANES), None)
    return [*lines, _pyolaf_line(pyolaf, ours)]


def _pyolaf_line(pyolaf: Pyolaf, ours: float | None) -> str:
    if pyolaf.found is None:
        return f"pyolaf: not run ({pyolaf.missing}); install it with `pip install pyolaf==0.2.1`."
    share = f", scaled from {pyolaf.found.share:.2%} of the work" if pyolaf.found.share < 1 else ""
    times = f"; lfcal is {pyolaf.found.seconds / ours:,.0f} times faster" if ours else ""
    values = f"the values {'equal' if pyolaf.same_as_paper else 'differ from'} those of method paper"
    return f"pyolaf {pyolaf.version} on 111/11, 11 planes: {pyolaf.found.seconds:.0f} s{share}{times}; {values}."
