"""``python -m benchmarks project``: forward and back projection, compared with pyolaf and a loop of FFTs."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import typer

from benchmarks._folder import FolderOption
from lfcal.cli._options import JsonOption, WorkersOption

if TYPE_CHECKING:
    from numpy.typing import NDArray


IMAGE, PERIOD, CUTOUT, REPEATS, SIDE = 1001, 11, 111, 5, 2000
"""Default sides of image, period and cutout (px), number of runs, and side of the R29 region (px)."""


def register(bench: typer.Typer) -> None:
    """Add ``project`` to the benchmarks."""
    bench.command("project")(command)


@dataclass(frozen=True, slots=True)
class Row:
    """One projection method."""

    name: str
    setup_s: float
    forward_s: float
    adjoint_s: float
    error: float
    mismatch: float

    @property
    def pair_s(self) -> float:
        """Time of forward and back projection together (s)."""
        return self.forward_s + self.adjoint_s


def command(
    *,
    image: int = typer.Option(IMAGE, min=32, help="Side of the image (px)."),
    period: int = typer.Option(PERIOD, min=1, help="Side of the period (px), odd."),
    cutout: int = typer.Option(CUTOUT, min=3, help="Side of the cutout (px), odd."),
    planes: int = typer.Option(1, min=1, help="Number of depth planes."),
    repeats: int = typer.Option(REPEATS, min=1, help="Runs of the methods of lfcal; the fastest counts."),
    r29: bool = typer.Option(False, "--r29", help="The R29 problem instead: 95 x 55 positions, 181 x 181, 11 planes."),
    full: bool = typer.Option(
        False, "--full", help="With --r29: project all 11 planes instead of scaling the time of one."
    ),
    side: int = typer.Option(SIDE, "--side", help="With --r29: side of the image region (px)."),
    frame: bool = typer.Option(False, "--frame", help="With --r29: the whole frame, 4384 x 6576, instead of --side."),
    density: float = typer.Option(1.0, "--density", help="With --r29: fraction of the entries of H that are not zero."),
    tolerance: str = typer.Option(
        "",
        "--tolerance",
        help="With --r29: project a simulated plane, exactly and within these tolerances: 0.002,0.005.",
    ),
    device: str = typer.Option(
        "",
        "--device",
        help="With --r29: device of the projection: cpu (default), cuda, cuda:1 or auto. With --tolerance: device that "
        "is compared with the processor (default auto).",
    ),
    folder: FolderOption = None,
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Measure time and error of one forward and one back projection with the same H by every method.

    pyolaf 0.2.1 is included if it can be imported: `pip install --target DIR pyolaf==0.2.1 tqdm --no-deps`, then
    `PYTHONPATH=DIR python -m benchmarks project`.

    Example: `python -m benchmarks project --r29`
    """
    from benchmarks._r29 import FRAME, run_r29
    from lfcal.base.threads import worker_count
    from lfcal.cli._console import print_json
    from lfcal.records.reading import read_planes

    count = worker_count(workers)
    dense = {"--image": image != IMAGE, "--period": period != PERIOD, "--cutout": cutout != CUTOUT}
    dense |= {"--planes": planes != 1, "--repeats": repeats != REPEATS}
    sampled = {"--full": full, "--frame": frame, "--density": density != 1}
    if not r29:
        _refuse(sampled | {"--side": side != SIDE, "--device": bool(device), "--tolerance": bool(tolerance)}, "--r29")
    else:
        _refuse(dense, "no --r29")
        _refuse({"--side": frame and side != SIDE}, "no --frame")
        _refuse({name: bool(tolerance) and given for name, given in sampled.items()}, "no --tolerance")
    if tolerance:
        from benchmarks._reduced import run_reduced, show_reduced

        within = run_reduced(side, read_planes(tolerance, lengths=False), count, device or "auto")
        print_json({"side": side, "workers": count, "rows": within}) if json else show_reduced(within, side)
        return
    if r29:
        found = run_r29(FRAME if frame else (side, side), density, full, folder, count, device or "cpu")
        print_json(found) if json else found.show()
        return
    rows = measure(image, period, cutout, planes, repeats, count)
    if json:
        print_json(
            {"image": image, "period": period, "cutout": cutout, "planes": planes, "workers": count, "rows": rows}
        )
        return
    show(
        rows,
        f"image {image} x {image}, period {period} x {period}, cutout {cutout} x {cutout}, {planes} plane(s), "
        f"{count} threads",
    )


def _refuse(given: Mapping[str, bool], other: str) -> None:
    """Raise `InputError` for the first given option that would be ignored: it requires ``other``."""
    from lfcal.base.errors import InputError

    for option in (name for name, said in given.items() if said):
        needed = other.removeprefix("no ")
        got, change = ("it", f"or {needed}") if needed != other else ("none", f"or add {needed}")
        raise InputError.expected(option, f"{other} with it", got, f"leave {option} out, {change}")


def measure(image: int, period: int, cutout: int, planes: int, repeats: int, workers: int) -> list[Row]:
    """Return timings and errors of all methods for one random problem."""
    import numpy as np

    from benchmarks._projectors import LeanFFT, PyolafPair, pyolaf_version
    from lfcal.reconstruct import Projector

    rng = np.random.default_rng(0)
    shape = (image, image)
    H = rng.random((planes, period, period, cutout, cutout), np.float32)
    data = rng.random((planes, *shape), np.float32), rng.random(shape, np.float32)

    def ours(method: str, dtype: Any, anchor: tuple[int, int] = (0, 0)) -> Projector:
        return Projector(H, shape, anchor, method, dtype=dtype, workers=workers).prepare()

    # double precision is the reference for the others
    exact = ours("polyphase", np.float64)
    truth = exact.adjoint(data[1])
    rows = [_row("polyphase, float64", lambda: ours("polyphase", np.float64), data, truth, 1)]
    for kind in ("polyphase", "direct"):
        rows.append(_row(f"{kind}, float32", partial(ours, kind, np.float32), data, truth, repeats))
    rows.append(_row("per-position FFT, scipy", lambda: LeanFFT(H, workers), data, truth, 1))
    if pyolaf_version():
        # pyolaf has another anchor, for which a separate reference is computed
        there = ours("polyphase", np.float64, PyolafPair(H, shape).anchor).adjoint(data[1])
        rows.append(_row(f"pyolaf {pyolaf_version()}", lambda: PyolafPair(H, shape), data, there, 1))
    return rows


def _row(
    name: str, make: Callable[[], Any], data: tuple[NDArray[Any], NDArray[Any]], truth: NDArray[Any], repeats: int
) -> Row:
    """Return the times of a projector pair, the error of its back projection, and the deviation from an adjoint."""
    import numpy as np

    g, f = data
    start = time.perf_counter()
    pair = make()
    setup = time.perf_counter() - start
    ahead, forward = _best(lambda: pair.forward(g), repeats)
    back, adjoint = _best(lambda: pair.adjoint(f), repeats)
    left, right = np.vdot(ahead.astype(float), f), np.vdot(g.astype(float), back)
    # <Hg, f> = <g, HTf> holds for an exact pair; solvers rely on it.
    mismatch = abs(float(left - right)) / abs(float(left))
    return Row(name, setup, forward, adjoint, float(np.abs(back - truth).max() / np.abs(truth).max()), mismatch)


def _best(run: Callable[[], NDArray[Any]], repeats: int) -> tuple[NDArray[Any], float]:
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        out = run()
        best = min(best, time.perf_counter() - start)
    return out, best


def show(rows: list[Row], title: str) -> None:
    """Print the table, with the time of each method relative to the fastest one of lfcal."""
    from benchmarks._projectors import pyolaf_version
    from lfcal.base.units import format_seconds as seconds
    from lfcal.cli._console import print_table

    ours = min(r.pair_s for r in rows if r.name.endswith("float32"))
    cells = [
        [
            r.name,
            seconds(r.setup_s),
            seconds(r.forward_s),
            seconds(r.adjoint_s),
            f"{r.pair_s / ours:.1f}",
            f"{r.error:.1e}",
            f"{r.mismatch:.1e}",
        ]
        for r in rows
    ]
    headers = [
        "method",
        "set-up",
        "forward",
        "adjoint",
        "÷ fastest of lfcal",
        "largest error / peak",
        "adjoint mismatch",
    ]
    print_table(headers, cells, title=title)
    if not pyolaf_version():
        typer.echo("pyolaf is not installed, so it was not compared: see --help")
