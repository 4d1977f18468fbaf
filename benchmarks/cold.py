"""``python -m benchmarks cold``: times of the first run of a command, which compiles kernels, and a later run."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import typer

from benchmarks._folder import FolderOption
from lfcal.base import LfcalError, check_choice
from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption

__all__ = ["register"]

COMMANDS = "demo,simulate,assemble,inspect,transpose,fit,reconstruct,white"

COMPILING = "from lfcal.base import compiled; from lfcal.cli import main; compiled.SPARED_S = 0; main()"
"""Program that compiles kernels for work of any size."""


def register(bench: typer.Typer) -> None:
    """Add ``cold`` to the benchmarks."""
    bench.command("cold")(command)


@dataclass(frozen=True, slots=True)
class Times:
    """Medians over rounds of a command in a new process, in seconds; ``cold``: with an empty cache of kernels."""

    command: str
    cold_s: float
    warm_s: float
    cold_cpu_s: float
    warm_cpu_s: float


def command(
    *,
    commands: str = typer.Option(COMMANDS, "--commands", help="Commands to time."),
    rounds: int = typer.Option(1, min=1, help="Rounds; medians are reported."),
    folder: FolderOption = None,
    json: JsonOption = False,
) -> None:
    """Time commands on the sample session: with an empty cache of compiled kernels, and with a full one.

    Example: `python -m benchmarks cold --commands demo,simulate`
    """
    chosen = [name.strip() for name in commands.split(",")]
    with tempfile.TemporaryDirectory(prefix="lfcal_cold_", dir=folder) as place:
        found = _measured(chosen, rounds, Path(place))
    if json:
        print_json(found)
        return
    rows = [
        [
            times.command,
            *(f"{seconds:.1f} s" for seconds in (times.cold_s, times.warm_s)),
            f"{times.cold_s / times.warm_s:.2f}",
            *(f"{seconds:.1f} s" for seconds in (times.cold_cpu_s, times.warm_cpu_s)),
            f"{times.cold_cpu_s / times.warm_cpu_s:.2f}",
        ]
        for times in found
    ]
    header = ["command", "first", "later", "ratio", "processor, first", "processor, later", "ratio"]
    print_table(header, rows, title="Commands on the sample session, without and with compiled kernels")


def _measured(chosen: Sequence[str], rounds: int, place: Path) -> list[Times]:
    assembled = place / "H.h5"
    known = _commands(assembled)
    for name in chosen:
        check_choice("command", name, tuple(known))
    _timed(known["assemble"], assembled, place / "kernels", compile_all=True)
    found = []
    for name in chosen:
        taken = []
        for number in range(rounds):
            work = place / f"{name}_{number}"
            work.mkdir()
            # also lets Python compile the modules
            _timed(known[name], work / "before.h5", place / "kernels", compile_all=True)
            cold = _timed(known[name], work / "first.h5", work)
            taken.append([*cold, *_timed(known[name], work / "later.h5", place / "kernels")])
        cold, cold_cpu, warm, warm_cpu = (statistics.median(values) for values in zip(*taken, strict=True))
        found.append(Times(name, cold, warm, cold_cpu, warm_cpu))
    return found


def _commands(assembled: Path) -> dict[str, list[object]]:
    """Return the arguments of each command; the output follows them."""
    from lfcal.simulate import sample_session

    session = sample_session()
    frame, white = (min((session / name).glob("*.png")) for name in ("frames", "white"))
    scan = ["--plan", session / "plan.json", "--dark", session / "dark", "--white", session / "white"]
    return {
        "demo": ["demo"],
        "simulate": ["simulate", "bench", "--virtual-depths", "3", "-o"],
        "assemble": ["assemble", session / "frames", *scan, "-o"],
        "inspect": ["inspect", assembled, "--report"],
        "transpose": ["transpose", assembled, "-o"],
        "fit": ["fit", assembled, "--positions", "4", "-o"],
        "reconstruct": ["reconstruct", assembled, frame, "-o"],
        "white": ["white", white, "-o"],
    }


def _timed(arguments: Sequence[object], out: Path, cache: Path, *, compile_all: bool = False) -> tuple[float, float]:
    """Return the wall time and processor time (s) of a command in a new process, with kernels cached in a folder.

    With ``compile_all``, kernels are compiled for work of any size.
    """
    run = ["-c", COMPILING] if compile_all else ["-m", "lfcal"]
    line = [sys.executable, *run, *map(str, arguments), str(out)]
    own = {"NUMBA_CACHE_DIR": str(cache), "PYTHONPYCACHEPREFIX": str(cache.parent / "modules")}
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | own
    start, spent = time.perf_counter(), _children_seconds()
    done = subprocess.run(line, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise LfcalError(f"lfcal {arguments[0]}: {done.stderr.strip()}")
    return time.perf_counter() - start, _children_seconds() - spent


def _children_seconds() -> float:
    """Return the processor time (s) of all child processes that have ended."""
    found = os.times()
    return found.children_user + found.children_system
