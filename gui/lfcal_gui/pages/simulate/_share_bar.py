"""A cell that shows a share of the image as a bar: logarithmic, with the tolerance as a line."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QPainter
from PySide6.QtWidgets import QStyle, QStyledItemDelegate, QStyleOptionViewItem

from lfcal_gui.pages.simulate.model_effects import LEAST, bar_share
from lfcal_gui.theme import current_theme

__all__ = ["ON", "SHARE", "ShareBar"]

SHARE = Qt.ItemDataRole.UserRole + 1
"""Role of a cell's share, a float; a cell without one is drawn as text."""

ON = Qt.ItemDataRole.UserRole + 2
"""Role of whether the effect is on."""

TEXT, BAR = 70, 30
"""Room for the number and for the bar (px)."""


class ShareBar(QStyledItemDelegate):
    """Draws the bar left of the number; ``tolerance`` is where the line stands."""

    tolerance = 0.05
    width = TEXT + BAR

    def tip(self) -> str:
        """Return what the bar means."""
        return (
            f"Share of the image that is wrong without the effect.\nBar: logarithmic, {100 * LEAST:g} % to 100 %, "
            f"coloured where the effect is on. Line: the tolerance, {100 * self.tolerance:.2g} %."
        )

    def sizeHint(self, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex) -> QSize:
        """Return room for bar and number."""
        return QSize(self.width, super().sizeHint(option, index).height())

    def paint(
        self, painter: QPainter, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex
    ) -> None:
        """Draw background, bar, line and number."""
        share: float | None = index.data(SHARE)
        if share is None:
            super().paint(painter, option, index)
            return
        style: Any = option  # the stubs of the style option lack its fields
        theme = current_theme()
        selected = bool(style.state & QStyle.StateFlag.State_Selected)
        painter.save()
        if selected:
            painter.fillRect(style.rect, QColor(theme.accent))
        area = QRectF(style.rect).adjusted(2, 7, -TEXT - 2, -7)
        painter.fillRect(area, QColor(theme.line if selected else theme.raised))
        shown = index.data(Qt.ItemDataRole.ForegroundRole)
        colour = shown.color() if shown is not None else QColor(theme.text)
        bar = QRectF(area)
        bar.setWidth(area.width() * bar_share(share))
        on = theme.accent_text if selected else theme.accent
        painter.fillRect(bar, QColor(on if index.data(ON) else theme.muted))
        x = area.left() + area.width() * bar_share(self.tolerance)
        painter.setPen(QColor(theme.bad))
        painter.drawLine(int(x), style.rect.top() + 3, int(x), style.rect.bottom() - 3)
        painter.setPen(QColor(theme.accent_text) if selected else colour)
        right = QRectF(style.rect).adjusted(style.rect.width() - TEXT, 0, -4, 0)
        painter.drawText(right, Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignRight, str(index.data()))
        painter.restore()
