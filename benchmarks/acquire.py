"""``python -m benchmarks acquire``: a session compared with a bare loop that writes the same bytes as safely."""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import typer

from benchmarks._folder import FolderOption
from lfcal.cli._options import JsonOption

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan


def register(app: typer.Typer) -> None:
    """Add the benchmark to ``python -m benchmarks``."""
    app.command("acquire")(command)


def command(
    *,
    folder: FolderOption = None,
    cutout: int = typer.Option(257, "--cutout", help="Side of the cutout (pixels)."),
    rounds: int = typer.Option(5, "--rounds", min=1, help="Rounds; the median ratio counts."),
    json: JsonOption = False,
) -> None:
    """Time planning, and compare a session with a bare loop of pwrite and fdatasync.

    Example: `python -m benchmarks acquire`
    """
    from lfcal.cli._console import print_json, print_table

    planning = time_planning()
    plan = bench_plan(cutout)
    with tempfile.TemporaryDirectory(prefix="lfcal-bench-", dir=folder) as place:
        # in pairs, so that slow moments of the disk affect both; the median excludes outliers
        pairs = [(time_session(plan, Path(place)), time_bare_loop(plan, Path(place))) for _ in range(rounds)]
    ratio = float(np.median([session / bare for session, bare in pairs]))
    session, bare = (float(np.median(times)) for times in zip(*pairs, strict=True))
    megabytes = cutout**2 * 2e-6
    if json:
        print_json(
            {
                "planning_s": planning,
                "session_ms": session * 1e3,
                "bare_loop_ms": bare * 1e3,
                "ratio": ratio,
                "ratios": [a / b for a, b in pairs],
                "positions": plan.n_positions,
                "cutout": cutout,
            }
        )
        return
    rows = [
        ["bare loop: pwrite + fdatasync", f"{bare * 1e3:.3f}", f"{megabytes / bare:.0f}", "1.00"],
        ["session: simulator, checks, journal", f"{session * 1e3:.3f}", f"{megabytes / session:.0f}", f"{ratio:.2f}"],
    ]
    print_table([f"{cutout} x {cutout} px, uint16", "ms per frame", "MB/s", "ratio"], rows)
    typer.echo(f"57,475 positions of the R29 planned and stepped through in {planning:.2f} s")


def time_planning() -> float:
    """Return the time (s) to plan 57,475 positions and iterate over every step once."""
    from lfcal.acquire.options import Options
    from lfcal.acquire.schedule import Schedule
    from lfcal.camera import ScanPlan, preset

    start = time.perf_counter()
    plan = ScanPlan.for_camera(preset("r29"), virtual_depths=[-3, -2, 1.5, 2, 2.5, 3, 3.5, 4, 4.5, 5, 5.5])
    for _ in Schedule.of(plan, Options(darks=0, reference_every=0)).steps():
        pass
    return time.perf_counter() - start


def bench_plan(cutout: int) -> ScanPlan:
    """Return a plan of 1,254 positions with cutouts of ``cutout`` pixels."""
    from lfcal.camera import ScanPlan, preset

    camera = preset("bench")
    side = cutout + 80
    camera = replace(camera, sensor=replace(camera.sensor, shape=(side, side)))
    return ScanPlan.for_camera(camera, virtual_depths=(3.0, 4.0), cutout=cutout)


def time_session(plan: ScanPlan, folder: Path) -> float:
    """Return the time per frame (s) of a whole session, from creating the file to the last acknowledgement."""
    import shutil

    from lfcal.acquire.options import Options
    from lfcal.acquire.session import record
    from lfcal.devices.simulated.backend import simulated_rig

    rig = simulated_rig(plan)
    start = time.perf_counter()
    record(folder / "session", plan, rig, Options(darks=0, reference_every=0))  # what the bare loop writes
    seconds = time.perf_counter() - start
    shutil.rmtree(folder / "session")
    return seconds / plan.n_positions


def time_bare_loop(plan: ScanPlan, folder: Path) -> float:
    """Return the time per frame (s) to write the same bytes at the same places, with one fdatasync per frame."""
    from lfcal.acquire.recording.records import RECORD
    from lfcal.base.system import reserve, sync_data, write_at

    count, record = plan.n_positions, bytes(RECORD.itemsize)
    frame = np.random.default_rng(0).integers(0, 4096, plan.cutout, np.uint16).tobytes()
    start = time.perf_counter()
    descriptor = os.open(folder / "bare", os.O_RDWR | os.O_CREAT)
    try:
        first = count * len(record)
        # as in a recording, because growing a file takes longer than writing into it
        reserve(descriptor, first + count * len(frame))
        write_at(descriptor, bytes(first), 0)
        sync_data(descriptor)
        for k in range(count):
            write_at(descriptor, frame, first + k * len(frame))
            write_at(descriptor, record, k * len(record))
            sync_data(descriptor)
    finally:
        os.close(descriptor)
    seconds = time.perf_counter() - start
    (folder / "bare").unlink()
    return seconds / count
