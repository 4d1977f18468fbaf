"""Results as tiles with picture, name, verdict and date; only visible tiles are read and drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QAbstractListModel, QModelIndex, QPersistentModelIndex, QRect, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QColor, QFont, QFontMetrics, QImage, QPainter, QPen, QResizeEvent
from PySide6.QtWidgets import QListView, QStyle, QStyledItemDelegate, QStyleOptionViewItem, QWidget

from lfcal_gui.pages.sessions.model import Verdict, kind_word, picture_words, verdict_words
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import theme_table

if TYPE_CHECKING:
    from lfcal.judge import StoredResult

TILE = QSize(180, 208)
PICTURE = 128
CENTRED = Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap
MARKS = {"good": "✓", "fair": "▲", "bad": "✕", "unknown": "○"}
"""Sign for each merit, so that its meaning does not depend on colour alone."""

Index = QModelIndex | QPersistentModelIndex
ROOT = QModelIndex()


class TilesModel(QAbstractListModel):
    """Model of the displayed results, with their verdicts and the pictures read so far."""

    def __init__(self) -> None:
        super().__init__()
        self.results: list[StoredResult] = []
        self.verdicts: Mapping[Path, Verdict] = {}
        self.pictures: dict[Path, QImage | None] = {}

    def rowCount(self, parent: Index = ROOT) -> int:
        """Return the number of displayed results."""
        return 0 if parent.isValid() else len(self.results)

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        """Return the name of a result, or its description for tooltips and screen readers."""
        if not 0 <= index.row() < len(self.results):
            return None
        result = self.results[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return result.name
        if role == Qt.ItemDataRole.AccessibleTextRole:
            return ", ".join(filter(None, (result.name, *self.words(index.row()))))
        if role == Qt.ItemDataRole.ToolTipRole:
            return "\n".join(filter(None, (str(result.path), *self.words(index.row()))))
        return None

    def words(self, row: int) -> tuple[str, str]:
        """Return two lines of text: date and kind, and the verdict."""
        result = self.results[row]
        dated = f"{result.when.astimezone():%Y-%m-%d}, {kind_word(result)}"
        return dated, verdict_words(result, self.verdicts)[1]


class TileDelegate(QStyledItemDelegate):
    """Delegate that draws a tile."""

    def __init__(self, model: TilesModel, parent: QWidget) -> None:
        super().__init__(parent)
        self._model = model

    def sizeHint(self, option: QStyleOptionViewItem, index: Index) -> QSize:
        """Return the size of every tile."""
        return TILE

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: Index) -> None:
        """Draw picture and texts of a tile."""
        state = option.state  # type: ignore[attr-defined]  # a field of Qt's that the stubs lack
        area: QRect = option.rect.adjusted(4, 4, -4, -4)  # type: ignore[attr-defined]
        theme, result = current_theme(), self._model.results[index.row()]
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        chosen = bool(state & QStyle.StateFlag.State_Selected)
        focused = bool(state & QStyle.StateFlag.State_HasFocus)
        painter.setBrush(QColor(theme.raised if chosen else theme.panel))
        painter.setPen(QPen(QColor(theme.accent if chosen or focused else theme.line), 2 if chosen or focused else 1))
        painter.drawRoundedRect(area, 6, 6)
        self._picture(
            painter, result, QRect(area.left() + (area.width() - PICTURE) // 2, area.top() + 6, PICTURE, PICTURE)
        )
        self._words(painter, index.row(), area.adjusted(8, PICTURE + 10, -8, -4), option.font)  # type: ignore[attr-defined]
        painter.restore()

    def _picture(self, painter: QPainter, result: StoredResult, area: QRect) -> None:
        theme, picture = current_theme(), self._model.pictures.get(result.path)
        painter.fillRect(area, QColor(theme.canvas))
        if picture is not None:
            side = max(picture.width(), picture.height())
            width, height = (max(1, PICTURE * n // side) for n in (picture.width(), picture.height()))
            place = QRect(0, 0, width, height)
            place.moveCenter(area.center())
            painter.drawImage(place, picture)
        else:
            painter.setPen(QColor(theme.canvas_text))
            painter.drawText(area.adjusted(6, 6, -6, -6), CENTRED, picture_words(result))

    def _words(self, painter: QPainter, row: int, area: QRect, font: QFont) -> None:
        theme, result = current_theme(), self._model.results[row]
        dated, words = self._model.words(row)
        merit = verdict_words(result, self._model.verdicts)[0]
        colours = {"good": theme.good, "fair": theme.fair, "bad": theme.bad}
        bold = QFont(font)
        bold.setWeight(QFont.Weight.DemiBold)
        second = f"{MARKS[merit]} {words}" if words else ""
        if merit != "unknown" and QFontMetrics(font).horizontalAdvance(second) > area.width():
            second = f"{MARKS[merit]} {merit}"  # the tip has the sentence
        lines = (
            (result.name, theme.text, bold, Qt.TextElideMode.ElideMiddle),
            (second, colours.get(merit, theme.muted), font, Qt.TextElideMode.ElideRight),
            (dated, theme.muted, font, Qt.TextElideMode.ElideRight),
        )
        height = area.height() // len(lines)
        for k, (text, colour, used, cut) in enumerate(lines):
            painter.setFont(used)
            painter.setPen(QColor(colour))
            line = QRect(area.left(), area.top() + k * height, area.width(), height)
            painter.drawText(
                line, Qt.AlignmentFlag.AlignVCenter, painter.fontMetrics().elidedText(text, cut, line.width())
            )


class ResultTiles(QListView):
    """List view of the gallery."""

    seen = Signal(object, arguments=["results"])
    """Visible results that have no picture yet."""
    chosen = Signal()
    """The selection changed."""
    opened = Signal()
    """Request to open the selected result."""

    def __init__(self) -> None:
        super().__init__()
        self._model = TilesModel()
        self.setModel(self._model)
        self.setItemDelegate(TileDelegate(self._model, self))
        self.setViewMode(QListView.ViewMode.IconMode)
        self.setMovement(QListView.Movement.Static)
        self.setResizeMode(QListView.ResizeMode.Adjust)
        self.setUniformItemSizes(True)
        self.setSelectionMode(QListView.SelectionMode.ExtendedSelection)
        self.setVerticalScrollMode(QListView.ScrollMode.ScrollPerPixel)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setAccessibleName("Results")
        self.setToolTip("Ctrl+click to select a second result to compare; double-click to open")
        self._timer = QTimer(self, singleShot=True, interval=30)
        self._timer.timeout.connect(self._tell_seen)
        self.selectionModel().selectionChanged.connect(lambda *_: self.chosen.emit())
        self.activated.connect(lambda _: self.opened.emit())
        self.verticalScrollBar().valueChanged.connect(lambda _: self._timer.start())

    def show_results(self, results: Sequence[StoredResult], verdicts: Mapping[Path, Verdict]) -> None:
        """Show results in their order; selected results stay selected."""
        before = {one.path for one in self.selected()}
        model, top = self._model, self.verticalScrollBar().value()
        blocked = self.blockSignals(True)
        model.beginResetModel()
        model.results, model.verdicts = list(results), verdicts
        model.endResetModel()
        chosen = self.selectionModel()
        for row, one in enumerate(model.results):
            if one.path in before:
                chosen.select(model.index(row), chosen.SelectionFlag.Select)
        self.blockSignals(blocked)
        self.verticalScrollBar().setValue(top)
        if {one.path for one in self.selected()} != before:
            self.chosen.emit()
        self._timer.start()

    def selected(self) -> list[StoredResult]:
        """Return the selected results in the order of the tiles."""
        rows = sorted(index.row() for index in self.selectedIndexes())
        return [self._model.results[row] for row in rows if row < len(self._model.results)]

    def show_picture(self, path: Path, picture: NDArray[np.uint8] | None) -> None:
        """Show the picture of a result; None if it has none."""
        self._model.pictures[path] = None if picture is None else _image(picture)
        self.viewport().update()

    def forget_pictures(self) -> None:
        """Discard all pictures, so that they are read again after a change of colours or files."""
        self._model.pictures.clear()
        self._timer.start()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Request the pictures that become visible."""
        super().resizeEvent(event)
        self._timer.start()

    def _tell_seen(self) -> None:
        area, model = self.viewport().rect(), self._model
        rows = [row for row in range(len(model.results)) if area.intersects(self.visualRect(model.index(row)))]
        wanted = [model.results[row] for row in rows if model.results[row].path not in model.pictures]
        if wanted:
            self.seen.emit(wanted)


def _image(values: NDArray[np.uint8]) -> QImage:
    """Return an image of values (0 to 255) in the colours of pictures."""
    colours = np.ascontiguousarray(theme_table("magma")[values])
    rows, columns = values.shape
    return QImage(colours.data, columns, rows, 4 * columns, QImage.Format.Format_RGBA8888).copy()
