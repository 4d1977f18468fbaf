"""Context menu of a picture or plot: copy and save as an image, as a drawing, or as values."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, QRect, QSize, Qt
from PySide6.QtGui import QAction, QPainter
from PySide6.QtWidgets import QApplication, QMenu, QWidget

from lfcal.base import Clock, Work, drain, npy_header, replace_whole
from lfcal_gui.jobs import Jobs
from lfcal_gui.saving import ask_target, write_file, write_picture
from lfcal_gui.widgets.enlarging import can_be_enlarged, enlarge, enlarged_of

ROWS = 64
"""Number of rows of a picture that are written in one step."""

PICTURES = "PNG (*.png);;SVG, scalable (*.svg)"

Entry = tuple[str, Callable[[], Any]]


def offer_menu(
    widget: QWidget,
    name: Callable[[], str],
    entries: Callable[[], Sequence[Entry]] = lambda: (),
    at: Callable[[QPoint], Sequence[Entry]] = lambda _: (),
) -> None:
    """Give ``widget`` a context menu: ``entries``, then enlarge, copy, and save under ``name()``.

    ``at`` returns more entries for a point of the widget.
    """

    def show(position: QPoint) -> None:
        menu = QMenu(widget)
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        own = (
            ("Enlarge" if enlarged_of(widget) is None else "Restore (Esc)", lambda: enlarge(widget)),
            ("Copy image", lambda: copy_picture(widget)),
            ("Save image …", lambda: save_picture(widget, name())),
        )
        for text, action in (*at(position), *entries(), *own):
            entry = QAction(text, menu)
            entry.triggered.connect(lambda _=False, action=action: action())
            menu.addAction(entry)
        menu.popup(widget.mapToGlobal(position))

    can_be_enlarged(widget)
    widget.setContextMenuPolicy(Qt.ContextMenuPolicy.CustomContextMenu)
    widget.customContextMenuRequested.connect(show)


def copy_picture(widget: QWidget) -> None:
    """Copy an image of a widget to the clipboard."""
    QApplication.clipboard().setPixmap(widget.grab())


def save_picture(widget: QWidget, name: str, path: str = "") -> None:
    """Save an image of a widget as PNG or SVG, according to the suffix; without a path, ask for one."""
    path = path or ask_target(widget, "Save image", f"{name}.png", PICTURES)
    if path.lower().endswith(".svg"):
        write_svg(widget, path)
    elif path:
        write_picture(widget, path)


def table_entries(widget: QWidget, name: str, lines: Callable[[str], Iterable[str]]) -> list[Entry]:
    """Return entries that copy and save a table; ``lines(between)`` yields its lines with ``between`` as separator."""

    def save() -> None:
        path = ask_target(widget, "Save data", f"{name}.csv", "Text (*.csv)")
        if path:
            write_file(widget, path, lambda part: part.write_text("".join(lines(",")), encoding="utf-8"))

    return [
        ("Copy values", lambda: QApplication.clipboard().setText("".join(lines("\t")))),
        ("Save data …", save),
    ]


def save_values(widget: QWidget, values: NDArray[Any], name: str, path: str = "", jobs: Jobs | None = None) -> None:
    """Save the values of a picture as ``.npy``, or as text (``.csv``); without a path, ask for one.

    ``jobs`` runs it in the background, because the text of a whole sensor takes half a minute to write.
    """
    path = path or ask_target(widget, "Save data", f"{name}.npy", "numpy (*.npy);;text (*.csv)")
    text = path.endswith(".csv")

    def work() -> Work[None]:
        with replace_whole(path) as part:
            yield from _iter_values(part, values, text=text)

    if path and jobs is not None:
        jobs.start(f"Save {Path(path).name}", "", work, at_once=True)
    elif path:
        write_file(widget, path, lambda part: drain(_iter_values(part, values, text=text)))


def _iter_values(part: Path, image: NDArray[Any], *, text: bool) -> Work[None]:
    clock = Clock("saving the values", len(image))
    with part.open("wb") as file:
        if not text:
            file.write(npy_header(image.shape, image.dtype))
        for row in range(0, len(image), ROWS):
            yield clock.at(row)
            rows = image[row : row + ROWS]
            if text:
                np.savetxt(file, rows, delimiter=",", fmt="%.7g")
            else:
                file.write(np.ascontiguousarray(rows).data)
    yield clock.at(len(image))


def write_svg(widget: QWidget, path: str) -> bool:
    """Save a widget as SVG; report a failure."""
    from PySide6.QtSvg import QSvgGenerator

    def write(part: Path) -> None:
        drawing = QSvgGenerator()
        drawing.setFileName(str(part))
        drawing.setSize(QSize(widget.width(), widget.height()))
        drawing.setViewBox(QRect(0, 0, widget.width(), widget.height()))
        drawing.setTitle(Path(path).stem)
        painter = QPainter(drawing)
        widget.render(painter, QPoint(0, 0))
        painter.end()

    return write_file(widget, path, write)
