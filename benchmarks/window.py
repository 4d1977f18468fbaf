"""``python -m benchmarks window``: layout, response to the pointer, clicks, live frames, start-up, long turns.

Other programs lengthen the wall time. The benchmark therefore also reports the processor time of the thread of the
window and, where more threads work, that of all threads.
"""

from __future__ import annotations

import json as json_library
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import typer

from benchmarks._window_clicks import clicks
from benchmarks._window_holds import LONG_MS, first_visits, holds
from benchmarks._window_layout import hovering, layout
from lfcal.base.errors import InputError
from lfcal.cli._console import print_json
from lfcal.cli._options import JsonOption

MEASURED = ("layout", "hovering", "clicks", "first_visits", "start_up", "scrubbing", "live_frames", "holds")
R29_PLANE = (55, 95, 181, 181)
R29_FRAME = (4384, 6576)

EMPTY_WINDOW = """
import time; t = time.perf_counter(), time.process_time()
from PySide6.QtWidgets import QApplication, QMainWindow
import pyqtgraph as pg
app = QApplication([]); w = QMainWindow(); w.setCentralWidget(pg.GraphicsLayoutWidget()); w.show(); app.processEvents()
print(time.perf_counter() - t[0], time.process_time() - t[1])
"""
OUR_WINDOW = """
import time; t = time.perf_counter(), time.process_time()
from pathlib import Path
from PySide6.QtWidgets import QApplication
from lfcal_gui.app import begin, make_window, parse
o = parse({words!r}); app = QApplication([]); w = make_window(app, o, folder=Path({folder!r})); w.show(); begin(w, o)
app.processEvents()
print(time.perf_counter() - t[0], time.process_time() - t[1]); w.shut_down()
"""


def register(bench: typer.Typer) -> None:
    """Add ``window`` to the benchmarks."""
    bench.command("window")(command)


def command(
    *,
    small: bool = typer.Option(False, "--small", help="Use a plane and a frame of a tenth of the size."),
    only: str = typer.Option(",".join(MEASURED), help="Measurements to run: A,B,C; default: all."),
    json: JsonOption = False,
) -> None:
    """Measure the layout of the window, its response, clicks, live frames, start-up and longest turns.

    Example: `python -m benchmarks window --small --only scrubbing`
    """
    wanted = [name.strip() for name in only.split(",")]
    if not set(wanted) <= set(MEASURED):
        raise InputError.expected("--only", f"some of {', '.join(MEASURED)}", only, "correct it")
    os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
    scale = 0.1 if small else 1.0
    side = scale**0.5
    plane = (*R29_PLANE[:2], int(R29_PLANE[2] * side) | 1, int(R29_PLANE[3] * side) | 1)
    frame = (int(R29_FRAME[0] * side), int(R29_FRAME[1] * side))
    measures: dict[str, Callable[[], dict[str, Any]]] = {
        "layout": layout,
        "hovering": hovering,
        "clicks": clicks,
        "first_visits": first_visits,
        "start_up": start_up,
        "scrubbing": lambda: scrubbing(scale),
        "live_frames": lambda: live_frames(scale),
        "holds": lambda: holds(plane, frame),
    }
    if len(wanted) == 1:
        found = {name: measures[name]() for name in wanted}
    else:
        found = {name: _measured_alone(name, small=small) for name in MEASURED if name in wanted}
    if json:
        print_json(found)
        return
    for name, measured in found.items():
        typer.echo(WORDS[name](measured))


def _measured_alone(name: str, *, small: bool) -> Any:
    """Return one measurement in a new process; an application with windows of others takes longer to style."""
    command = [sys.executable, "-m", "benchmarks", "window", "--json", "--only", name, *(["--small"] if small else [])]
    return json_library.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)[name]


def _start_words(start: dict[str, Any]) -> str:
    return (
        f"start-up: {start['window_s']:.2f} s, with --demo {start['demo_s']:.2f} s, "
        f"an empty PySide6 + pyqtgraph window {start['empty_s']:.2f} s (medians of {start['runs']}); processor time "
        f"{start['window_cpu_s']:.2f}, {start['demo_cpu_s']:.2f}, {start['empty_cpu_s']:.2f} s"
    )


def _scrub_words(scrub: dict[str, Any]) -> str:
    return (
        f"scrubbing HT over a {scrub['plane']} plane: {scrub['per_second']:.0f} pictures per second, "
        f"longest {scrub['longest_ms']:.0f} ms; window's thread busy {scrub['busy_ms']:.1f} ms per picture (median)"
    )


def _live_words(live: dict[str, Any]) -> str:
    return (
        f"live frames of {live['frame']}: {live['per_second']:.1f} per second, window's thread busy "
        f"{live['busy_ms']:.1f} ms per frame (median), all threads {live['all_ms']:.1f} ms per frame"
    )


def _listed(title: str, found: dict[str, tuple[float, int]]) -> str:
    rows = sorted(found.items(), key=lambda pair: -pair[1][0])
    return "\n".join(
        (
            f"{title} (ms of the window's thread; turns above {LONG_MS:.0f} ms):",
            *(f"  {ms:6.0f}  {long:3}  {name}" for name, (ms, long) in rows),
        )
    )


def _layout_words(found: dict[str, Any]) -> str:
    rows = [f"visible controls: header {found['header']}, rail {found['rail']}"]
    for name, view in found["views"].items():
        width, height = view["least"]
        rows.append(
            f"  {view['place']}, {name}: {view['controls']}, primary buttons {view['primary']}, "
            f"smallest size {width} x {height}"
        )
    for size, one in found["shares"].items():
        width, height = one["window"]
        rows.append(f"H and HT at {size}: {100 * one['share']:.1f} % of the window ({width} x {height})")
    return "\n".join(rows)


def _hover_words(found: dict[str, float]) -> str:
    return "\n".join(
        f"{words}: median {found[f'{key}_median_ms']:.1f} ms, 95 % {found[f'{key}_95_ms']:.1f} ms, "
        f"worst {found[f'{key}_worst_ms']:.1f} ms; window's thread held {found[f'{key}_held_ms']:.1f} ms at most, "
        f"{found[f'{key}_long']:.0f} times above {LONG_MS:.0f} ms"
        for key, words in (("hover", "pointer on H to HT drawn"), ("plane", "another plane to H drawn"))
    )


def _click_words(found: dict[str, dict[str, Any]]) -> str:
    rows = ["sittings: clicks + names typed"]
    for one in found.values():
        keys = f", {one['keys']} keys" if one["keys"] else ""
        rows.append(f"  {one['clicks']} + {one['names']}{keys}: {one['what']}")
        rows.append(f"      {', '.join(one['did'])}")
    return "\n".join(rows)


WORDS: dict[str, Callable[[dict[str, Any]], str]] = {
    "layout": _layout_words,
    "hovering": _hover_words,
    "clicks": _click_words,
    "first_visits": lambda found: _listed("first display of each page", found),
    "start_up": _start_words,
    "scrubbing": _scrub_words,
    "live_frames": _live_words,
    "holds": lambda found: _listed("longest turn of each action", found),
}


def start_up(runs: int = 5) -> dict[str, Any]:
    """Return the times from the first import to a usable window, for the window of lfcal and for an empty one.

    Modules are compiled before, as installers compile them.
    """
    with TemporaryDirectory() as folder:
        codes = {
            "empty": EMPTY_WINDOW,
            "window": OUR_WINDOW.format(folder=folder, words=[]),
            "demo": OUR_WINDOW.format(folder=folder, words=["--demo"]),
        }
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in codes}
        for _ in range(runs + 1):
            for name, code in codes.items():
                times[name].append(_timed(code, Path(folder) / "compiled"))
    found: dict[str, Any] = {"runs": runs}
    for name, both in times.items():
        found[f"{name}_s"], found[f"{name}_cpu_s"] = (statistics.median(t) for t in zip(*both[1:], strict=True))
    return {**found, "ratio": found["window_s"] / found["empty_s"]}


def _timed(code: str, compiled: Path) -> tuple[float, float]:
    """Return wall time and processor time (s); ``compiled`` is the folder of compiled modules."""
    place = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    place["PYTHONPYCACHEPREFIX"] = str(compiled)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=place)
    clock, processor = map(float, done.stdout.split()[:2])
    return clock, processor


def _app() -> Any:
    from PySide6.QtWidgets import QApplication

    return QApplication.instance() or QApplication(["lfcal"])


def scrubbing(scale: float = 1.0, pictures: int = 200) -> dict[str, Any]:
    """Return the rate of displayed HT slices while the user drags over the period map, for a plane in memory."""
    from lfcal.psf import PSFMatrix
    from lfcal_gui.base_page import page_class
    from lfcal_gui.context import Context
    from lfcal_gui.jobs import Jobs
    from lfcal_gui.models.page import PAGES
    from lfcal_gui.models.project import Project
    from lfcal_gui.theme import LIGHT, apply_theme

    app = _app()
    apply_theme(app, LIGHT)
    ny, nx, nt, _ = R29_PLANE
    side = int(nt * scale**0.5) | 1
    rng = np.random.default_rng(0)
    row = rng.random((nx, side, side), np.float32)
    matrix = PSFMatrix(np.broadcast_to(row, (1, ny, nx, side, side)).copy())
    context = Context(Project(), jobs := Jobs())
    context.matrices.put("plane", matrix)
    spec = PAGES.get("h")
    page: Any = page_class(spec)(spec, context)
    page.resize(1100, 760)
    page.show()
    context.project.update("open", psf="plane")
    while page.plane is None:
        app.processEvents()
    page.set_intent(transposed=True)
    for _ in range(20):
        app.processEvents()
    times = [_scrub(app, page, (k * 7) % ny, (k * 3) % nx) for k in range(pictures)]
    jobs.close()
    page.close()
    return {
        "plane": f"{ny} x {nx} x {side}²",
        "per_second": 1 / statistics.mean(clock for clock, _ in times),
        "longest_ms": 1e3 * max(clock for clock, _ in times),
        "busy_ms": 1e3 * statistics.median(busy for _, busy in times),
    }


def _scrub(app: Any, page: Any, y: int, x: int) -> tuple[float, float]:
    """Show another position; return the wall time until it is drawn, and the time of this thread (s)."""
    start, own = time.perf_counter(), time.thread_time()
    page.panel.map.chosen.emit(y, x)
    app.processEvents()
    page.panel.main_view.graphics.viewport().repaint()
    return time.perf_counter() - start, time.thread_time() - own


def live_frames(scale: float = 1.0, seconds: float = 4.0) -> dict[str, Any]:
    """Return the number of new frames drawn per second, and the time of the window's thread per frame."""
    from lfcal_gui.jobs import Jobs
    from lfcal_gui.models import Shot
    from lfcal_gui.theme import LIGHT, apply_theme
    from lfcal_gui.widgets import Picture

    app = _app()
    apply_theme(app, LIGHT)
    rows, columns = (int(n * scale**0.5) for n in R29_FRAME)
    rng = np.random.default_rng(0)
    frames = [rng.integers(0, 4096, (rows, columns), np.uint16) for _ in range(3)]
    view = Picture(jobs=(jobs := Jobs()))
    view.resize(1200, 800)
    view.show()
    drawn = [0]
    view.changed.connect(lambda: drawn.__setitem__(0, drawn[0] + 1))
    view.set_shot(Shot(frames[0], levels=(0, 4095)))
    while not drawn[0]:
        app.processEvents()
    busy: list[float] = []
    start, worked, shown, sent = time.perf_counter(), time.process_time(), drawn[0], 0
    while time.perf_counter() - start < seconds:
        before, at = time.thread_time(), drawn[0]
        if drawn[0] - shown >= sent:
            sent += 1
            view.set_shot(Shot(frames[sent % 3], levels=(0, 4095)))
        app.processEvents()
        if drawn[0] != at:
            view.graphics.viewport().repaint()
            busy.append(time.thread_time() - before)
        else:
            time.sleep(0.0005)
    total, worked, seen = time.perf_counter() - start, time.process_time() - worked, drawn[0] - shown
    jobs.close()
    view.close()
    return {
        "frame": f"{columns} x {rows} px",
        "per_second": seen / total,
        "busy_ms": 1e3 * statistics.median(busy) if busy else float("nan"),
        "all_ms": 1e3 * worked / seen if seen else float("nan"),
    }
