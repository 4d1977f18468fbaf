"""Layout of the window with the open sample: controls of each view, area of H and HT, response to the pointer."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks._window_holds import LongestTurn

__all__ = ["hovering", "layout", "new_stage"]

SIZES = ((1920, 1080), (1280, 800), (1000, 600))


def controls(root: Any) -> list[Any]:
    """Return the visible controls in a widget; the parts of a control are not counted."""
    from PySide6.QtWidgets import QAbstractButton, QAbstractItemView, QAbstractSlider, QComboBox, QLineEdit, QScrollBar

    from lfcal_gui.widgets import Contrast, PeriodMap

    kinds = (QAbstractButton, QComboBox, QLineEdit, QAbstractSlider, QAbstractItemView, Contrast, PeriodMap)
    seen = {one for kind in kinds for one in root.findChildren(kind) if one.isVisible() and _inside(one, root)}
    return [one for one in seen if not isinstance(one, QScrollBar) and not _parents(one, root) & seen]


def _parents(widget: Any, root: Any) -> set[Any]:
    found = set()
    while widget is not root and (widget := widget.parentWidget()) is not None:
        found.add(widget)
    return found - {root}


def _inside(widget: Any, root: Any) -> bool:
    """Return whether a part of a widget is visible without scrolling."""
    return widget.window() is root.window() and not widget.visibleRegion().isEmpty()


def new_stage(folder: Path) -> Any:
    """Return a stage with a window and a new project; files are written into ``folder``."""
    from PySide6.QtWidgets import QApplication

    from lfcal_gui.app import make_window, parse
    from lfcal_gui.scenes.stage import Stage

    app: Any = QApplication.instance() or QApplication(["lfcal"])
    window = make_window(app, parse([]), folder=folder)
    window.show()
    window.activateWindow()  # keys go to the active window
    stage = Stage(app, window, folder / "made")
    stage.turn()
    return stage


def _sample(folder: str) -> Any:
    """Return a stage with the judged sample session."""
    from lfcal_gui.scenes.sample import open_sample

    stage = new_stage(Path(folder))
    open_sample(stage)
    return stage


def layout() -> dict[str, Any]:
    """Return the numbers of controls and primary buttons, and the fraction of H and HT at three sizes."""
    with TemporaryDirectory() as folder:
        stage = _sample(folder)
        window = stage.window
        window.resize(*SIZES[0])
        views: dict[str, dict[str, Any]] = {}
        for spec in window.specs:
            if spec.place:
                page = stage.page(spec.key)
                least = page.minimumSizeHint()
                views[spec.key] = {
                    "place": spec.place,
                    "controls": len(controls(page)),
                    "primary": sum(b.property("role") == "primary" for b in controls(window)),
                    "least": [least.width() + window.rail.width(), least.height() + window.header.height()],
                }
        found = {"header": len(controls(window.header)), "rail": len(controls(window.rail)), "views": views}
        stage.page("h")
        shares = {}
        for size in SIZES:
            window.resize(*size)
            stage.turn()
            panel = window.page("h").panel
            pictures = [view.graphics for view in (panel.main_view, panel.linked_view)]
            got = window.width() * window.height()
            shares[f"{size[0]}x{size[1]}"] = {
                "window": [window.width(), window.height()],
                "share": sum(view.width() * view.height() for view in pictures) / got,
            }
        window.shut_down()
        window.close()
    return {**found, "shares": shares}


def hovering(count: int = 200) -> dict[str, float]:
    """Return the times (ms) from pointing at a pixel of H to its HT drawn, and from choosing a plane to H drawn."""
    with TemporaryDirectory() as folder:
        stage = _sample(folder)
        page = stage.page("h")
        stage.window.resize(*SIZES[0])
        page.set_intent(view="both")
        stage.settle()
        panel, app = page.panel, stage.app
        rows, columns = panel.main_view.values.shape
        held = LongestTurn(app, lambda: stage.window.jobs.busy)
        hover, planes = [], []
        for k in range(count):
            start = time.perf_counter()
            held.turn("hover", panel.main_view.hovered.emit, 7 * k % rows, 11 * k % columns, 1.0)
            held.turn("hover", app.processEvents)
            held.turn("hover", panel.linked_view.graphics.viewport().repaint)
            hover.append(time.perf_counter() - start)
        for k in range(count // 4):
            start = time.perf_counter()
            held.turn("plane", partial(page.set_intent, z=k % page.matrix.shape[0]))
            while stage.window.jobs.busy:
                held.turn("plane", app.processEvents)
                time.sleep(0.001)
            held.turn("plane", app.processEvents)
            held.turn("plane", panel.main_view.graphics.viewport().repaint)
            planes.append(time.perf_counter() - start)
        stage.window.shut_down()
        stage.window.close()
    found = {}
    for name, times in (("hover", hover), ("plane", planes)):
        for word, share in (("median", 50), ("95", 95), ("worst", 100)):
            found[f"{name}_{word}_ms"] = 1e3 * float(np.percentile(times, share))
        found[f"{name}_held_ms"], found[f"{name}_long"] = held.result()[name]
    return found
