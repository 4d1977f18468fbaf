"""Commands in units that are killed several times, or their workers, and what their journals show of it."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lfcal.work import parts_folder
from lfcal.work.journal import JOURNAL

HANG_S = 600
"""Only to end a run that hangs."""


@dataclass
class Killed:
    """How a command fared.

    Attributes
    ----------
    runs, workers
        Kills of the whole command, and of single workers of it.
    done
        How often each unit was done to its end, over all runs.
    again
        Units that were begun although an earlier run had done them.
    """

    runs: int = 0
    workers: int = 0
    done: dict[str, int] = field(default_factory=dict)
    again: list[str] = field(default_factory=list)


def kill_until_whole(words: Sequence[str], out: Path, place: Path, kills: int) -> Killed:
    """Run ``lfcal WORDS --resume`` in ``place``, kill it or a worker ``kills`` times, let it end.

    Kills come after a number of lines of the journal, never by the clock. A run that ends before its kill is started
    again.
    """
    found, tries = Killed(), 0
    journal = parts_folder(out) / JOURNAL
    command = [sys.executable, "-m", "lfcal", *words, "--resume"]
    finished: set[str] = set()
    while found.runs + found.workers < kills:
        tries += 1
        assert tries < 20 * kills + 20, "it always ends before it is killed"
        before = journal.stat().st_size if journal.exists() else 0
        run = subprocess.Popen(
            command, cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
        )
        try:
            _wait(run, journal, before, 2 + tries % 4)
            pids = list(workers_of(run.pid)) if tries % 2 else []
            if run.poll() is None and pids:
                with suppress(ProcessLookupError):
                    os.kill(pids[tries // 2 % len(pids)], signal.SIGKILL)
                    found.workers += 1
                _wait(run, journal, before, 5 + tries % 4)
            if run.poll() is None:
                # sometimes the run continues without its worker, and ends
                if not pids or tries % 4 == 1:
                    run.kill()
                    found.runs += 1
            lines = _noted(journal)
            said = run.communicate(timeout=HANG_S)[1]
        finally:
            _end(run)
        assert run.returncode in (0, -signal.SIGKILL), said.decode()
        _count(lines or _noted(journal), finished, found)
        if not journal.exists():  # it ended before it was killed
            finished.clear()
            if out.exists():
                _remove(out)
    last = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=HANG_S, check=False)
    assert last.returncode == 0, last.stderr
    return found


def workers_of(pid: int) -> Iterator[int]:
    """Yield the processes that a run began to do its units, those of dask's local cluster, too."""
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        with suppress(OSError, IndexError):
            # the name in parentheses may hold anything: fields are counted from behind it
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            words = (entry / "cmdline").read_bytes()
            if parent == pid and b"spawn_main" in words:
                yield int(entry.name)


def _wait(run: subprocess.Popen[bytes], journal: Path, since: int, wanted: int) -> None:
    """Wait for so many lines of the journal after ``since``, or for the end of the run."""
    while run.poll() is None:
        with suppress(OSError):
            if journal.read_bytes()[since:].count(b"\n") >= wanted:
                return
        time.sleep(0.005)


def _noted(journal: Path) -> list[dict[str, Any]]:
    found = []
    with suppress(OSError):
        for line in journal.read_text().splitlines():
            with suppress(ValueError):  # half a line of one that was killed
                found.append(json.loads(line))
    return found


def _count(lines: list[dict[str, Any]], finished: set[str], found: Killed) -> None:
    """Note what the last run of a journal did, and what of it had been done by those before."""
    begins = [k for k, line in enumerate(lines) if line["event"] == "begin"]
    if not begins:
        return
    for line in lines[begins[-1] :]:
        name = line.get("unit", "")
        if line["event"] == "started" and name in finished:
            found.again.append(name)
        elif line["event"] in ("done", "kept"):
            if line["event"] == "done":
                found.done[name] = found.done.get(name, 0) + 1
            finished.add(name)


def _remove(out: Path) -> None:
    if out.is_dir():
        shutil.rmtree(out)
    else:
        out.unlink()


def _end(run: subprocess.Popen[bytes]) -> None:
    """End what is left of a run: it is a session of its own, and workers of dask's end a while after it."""
    with suppress(ProcessLookupError):
        os.killpg(run.pid, signal.SIGKILL)
    run.wait()
