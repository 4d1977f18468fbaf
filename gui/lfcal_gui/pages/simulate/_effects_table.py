"""The table of effects, grouped by what they act on; each with setting, verdict, share of the image and time."""

from __future__ import annotations

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QColor, QFont, QKeyEvent, QWheelEvent
from PySide6.QtWidgets import QComboBox, QHeaderView, QTreeWidget, QTreeWidgetItem

from lfcal_gui.pages.simulate._share_bar import ON, SHARE, ShareBar
from lfcal_gui.pages.simulate.model import CHOICES
from lfcal_gui.pages.simulate.model_effects import FRAMES_ONLY, EffectRow, EffectsVerdict
from lfcal_gui.theme import current_theme

__all__ = ["EffectsTable"]

COLUMNS = ("Effect", "Setting", "Verdict", "Share", "Time")
EFFECT, SETTING, VERDICT, SHARES, SECONDS = range(5)
ROW = 24
"""Height of a row (px): room for the list of choices."""

NAME = Qt.ItemDataRole.UserRole


class SettingBox(QComboBox):
    """Auto, on or off; the wheel scrolls the table instead of changing it."""

    def __init__(self, name: str, title: str) -> None:
        super().__init__()
        self.name = name
        for choice in CHOICES:
            self.addItem(choice, choice)
        self.setAccessibleName(f"setting of {title}")
        self.setStyleSheet("QComboBox { min-height: 18px; max-height: 18px; padding: 0 4px; }")
        self.setFocusPolicy(Qt.FocusPolicy.ClickFocus)  # Tab leaves the table; Space changes the selected row

    def wheelEvent(self, event: QWheelEvent) -> None:
        """Leave the wheel to the table."""
        event.ignore()


class EffectsTable(QTreeWidget):
    """One row an effect.

    Signals
    -------
    chosen(name)
        An effect is selected.
    choice_asked(name, choice)
        ``"auto"``, ``"on"`` or ``"off"`` for an effect.
    edit_asked()
        The user wants to edit the magnitudes of the selected effect.
    """

    chosen = Signal(str)
    choice_asked = Signal(str, str)
    edit_asked = Signal()

    def __init__(self) -> None:
        super().__init__()
        self._items: dict[str, QTreeWidgetItem] = {}
        self._rows: dict[str, EffectRow] = {}
        self._bar = ShareBar(self)
        self.setColumnCount(len(COLUMNS))
        self.setHeaderLabels(COLUMNS)
        self.setItemDelegateForColumn(SHARES, self._bar)
        self.setRootIsDecorated(False)
        self.setIndentation(10)
        self.setUniformRowHeights(True)
        self.setAllColumnsShowFocus(True)
        self.setAccessibleName("effects")
        self.setToolTip("Space: auto, on, off. Enter: edit the magnitudes.")
        header = self.header()
        header.setStretchLastSection(False)
        for k in range(len(COLUMNS)):
            mode = QHeaderView.ResizeMode.Stretch if k == VERDICT else QHeaderView.ResizeMode.Interactive
            header.setSectionResizeMode(k, mode)
        for column, width in ((EFFECT, 166), (SETTING, 72), (SHARES, 118), (SECONDS, 60)):
            header.resizeSection(column, width)
        self.currentItemChanged.connect(lambda item, _: self._selected(item))
        self.itemActivated.connect(lambda *_: self.edit_asked.emit())

    # -- content ---------------------------------------------------------------------------------------
    def show_verdict(self, verdict: EffectsVerdict) -> None:
        """Show every row; selection, focus and scroll position stay."""
        if list(self._items) != [row.name for row in verdict.rows]:
            self._build(verdict)
        self._bar.tolerance = verdict.settings.tolerance
        for row in verdict.rows:
            self._rows[row.name] = row
            self._fill(self._items[row.name], row)
        self._fit_names()
        self.viewport().update()

    def _fit_names(self) -> None:
        """Make the first column as wide as its longest name; verdicts are short, and whole in their tips."""
        metrics, indent = self.fontMetrics(), 2 * self.indentation() + 12
        widest = max((metrics.horizontalAdvance(item.text(EFFECT)) for item in self._items.values()), default=0)
        self.header().resizeSection(EFFECT, max(166, widest + indent))

    def _build(self, verdict: EffectsVerdict) -> None:
        self.clear()
        self._items = {}
        groups: dict[str, QTreeWidgetItem] = {}
        bold = QFont()
        bold.setBold(True)
        for row in verdict.rows:
            if row.group not in groups:
                note = "" if row.enters_h else f": {FRAMES_ONLY}"
                item = QTreeWidgetItem([f"{row.group[:1].upper()}{row.group[1:]}{note}"])
                item.setFlags(Qt.ItemFlag.ItemIsEnabled)
                item.setFont(EFFECT, bold)
                item.setSizeHint(EFFECT, QSize(0, ROW))
                self.addTopLevelItem(item)
                item.setFirstColumnSpanned(True)
                item.setExpanded(True)
                groups[row.group] = item
            item = QTreeWidgetItem(groups[row.group])
            item.setData(EFFECT, NAME, row.name)
            item.setSizeHint(EFFECT, QSize(0, ROW))
            box = SettingBox(row.name, row.title)
            box.activated.connect(lambda _=0, box=box: self.choice_asked.emit(box.name, box.currentData()))
            self.setItemWidget(item, SETTING, box)
            self._items[row.name] = item

    def _fill(self, item: QTreeWidgetItem, row: EffectRow) -> None:
        theme = current_theme()
        texts = {
            EFFECT: f"{row.title}{' •' if row.given else ''}",
            VERDICT: row.brief_text(),
            SHARES: row.share_text(),
            SECONDS: row.seconds_text(),
        }
        tips = {EFFECT: f"{row.name}\n{row.size}", SHARES: f"{self._bar.tip()}\n{row.formula}"}
        colour = QColor(theme.text if row.on and row.enters_h else theme.muted)
        for column, text in texts.items():
            item.setText(column, text)
            item.setForeground(column, colour)
            item.setToolTip(column, tips.get(column, f"{row.title}: {row.verdict_text()}"))
        item.setTextAlignment(SECONDS, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        item.setData(SHARES, SHARE, row.share)
        item.setData(SHARES, ON, row.on)
        self.setting_box(row.name).setCurrentIndex(CHOICES.index(row.setting))

    def setting_box(self, name: str) -> QComboBox:
        """Return the list of choices of an effect."""
        box = self.itemWidget(self._items[name], SETTING)
        assert isinstance(box, QComboBox)
        return box

    # -- selection -------------------------------------------------------------------------------------
    @property
    def selected(self) -> str:
        """The name of the selected effect, or empty."""
        item = self.currentItem()
        return str(item.data(EFFECT, NAME) or "") if item is not None else ""

    def select(self, name: str) -> None:
        """Select an effect and scroll to it."""
        self.setCurrentItem(self._items[name])

    def _selected(self, item: QTreeWidgetItem | None) -> None:
        name = str(item.data(EFFECT, NAME) or "") if item is not None else ""
        if name:
            self.chosen.emit(name)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Change the setting of the selected effect with Space; the tree knows the other keys."""
        row = self._rows.get(self.selected)
        if event.key() == Qt.Key.Key_Space and row is not None:
            choice = CHOICES[(CHOICES.index(row.setting) + 1) % len(CHOICES)]
            self.choice_asked.emit(row.name, choice)
            return
        super().keyPressEvent(event)
