"""How long actions of the user on an R29, and the first display of each page, hold the thread of the window."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

__all__ = ["LONG_MS", "LongestTurn", "first_visits", "holds"]

IDLE_S = 300.0

LONG_MS = 50.0
"""Duration of a turn of the event loop above which a user notices it (ms)."""


class LongestTurn:
    """Longest turn of the event loop of a window (ms of processor time), and the number of long ones, by action."""

    def __init__(self, app: Any, busy: Callable[[], bool]) -> None:
        self._app, self._busy = app, busy
        self.found: dict[str, float] = {}
        self.long: dict[str, int] = {}

    def do(self, name: str, action: Callable[..., object], *values: Any) -> None:
        """Do ``action`` with ``values``, and process events until the window is idle."""
        self.turn(name, action, *values)
        end, calm = time.monotonic() + IDLE_S, 0
        while calm < 5 and time.monotonic() < end:
            self.turn(name, self._app.processEvents)
            calm = 0 if self._busy() else calm + 1
            time.sleep(0.002)

    def turn(self, name: str, action: Callable[..., object], *values: Any) -> None:
        """Do ``action`` with ``values``, as one turn of the event loop."""
        start = time.thread_time()
        action(*values)
        ms = 1e3 * (time.thread_time() - start)
        self.found[name] = max(ms, self.found.get(name, 0.0))
        self.long[name] = self.long.get(name, 0) + (ms > LONG_MS)

    def result(self) -> dict[str, tuple[float, int]]:
        """Return the longest turn (ms) of each action, and the number of turns longer than `LONG_MS`."""
        return {name: (ms, self.long[name]) for name, ms in self.found.items()}


def holds(plane: tuple[int, int, int, int], frame: tuple[int, int]) -> dict[str, tuple[float, int]]:
    """Return the longest turn (ms of processor time) of each action, with an H and a frame of these shapes."""
    from PySide6.QtWidgets import QApplication

    from lfcal.psf import PSFMatrix
    from lfcal_gui.app import begin, make_window, parse

    found_app = QApplication.instance()
    app: Any = found_app or QApplication(["lfcal"])
    ny, nx, nt, ns = plane
    rng = np.random.default_rng(0)
    row = rng.random((nx, nt, ns), np.float32)
    with TemporaryDirectory() as folder:
        window = make_window(app, options := parse([]), folder=Path(folder))
        window.show()
        begin(window, options)
        held = LongestTurn(app, lambda: window.jobs.busy)
        _start(held, window, "start", "start")
        window.context.matrices.put("plane", PSFMatrix(np.broadcast_to(row, (1, ny, nx, nt, ns)).copy()))
        window.go("h")
        held.do("H is opened", lambda: window.project.update("open", psf="plane"))
        page: Any = window.page("h")
        for k in range(20):
            held.do("another position", page.panel.map.chosen.emit, 7 * k % ny, 3 * k % nx)
        for _ in range(4):
            held.do("H and HT", lambda: page.set_intent(transposed=not page.intent.transposed))
            held.do("another scale", lambda: page.panel.toggle_scale("log"))
        for k in range(5):
            held.do("pointer", page.panel.main_view.hovered.emit, k, k, 1.0)
        for width in (1500, 1900, 1280):
            held.do("another size", window.resize, width, 900)
        for _ in range(2):
            held.do("another theme", window.toggle_theme)
        held.do("undo", window.project.undo)
        _frames(held, window.jobs, frame)
        held.do("closing", window.shut_down)
        window.close()
    held.found.pop("start")
    return held.result()


def _start(held: LongestTurn, window: Any, started: str, made: str) -> None:
    """Wait for the time in which no user acts after the start, and then until the window has made its pages."""
    from lfcal_gui.window import IMPORT_MS

    shown = time.monotonic()
    while time.monotonic() < shown + 2 * IMPORT_MS / 1e3:
        held.do(started, lambda: None)
    while window.ahead.active:
        held.do(made, lambda: None)


def _frames(held: LongestTurn, jobs: Any, shape: tuple[int, int]) -> None:
    from lfcal_gui.models import Shot
    from lfcal_gui.widgets import Picture

    rng = np.random.default_rng(1)
    view = Picture(jobs=jobs)
    view.resize(1200, 800)
    view.show()
    for k in range(3):
        pixels = rng.integers(0, 4096, shape, np.uint16)
        held.do("another frame", view.set_shot, Shot(pixels, levels=(0, 4095)))
        held.do("zoom into a frame", view.show_part, 100 * k, 100 * k, 300, 400)
        held.do("whole frame", view.show_all)
    view.close()


VISITS = """
import json, sys
from pathlib import Path
from benchmarks._window_holds import visit_all
print(json.dumps(visit_all(Path({folder!r}), ahead={ahead})))
"""


def visit_all(folder: Path, *, ahead: bool = True) -> dict[str, tuple[float, int]]:
    """Return the longest turn (ms) and the number of long ones, for the first display of each page and two plans.

    ``ahead``: the user waits until the window has made its pages; otherwise it had no time to make any.
    """
    from PySide6.QtWidgets import QApplication

    from lfcal_gui.app import begin, make_window, parse

    app, options = QApplication(["lfcal"]), parse([])
    window = make_window(app, options, folder=folder)
    window.show()
    if not ahead:
        window.ahead.start = lambda: None  # type: ignore[method-assign]
    begin(window, options)
    held = LongestTurn(app, lambda: window.jobs.busy)
    _start(held, window, "after the start", "pages are made")
    for spec in window.specs:
        held.do(spec.title, window.visit, spec.key)
    window.go("setup")
    setup: Any = window.page("setup")
    held.do("Set up again", lambda: None)
    held.do("a first plan", setup.make_default)
    held.do("another plan", setup._scan_edited, "cutout", (41, 41))
    window.shut_down()
    return held.result()


def first_visits() -> dict[str, tuple[float, int]]:
    """Return the results of `visit_all` in new processes, in which pages are made before they are shown, or then."""
    environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    found: dict[str, tuple[float, int]] = {}
    for ahead, words in ((True, ""), (False, ", immediately after the start")):
        with TemporaryDirectory() as folder:
            command = [sys.executable, "-c", VISITS.format(folder=folder, ahead=ahead)]
            done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        once: dict[str, tuple[float, int]] = json.loads(done.stdout.splitlines()[-1])
        found |= {f"{name}{words}": held for name, held in once.items()}
    return found
