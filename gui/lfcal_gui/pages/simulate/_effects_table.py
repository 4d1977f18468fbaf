"""Table of the effects in groups, with their settings, reasons, and errors of the image."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QRect, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QFont, QKeyEvent, QPainter, QResizeEvent
from PySide6.QtWidgets import (
    QHeaderView,
    QStyle,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTreeWidget,
    QTreeWidgetItem,
)

from lfcal_gui.pages.simulate.model import CHOICES
from lfcal_gui.pages.simulate.model_effects import GROUPS, LEAST, EffectRow, EffectsVerdict, bar_share, group_title
from lfcal_gui.theme import current_theme

SHARE = Qt.ItemDataRole.UserRole + 1
"""Item role of the error of a cell, a float; a cell without one is drawn as text."""

ON = Qt.ItemDataRole.UserRole + 2
"""Item role that states whether the effect is on."""

TEXT, BAR, HIGH = 74, 28, 7
"""Widths of number and bar, and height of the bar (px)."""


class ShareBar(QStyledItemDelegate):
    """Delegate that draws the error as a bar and a number; a line marks ``tolerance``."""

    tolerance = 0.05
    width = TEXT + BAR

    def tip(self) -> str:
        """Return the tooltip that explains the bar."""
        return (
            f"Error of the image without the effect.\nBar: logarithmic, {100 * LEAST:g} % to 100 %, "
            f"coloured if the effect is on. Line: the tolerance, {100 * self.tolerance:.2g} %."
        )

    def sizeHint(self, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex) -> QSize:
        """Return a size for bar and number."""
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
        area = QRectF(style.rect).adjusted(2, 0, -TEXT - 2, 0)
        area.adjust(0, (area.height() - HIGH) / 2, 0, (HIGH - area.height()) / 2)
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


EFFECT, SHARES, SETTING = range(3)
SETTING_PX = 38
ROW = 21
"""Height of a row with one line (px)."""

NAME = Qt.ItemDataRole.UserRole


GROUP_TIPS = {"unknown": "The camera has no values for these effects. Select one to enter its values"}


class EffectsTable(QTreeWidget):
    """Table of effects, largest first. A click on a setting, or Space, changes it from auto to on to off."""

    chosen = Signal(str, arguments=["name"])
    """An effect was selected."""
    choice_asked = Signal(str, str, arguments=["name", "choice"])
    """Requested setting of an effect: ``"auto"``, ``"on"`` or ``"off"``."""
    edit_asked = Signal()
    """Request to edit the magnitudes of the selected effect."""

    def __init__(self) -> None:
        super().__init__()
        self._items: dict[str, QTreeWidgetItem] = {}
        self._rows: dict[str, EffectRow] = {}
        self._bar = ShareBar(self)
        self.setColumnCount(3)
        self.setHeaderHidden(True)
        self.setItemDelegateForColumn(SHARES, self._bar)
        self.setIndentation(9)
        self.setWordWrap(True)
        self.setAllColumnsShowFocus(True)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        for changed in (self.expanded, self.collapsed):
            changed.connect(lambda _: self._fit_height())
        self.setAccessibleName("Effects")
        self.setToolTip(
            "Click the setting or press Space to choose auto, on or off. Press Enter to edit the magnitudes"
        )
        header = self.header()
        header.setStretchLastSection(False)
        header.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        header.setSectionResizeMode(EFFECT, QHeaderView.ResizeMode.Stretch)
        header.resizeSection(SHARES, self._bar.width)
        header.resizeSection(SETTING, SETTING_PX)
        self.groups: dict[str, QTreeWidgetItem] = {group: QTreeWidgetItem(self) for group in GROUPS}
        bold = QFont()
        bold.setBold(True)
        for group, item in self.groups.items():
            item.setFlags(Qt.ItemFlag.ItemIsEnabled)
            item.setFont(EFFECT, bold)
            item.setSizeHint(EFFECT, QSize(0, ROW))
            item.setFirstColumnSpanned(True)
            item.setExpanded(group == "on")
            item.setHidden(True)
        self.currentItemChanged.connect(lambda item, _: self._selected(item))
        self.itemActivated.connect(lambda *_: self.edit_asked.emit())
        self.itemClicked.connect(self._clicked)

    # -- content ---------------------------------------------------------------------------------------
    def show_verdict(self, verdict: EffectsVerdict) -> None:
        """Show every row; selection, open groups and scroll position stay."""
        self._bar.tolerance = verdict.settings.tolerance
        before = {group: self._names(item) for group, item in self.groups.items()}
        rows = sorted(verdict.rows, key=lambda row: -row.share)
        found = {group: [row for row in rows if row.group == group] for group in GROUPS}
        self._rows = {row.name: row for row in rows}
        if before != {group: [row.name for row in found[group]] for group in GROUPS}:
            self._build(found)
        for group, item in self.groups.items():
            item.setText(EFFECT, group_title(group, found[group], verdict.settings.tolerance))
            item.setToolTip(EFFECT, GROUP_TIPS.get(group, ""))
        for row in rows:
            self._fill(self._items[row.name], row)
        self._fit_height()
        self.viewport().update()

    def _fit_height(self) -> None:
        """Set the height to that of the visible rows; long names are wrapped."""
        room = QRect(0, 0, self.columnWidth(EFFECT) - 2 * self.indentation() - 8, 999)
        shown = [item for item in self.groups.values() if not item.isHidden()]
        high = len(shown) * ROW
        for item in (group.child(k) for group in shown for k in range(group.childCount())):
            words = self.fontMetrics().boundingRect(room, Qt.TextFlag.TextWordWrap, item.text(EFFECT))
            hint = QSize(0, max(ROW, words.height() + 4))
            item.setSizeHint(EFFECT, hint)
            high += hint.height() * item.parent().isExpanded()
        self.setFixedHeight(high + 2 * self.frameWidth())

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Wrap the names for the new width."""
        super().resizeEvent(event)
        self._fit_height()

    @staticmethod
    def _names(group: QTreeWidgetItem) -> list[str]:
        return [str(group.child(k).data(EFFECT, NAME)) for k in range(group.childCount())]

    def _build(self, found: dict[str, list[EffectRow]]) -> None:
        selected, place = self.selected, self.verticalScrollBar().value()
        blocked = self.blockSignals(True)
        self._items = {}
        for group, parent in self.groups.items():
            parent.takeChildren()
            parent.setHidden(not found[group])
            for row in found[group]:
                item = QTreeWidgetItem(parent)
                item.setData(EFFECT, NAME, row.name)
                item.setTextAlignment(SETTING, Qt.AlignmentFlag.AlignCenter)
                self._items[row.name] = item
        if selected in self._items:
            self.select(selected)
        self.blockSignals(blocked)
        self.verticalScrollBar().setValue(place)

    def _fill(self, item: QTreeWidgetItem, row: EffectRow) -> None:
        theme = current_theme()
        cost = f"{row.title}: {row.verdict_text()}\nProcessor time of H: {row.seconds_text()}"
        tips = (
            f"{cost}\n{row.name}, {row.size}",
            f"{self._bar.tip()}\n{row.formula}",
            "Click or press Space to choose auto, on or off",
        )
        texts = (f"{row.title}{' •' if row.given else ''}", row.share_text(), row.setting)
        for column, (text, tip) in enumerate(zip(texts, tips, strict=True)):
            strong = row.setting != "auto" if column == SETTING else row.on
            item.setText(column, text)
            item.setToolTip(column, tip)
            item.setForeground(column, QColor(theme.text if strong else theme.muted))
        item.setData(SHARES, SHARE, row.share)
        item.setData(SHARES, ON, row.on)

    # -- selection -------------------------------------------------------------------------------------
    @property
    def selected(self) -> str:
        """Name of the selected effect; empty if there is none."""
        item = self.currentItem()
        return str(item.data(EFFECT, NAME) or "") if item is not None else ""

    def select(self, name: str) -> None:
        """Select an effect, open its group and scroll to it."""
        item = self._items[name]
        item.parent().setExpanded(True)
        self.setCurrentItem(item)

    def _selected(self, item: QTreeWidgetItem | None) -> None:
        name = str(item.data(EFFECT, NAME) or "") if item is not None else ""
        if name:
            self.chosen.emit(name)

    def _clicked(self, item: QTreeWidgetItem, column: int) -> None:
        name = str(item.data(EFFECT, NAME) or "")
        if not name:
            item.setExpanded(not item.isExpanded())
        elif column == SETTING:
            self.ask_next(name)
        else:  # also for the selected row: another tab may be open
            self.chosen.emit(name)

    def ask_next(self, name: str) -> None:
        """Request the next setting of an effect: auto, on, off."""
        row = self._rows[name]
        self.choice_asked.emit(name, CHOICES[(CHOICES.index(row.setting) + 1) % len(CHOICES)])

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Change the setting of the selected effect with Space; other keys are handled by the tree."""
        if event.key() == Qt.Key.Key_Space and self.selected in self._rows:
            self.ask_next(self.selected)
            return
        super().keyPressEvent(event)
