"""``python -m benchmarks inspect``: time and memory of the inspection of H, compared with reading it once."""

from __future__ import annotations

import multiprocessing
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from benchmarks._folder import FolderOption
from lfcal.base.system import peak_memory
from lfcal.base.units import format_bytes
from lfcal.base.units import format_seconds as seconds
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption, WorkersOption

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix


def register(bench: typer.Typer) -> None:
    """Add ``inspect`` to the benchmarks."""
    bench.command("inspect")(command)


@dataclass(frozen=True, slots=True)
class Problem:
    """The H file that is inspected."""

    preset: str
    cutout: int
    planes: int
    noise: float
    compression: str
    workers: int | None


@dataclass(frozen=True, slots=True)
class Figures:
    """Times of reading and inspecting (s), and additional memory of the process (bytes)."""

    plane_bytes: int
    planes: int
    file_bytes: int
    read_s: float
    inspect_s: float
    ratio: float
    read_peak_bytes: int
    inspect_peak_bytes: int
    merit: str
    alarms: list[str]


def command(
    *,
    preset_name: str = typer.Option("r29", "--preset", help="Camera whose planes are simulated."),
    cutout: int = typer.Option(181, min=21, help="Side of the cutout (px); with 181, a plane of r29 has 685 MB."),
    planes: int = typer.Option(1, min=1, help="Number of depth planes."),
    noise: float = typer.Option(
        0.003, help="Noise of a pixel divided by the brightest pixel; noise compresses poorly."
    ),
    compression: str = typer.Option("gzip", help="Compression of the file: gzip, zstd or none."),
    folder: FolderOption = None,
    workers: WorkersOption = None,
    json: JsonOption = False,
) -> None:
    """Write an H file of full size, read it once, inspect it, and compare.

    Example: `python -m benchmarks inspect --preset r29 --planes 2`
    """
    problem = Problem(preset_name, cutout | 1, planes, noise, compression, workers)
    with tempfile.TemporaryDirectory(prefix="lfcal_inspect_", dir=folder) as place:
        path = Path(place) / "H.h5"
        # in a separate process, so that its memory does not count
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as child:
            child.submit(write, path, problem).result()
        found = measure(path, workers)
    if json:
        print_json(found)
    else:
        _show(found, compression)


def measure(path: Path, workers: int | None) -> Figures:
    """Return time and memory of one reading and one inspection of the H file."""
    from lfcal.judge.quality import inspect
    from lfcal.psf import open_psf

    # the compilation of kernels counts neither as time nor as memory
    inspect(small(), workers=workers)
    before = peak_memory()
    start = time.perf_counter()
    with open_psf(path) as H:
        planes, nbytes = len(H), H.nbytes
        for z in range(planes):
            H.plane(z)
    reading = time.perf_counter() - start
    after_reading = peak_memory()
    start = time.perf_counter()
    with open_psf(path) as H:
        report = inspect(H, workers=workers)
    inspecting = time.perf_counter() - start
    return Figures(
        plane_bytes=nbytes // planes,
        planes=planes,
        file_bytes=path.stat().st_size,
        read_s=reading,
        inspect_s=inspecting,
        ratio=inspecting / reading,
        read_peak_bytes=after_reading - before,
        inspect_peak_bytes=peak_memory() - before,
        merit=report.merit,
        alarms=[m.key for m in report.alarms],
    )


def _show(found: Figures, compression: str) -> None:
    rows = [
        ["read once", seconds(found.read_s), "1", format_bytes(found.read_peak_bytes)],
        ["inspect", seconds(found.inspect_s), f"{found.ratio:.2f}", format_bytes(found.inspect_peak_bytes)],
    ]
    title = f"{found.planes} planes of {format_bytes(found.plane_bytes)}, {compression}; found {found.merit}"
    print_table(["", "time", "÷ reading", "memory"], rows, title=title)


def write(path: Path, problem: Problem) -> None:
    """Write a simulated H with noise, plane by plane."""
    import numpy as np

    from lfcal.camera import ScanPlan, preset
    from lfcal.psf.store import PSFWriter
    from lfcal.simulate import simulate_psf

    camera, workers = preset(problem.preset), problem.workers
    sign = -1.0 if camera.optics.telecentric else 1.0
    depths = [sign * (4.0 + 0.5 * z) for z in range(problem.planes)]
    plan = ScanPlan.for_camera(camera, virtual_depths=depths, cutout=problem.cutout)
    rng = np.random.default_rng(0)
    with PSFWriter(
        path, plan.shape, depths=plan.depths_um, camera=camera, compression=problem.compression, workers=workers
    ) as writer:
        for z, depth in enumerate(depths):
            # plane by plane, because 11 planes of the R29 in float32 have 7.5 GB
            one = ScanPlan.for_camera(camera, virtual_depths=[depth], cutout=plan.shape[3:])
            values = simulate_psf(one, (), workers=workers).plane(0).copy()  # a plane is read-only
            top = float(values.max())
            for row in values:
                row += np.float32(problem.noise * top) * rng.standard_normal(row.shape, np.float32)
            writer.write_plane(z, values)


def small() -> PSFMatrix:
    """Return a small H with which every kernel is compiled."""
    from lfcal.camera import ScanPlan, preset
    from lfcal.simulate import simulate_psf

    camera = preset("bench")
    return simulate_psf(ScanPlan.for_camera(camera, virtual_depths=[3.0, 4.0]), ())
