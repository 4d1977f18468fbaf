"""``python -m benchmarks storage``: error of a stored H against its size, and the times to write and read it."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from benchmarks._folder import FolderOption
from lfcal.cli._console import print_json, print_table, report
from lfcal.cli._options import ForceOption, JsonOption, WorkersOption

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.psf import PSFMatrix

__all__ = ["register"]

SHARES = "0.02,0.01,0.005,0.002,0.001"


def register(bench: typer.Typer) -> None:
    """Add ``storage`` to the benchmarks."""
    bench.command("storage")(command)


@dataclass(frozen=True)
class Stored:
    """One plane of H in a file.

    Attributes
    ----------
    depth
        Virtual depth of the plane.
    name
        Method of storage.
    tolerance
        Requested tolerance; 0: none.
    bytes
        Size of the file.
    write_s, read_s
        Processor times (s) of the fastest writing, and of the fastest reading from the page cache.
    bound
        Largest relative error (L1) of a pattern that the file states; 0 if it states none.
    error
        Relative L1 error of the image of random light.
    worst
        Largest measured relative error (L1) of a pattern.
    """

    depth: float
    name: str
    tolerance: float
    bytes: int
    write_s: float
    read_s: float
    bound: float
    error: float
    worst: float


def command(
    camera: str = typer.Argument("bench", help="Preset."),
    *,
    virtual_depths: str = typer.Option("4", "--virtual-depths", help="Simulated virtual depths: A,B,C."),
    tolerances: str = typer.Option(SHARES, "--tolerances", help="Largest relative errors (L1) of a pattern: A,B,C."),
    planes: int = typer.Option(
        101, min=1, help="Number of planes of the forecast, evenly spread over the virtual depths."
    ),
    repeats: int = typer.Option(3, min=1, help="Runs of each; the fastest counts."),
    chart: Path | None = typer.Option(
        None, "--chart", help="File for a plot of the error against size and time (.png)."
    ),
    folder: FolderOption = None,
    workers: WorkersOption = None,
    force: ForceOption = False,
    json: JsonOption = False,
) -> None:
    """Store simulated planes as float32, rounded, and within tolerances; report sizes, times and true errors.

    Every plane is simulated with its smallest sufficient cutout, and stored with the largest cutout of all planes.

    Example: `python -m benchmarks storage r29 --virtual-depths 2,4,6 --tolerances 0.005`
    """
    from lfcal.psf._steps import check_store_tolerance
    from lfcal.records.reading import read_planes
    from lfcal.tasks import check_output

    depths = sorted(read_planes(virtual_depths, lengths=False))
    shares = [check_store_tolerance(share) for share in read_planes(tolerances, lengths=False)]
    if chart is not None:
        check_output(chart, force=force)
    rows: list[Stored] = []
    shape: tuple[int, ...] = ()
    for depth, H in _simulated(camera, depths, workers):
        shape = H.shape
        if not json:
            report(f"v = {depth:g}: H {shape}, of which {_filled(H)} pixels contain light")
        for row in _measured(H, depth, shares, repeats, folder, workers):
            rows.append(row)
            if not json:
                report(f"  {row.name}: {8 * row.bytes / H.size:.2f} bits per entry")
    ahead = _forecast(rows, planes)
    if chart is not None:
        _draw(chart, rows, shape, f"{camera}, v = {', '.join(f'{depth:g}' for depth in depths)}")
    if json:
        print_json({"shape": shape, "planes": planes, "rows": rows, "forecast_bytes": ahead})
        return
    _show(rows, shape, camera, planes, ahead)


def _simulated(camera: str, depths: Sequence[float], workers: int | None) -> Iterator[tuple[float, PSFMatrix]]:
    """Yield one plane after the other, each in the middle of the largest cutout."""
    import numpy as np

    from lfcal.camera import ScanPlan, preset
    from lfcal.psf import PSFMatrix
    from lfcal.simulate import simulate_psf

    optics = preset(camera)
    plans = [ScanPlan.for_camera(optics, virtual_depths=[depth]) for depth in depths]
    nt, ns = (max(plan.cutout[k] for plan in plans) for k in (0, 1))
    for depth, plan in zip(depths, plans, strict=True):
        plane = simulate_psf(plan, workers=workers).plane(0)
        beside = [(n - m) // 2 for n, m in zip((nt, ns), plan.cutout, strict=True)]
        wide = np.pad(plane, [(0, 0), (0, 0), *((b, b) for b in beside)])
        yield depth, PSFMatrix(wide[None], depths=plan.depths_um, camera=optics)


def _filled(H: PSFMatrix) -> str:
    import numpy as np

    sums = H.depth_sum(0)
    return " x ".join(str(np.flatnonzero(sums.any(axis=axis)).size) for axis in (1, 0))


def _measured(
    H: PSFMatrix, depth: float, shares: Sequence[float], repeats: int, folder: Path | None, workers: int | None
) -> Iterator[Stored]:
    """Yield the results of each method to store a plane."""
    import numpy as np

    from lfcal.psf import open_psf, save

    plane = H.plane(0)
    image = _Image(plane, workers)
    kinds: list[tuple[str, float, dict[str, Any]]] = [
        ("float32", 0.0, {"dtype": "float32"}),
        ("rounded for the plane", 0.0, {"dtype": "rounded"}),
        *((f"within {100 * share:g} %", share, {"store_tolerance": share}) for share in shares),
    ]
    with _scratch(folder) as place:
        for name, share, how in kinds:
            path, seconds = place / "H.h5", [math.inf, math.inf]
            for _ in range(repeats):
                start = time.process_time()
                save(H, path, workers=workers, **how)
                seconds[0] = min(seconds[0], time.process_time() - start)
                with open_psf(path) as small:
                    start = time.process_time()
                    back = small.plane(0)
                    seconds[1] = min(seconds[1], time.process_time() - start)
                    bound = small.facts.bound
            worst = max(_lacking(a, b) for a, b in zip(back, plane, strict=True))
            stated = 0.0 if bound is None else float(np.nan_to_num(bound[0, 2]))
            size = path.stat().st_size
            path.unlink()
            yield Stored(depth, name, share, size, seconds[0], seconds[1], stated, image.error(back), worst)


@contextmanager
def _scratch(folder: Path | None) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="lfcal_storage_", dir=folder) as name:
        yield Path(name)


def _lacking(found: NDArray[Any], truth: NDArray[Any]) -> float:
    """Return the largest relative error (L1) of the patterns of a row of positions."""
    import numpy as np

    lacking = np.abs(found.astype(float) - truth).sum(axis=(1, 2))
    own = np.abs(truth).sum(axis=(1, 2), dtype=float)
    return float(np.divide(lacking, own, out=np.zeros_like(own), where=own > 0).max())


class _Image:
    """The image of random light in three periods of a plane, with all pixels that their patterns reach."""

    def __init__(self, plane: NDArray[Any], workers: int | None) -> None:
        import numpy as np

        ny, nx, nt, ns = plane.shape
        self.workers, self.size = workers, (3 * ny + nt - 1, 3 * nx + ns - 1)
        volume = np.zeros((1, *self.size), np.float32)
        inner = volume[0, (nt - 1) // 2 : (nt - 1) // 2 + 3 * ny, (ns - 1) // 2 : (ns - 1) // 2 + 3 * nx]
        inner[:] = np.random.default_rng(0).random(inner.shape)
        self.volume = volume
        self.truth = self._of(plane)

    def _of(self, plane: NDArray[Any]) -> NDArray[Any]:
        from lfcal.reconstruct import Projector

        found: NDArray[Any] = Projector(plane[None], self.size, method="direct", workers=self.workers).forward(
            self.volume
        )
        return found

    def error(self, plane: NDArray[Any]) -> float:
        """Return the relative L1 error of the image with another plane."""
        import numpy as np

        lacking = np.abs(self._of(plane) - self.truth).sum(dtype=float)
        return float(lacking / np.abs(self.truth).sum(dtype=float))


def _forecast(rows: Sequence[Stored], planes: int) -> dict[str, float]:
    """Return the size of all planes by each method, interpolated linearly between the simulated virtual depths."""
    import numpy as np

    depths = sorted({row.depth for row in rows})
    at = np.linspace(depths[0], depths[-1], planes)
    found: dict[str, float] = {}
    for name in dict.fromkeys(row.name for row in rows):
        sizes = {row.depth: row.bytes for row in rows if row.name == name}
        found[name] = float(np.interp(at, depths, [sizes[depth] for depth in depths]).sum())
    return found


def _show(rows: Sequence[Stored], shape: tuple[int, ...], camera: str, planes: int, ahead: dict[str, float]) -> None:
    from lfcal.base.units import format_bytes
    from lfcal.base.units import format_seconds as seconds

    entries = math.prod(shape[1:])
    cells = [
        [
            f"{row.depth:g}",
            row.name,
            format_bytes(row.bytes),
            f"{8 * row.bytes / entries:.2f}",
            seconds(row.write_s),
            seconds(row.read_s),
            f"{100 * row.bound:.3g} %" if row.bound else "–",
            f"{100 * row.worst:.2g} %",
            f"{100 * row.error:.2g} %",
        ]
        for row in rows
    ]
    headers = ["v", "stored as", "bytes", "bits per entry", "write", "read", "bound", "worst pattern", "image"]
    print_table(
        headers, cells, title=f"{camera}: a plane of {shape[1:]}, {format_bytes(4 * entries)} as uncompressed float32"
    )
    for name, nbytes in ahead.items():
        share = nbytes / (4 * entries * planes)
        told = f"{format_bytes(nbytes)} (forecast), {100 * share:.2g} % of uncompressed float32"
        typer.echo(f"{planes} planes, {name}: {told}")


def _draw(path: Path, rows: Sequence[Stored], shape: tuple[int, ...], what: str) -> None:
    from lfcal.base.figures import LINES, figure, save_figure

    entries = math.prod(shape[1:])
    depths = sorted({row.depth for row in rows})
    axes: list[tuple[str, Any]] = [
        ("bits per entry", lambda row: 8 * row.bytes / entries),
        ("time to write (processor ns per entry)", lambda row: 1e9 * row.write_s / entries),
        ("time to read (processor ns per entry)", lambda row: 1e9 * row.read_s / entries),
    ]
    with figure(9.0, 3.2) as fig:
        first = None
        for k, (label, value) in enumerate(axes):
            panel = fig.add_subplot(1, 3, k + 1, sharey=first)
            first = first or panel
            for depth, colour in zip(depths, LINES * len(depths), strict=False):
                within = [row for row in rows if row.depth == depth and row.tolerance]
                x = [value(row) for row in within]
                panel.plot(x, [100 * row.bound for row in within], "o-", color=colour, label=f"v = {depth:g}, bound")
                panel.plot(x, [100 * row.error for row in within], "o:", color=colour, label="image of random light")
                plane = next(row for row in rows if row.depth == depth and row.name.startswith("rounded"))
                panel.plot(value(plane), 100 * plane.worst, "s", color=colour, label="rounded, worst pattern")
                exact = next(row for row in rows if row.depth == depth and row.name == "float32")
                panel.axvline(value(exact), color=colour, alpha=0.4, label="float32, exact")
            panel.set_yscale("log")
            panel.set_xlabel(label)
            if k == 0:
                panel.set_ylabel("error (%, relative L1)")
                panel.legend(loc="lower center" if len(depths) == 1 else "best", fontsize=6)
        fig.suptitle(f"{what}: H stored in a file", fontsize=10)
        save_figure(fig, path)
