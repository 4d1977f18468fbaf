"""Commands run in a process that may die or never end, and what the test sees of it."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

__all__ = ["Guard", "Outcome"]

ROOT = Path(__file__).resolve().parents[2]
HANG_S = 120
"""Only to end a command that waits for ever; one that computes for ever is ended by its processor time."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a command ended.

    ``code`` is its exit code, None where it ended otherwise; ``failure`` then says how. ``said`` is what it wrote to
    standard error, ``cpu_s`` its processor time.
    """

    code: int | None
    failure: str = ""
    said: str = ""
    cpu_s: float = 0.0


class Guard:
    """One child process, started anew whenever it was lost.

    Parameters
    ----------
    scratch
        An own folder.
    """

    def __init__(self, scratch: Path) -> None:
        self._said = scratch / "said.txt"
        self._child: subprocess.Popen[str] | None = None

    def __enter__(self) -> Self:
        """Return itself; the process starts with the first command."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the process."""
        self._end()

    def run(self, arguments: list[str], folder: Path) -> Outcome:
        """Run one command in ``folder``."""
        child = self._child or self._start()
        assert child.stdin is not None and child.stdout is not None
        child.stdin.write(json.dumps([str(folder), arguments]) + "\n")
        child.stdin.flush()
        ready, _, _ = select.select([child.stdout], [], [], HANG_S)
        answer = child.stdout.readline() if ready else ""
        if answer:
            return Outcome(*json.loads(answer))
        if not ready:
            child.kill()
        status = child.wait()
        self._end()
        said = self._said.read_text(errors="replace")
        names = {-24: "endless computing", -9: "endless waiting"}
        return Outcome(None, names.get(status, f"the process died with status {status}"), said)

    def _start(self) -> subprocess.Popen[str]:
        # threads that wait for work count as processor time
        single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        environment = {**os.environ, **single, "PYTHONPATH": str(ROOT)}
        self._child = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.child", str(self._said)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
            cwd=ROOT,
        )
        return self._child

    def _end(self) -> None:
        if self._child is not None:
            child, self._child = self._child, None
            assert child.stdin is not None and child.stdout is not None
            child.stdin.close()
            child.wait()
            child.stdout.close()
