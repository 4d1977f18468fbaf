"""The form of the window: fields in view, the others folded, with units, ranges and validation as you type."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from PySide6.QtCore import QEvent, QSignalBlocker, Qt, Signal, SignalInstance
from PySide6.QtGui import QEnterEvent, QFocusEvent, QHelpEvent, QWheelEvent
from PySide6.QtWidgets import (
    QApplication,
    QCheckBox,
    QComboBox,
    QFileDialog,
    QFrame,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QStyle,
    QToolButton,
    QToolTip,
    QVBoxLayout,
    QWidget,
)

from lfcal.base import InputError
from lfcal_gui.models import UNKNOWN, Field, means, parse, rounded, same, text_of
from lfcal_gui.widgets.cards import card, column_of, heading, line
from lfcal_gui.widgets.words import set_look

CLOSED, OPENED = "▸", "▾"


class FoldHead(QPushButton):
    """A title on the left, and a short summary of the folded content on the right.

    Parameters
    ----------
    title
        Name of the folded content.
    tip
        Description of the folded content.

    Attributes
    ----------
    words
        The summary.
    """

    def __init__(self, title: str, tip: str, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setToolTip(tip)
        self.setProperty("role", "fold")
        self.setCheckable(True)
        self.words = ""
        self._right = QLabel()
        self._right.setProperty("role", "hint")
        self._right.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 2, 0)
        row.addWidget(self._right, 0, Qt.AlignmentFlag.AlignRight)
        self.toggled.connect(lambda _: self.say(self.words))
        self.name(title)

    def name(self, title: str) -> None:
        """Set the title."""
        self.setText(title)
        self.say(self.words)

    def say(self, words: str) -> None:
        """Set the summary of the folded content."""
        self.words = words
        self._right.setText(f"{words} {OPENED if self.isChecked() else CLOSED}")
        self.setAccessibleName(f"{self.text()}: {words}" if words else self.text())


class Folded(QFrame):
    """A card that shows only its title until it is opened.

    Parameters
    ----------
    title
        Title, which is always visible.
    tip
        Tooltip that states when to open it.
    framed
        Whether it is drawn as a card. False inside another card.
    """

    def __init__(self, title: str, tip: str, *, framed: bool = True) -> None:
        super().__init__()
        self.head = FoldHead(title, tip)
        self.body = QWidget()
        self.column = column_of(of=self.body)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        inner = outer
        if framed:
            frame, inner = card()
            outer.addWidget(frame)
        inner.addWidget(self.head)
        inner.addWidget(self.body)
        self.head.toggled.connect(self.body.setVisible)
        self.body.hide()

    def open(self) -> None:
        """Show the content below the title."""
        self.head.setChecked(True)


SHORTEST = 5
"""Number of letters of a choice that are always visible."""

LEAST = 52
"""Smallest width of a field (px)."""

LONGEST = 16
"""Number of letters of the longest label or unit that is not wrapped."""

LONG_EMPTY = 20
"""Number of letters of the placeholder above which a field gets its own line below the label."""

SEARCHED = 12
"""Number of folded fields from which a search line is shown."""

SMALL = 18
"""Side of the buttons next to a field (px)."""

UNIT_PX = 26
"""Width reserved for a short unit (px), so that the fields of all forms are aligned."""

MARKS = {"stated": "✓", "measured": "✓", "assumed": "✓", "derived": "="}
"""Displayed mark for each source of a value."""

LABEL, EDITOR, UNIT, MARK, RESET = range(5)
"""Columns of the grid."""

LINES = 3
"""Number of grid rows of each field: label and editor, a long editor, and the reason of a refusal."""


class _ChoiceBox(QComboBox):
    """A combo box that ignores the mouse wheel without the focus, and whose list is as wide as its texts."""

    def __init__(self) -> None:
        super().__init__()
        self.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.setMinimumContentsLength(SHORTEST)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)

    def wheelEvent(self, event: QWheelEvent) -> None:
        """Ignore the wheel, so that it scrolls the column, unless the box has the focus."""
        if self.hasFocus():
            super().wheelEvent(event)
        else:
            event.ignore()

    def showPopup(self) -> None:
        """Show the list wide enough for its texts."""
        self.view().setMinimumWidth(self.view().sizeHintForColumn(0) + 2 * SMALL)
        super().showPopup()


class _NumberEdit(QLineEdit):
    """Line edit that shows a long number rounded unless it has the focus; `text`, copied text and tooltip are exact."""

    def __init__(self) -> None:
        super().__init__()
        self._exact = ""
        self.textChanged.connect(lambda _: self._forget())

    def _forget(self) -> None:
        self._exact = ""

    def setText(self, text: str) -> None:
        """Set the text, even while signals are blocked."""
        self._forget()
        super().setText(text)
        if not self.hasFocus():
            self._round()

    def text(self) -> str:
        """Return the exact text."""
        return self._exact or super().text()

    def _round(self) -> None:
        exact = super().text()
        shown = rounded(exact)
        if shown != exact and not self.property("reason"):
            super().setText(shown)
            self.setCursorPosition(0)
            self._exact = exact

    def focusInEvent(self, event: QFocusEvent) -> None:
        """Show all digits."""
        if self._exact:
            super().setText(self._exact)
        super().focusInEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        """Show the number rounded again, unless the focus is only in a menu or another window."""
        super().focusOutEvent(event)
        if event.reason() not in (Qt.FocusReason.PopupFocusReason, Qt.FocusReason.ActiveWindowFocusReason):
            self._round()

    def event(self, event: QEvent) -> bool:
        """Show the exact number in the tooltip."""
        if event.type() == QEvent.Type.ToolTip and self._exact and isinstance(event, QHelpEvent):
            QToolTip.showText(event.globalPos(), f"{self._exact}: {self.toolTip()}", self)
            return True
        return super().event(event)


@dataclass(eq=False)
class _Parts:
    """The widgets of a field."""

    label: QLabel
    editor: QWidget
    unit: QLabel | None
    mark: QToolButton | QLabel | None = None
    reset: QToolButton | None = None

    def widgets(self) -> list[QWidget]:
        return [one for one in (self.label, self.editor, self.unit, self.mark) if one is not None]

    def last(self) -> QWidget:
        """Return the widget that has the focus last."""
        return self.reset or self.mark or self.editor


@dataclass(eq=False)
class _Row:
    """A field, and its widgets (None: they were not needed yet)."""

    field: Field
    line: int
    rare: bool
    choices: tuple[tuple[Any, str], ...]
    shown: bool = True
    own_line: bool = False
    enabled: bool = True
    why: str = ""
    source: tuple[str, str] | None = None
    parts: _Parts | None = None

    def found(self, words: Sequence[str]) -> bool:
        """Return whether each of the words occurs in the texts of the field."""
        said = f"{self.field.label} {self.field.unit} {self.field.group} {self.field.tip}".casefold()
        return all(word in said for word in words)


class FoldedForm(QFrame):
    """Form with labels, fields and units in columns; rarely needed fields are folded.

    The row of the fold says what differs from the defaults. A changed value is bold and can be reset; buttons for that
    are shown while the pointer or the focus is in the form. The tick of an assumed value (`set_marks`) confirms it.

    A value that does not parse, or that ``check`` refuses, is marked red with the reason under the field; only
    values that pass are reported. If a first part of the text did pass, as the 2 of "2,8", the value before typing is
    reported again. The refused text stays until the value changes. Of several reasons, the one of the field edited last
    is shown. A disabled field shows its value again, and no reason.

    The widgets of a folded field are made when they are first needed, because most are never seen.

    Parameters
    ----------
    fields
        Fields that are always in view.
    more
        Fields that are folded.
    title, tip
        Title and tooltip of the folded part.
    framed
        Whether the form is a card.
    """

    edited = Signal(str, object, arguments=["key", "value"])
    """The user changed a value, which is valid."""
    confirmed = Signal(str, arguments=["key"])
    """The user confirms an assumed value."""

    def __init__(
        self,
        fields: Sequence[Field] = (),
        more: Sequence[Field] = (),
        title: str = "More settings",
        tip: str = "Values that are rarely changed",
        *,
        framed: bool = False,
        parent: QWidget | None = None,
    ) -> None:
        super().__init__(parent)
        self.setProperty("role", "card" if framed else "")
        self.setProperty("dense", True)
        groups = list(dict.fromkeys(("", *(f.group for f in more))))
        more = sorted(more, key=lambda f: groups.index(f.group))
        self.fields = {f.key: f for f in (*fields, *more)}
        self.check: Callable[[str, Any], str] = lambda key, value: ""
        self._rows: dict[str, _Row] = {}
        self._defaults = {f.key: f.default for f in self.fields.values() if f.default is not UNKNOWN}
        # the value of each field, and its value before the user typed
        self._values: dict[str, Any] = {}
        self._untouched: dict[str, Any] = {}
        self._selected: dict[str, str] = {}
        self._reported = self._last = ""
        self._headings: dict[str, tuple[int, QLabel | None]] = {}
        self._folds, self._attended = bool(more), False
        self._extras: list[QWidget] = []
        self.head = FoldHead(title, tip)
        self.reset_all = _small("↺", "reset", f"Reset {title.lower()}", "Restore the defaults of these values")
        self.search: QLineEdit | None = None
        self._error = QLabel("", wordWrap=True)
        self._error.setProperty("role", "error")
        self._build(fields, more)
        app = QApplication.instance()
        if isinstance(app, QApplication):
            app.focusChanged.connect(self._focus_moved)

    # -- building --------------------------------------------------------------------------------------
    def _build(self, fields: Sequence[Field], more: Sequence[Field]) -> None:
        self._grid = QGridLayout(self)
        self._grid.setContentsMargins(*((10, 4, 10, 4) if self.property("role") else (0, 0, 0, 0)))
        self._grid.setHorizontalSpacing(5)
        self._grid.setVerticalSpacing(3)
        self._grid.setColumnStretch(EDITOR, 1)
        if self._defaults:
            self._grid.setColumnMinimumWidth(RESET, SMALL)
        if any(field.unit for field in self.fields.values()):
            self._grid.setColumnMinimumWidth(UNIT, UNIT_PX)
        self._next = 0
        for field in fields:
            self._add(field, rare=False)
        self.head.setProperty("ruled", bool(fields))
        self._at_head = self._next
        self._above = self._next + 1
        if more:
            self._grid.addWidget(self.reset_all, self._next, RESET)
        if len(more) >= SEARCHED:
            self.search = QLineEdit(placeholderText="Search values")
            self.search.setAccessibleName("Search values")
            self.search.setToolTip("Show only the values whose name or description contains these words")
            self.search.textChanged.connect(lambda _: self._show_rows())
            self._grid.addWidget(self.search, self._above + LINES, LABEL, 1, RESET + 1)
        self._next += 2 * LINES
        for field in more:
            self._add(field, rare=True)
        self._grid.addWidget(self._error, self._next, LABEL, 1, RESET + 1)
        self._next += 1
        self.head.toggled.connect(lambda _: self._show_rows())
        self.reset_all.clicked.connect(self._reset_folded)
        self._show_error()
        self._show_rows()
        self._report()

    def _add(self, field: Field, *, rare: bool) -> None:
        if rare and field.group and field.group not in self._headings:
            self._headings[field.group] = self._next, None
            self._next += 1
        self._rows[field.key] = row = _Row(field, self._next, rare, field.choices)
        row.own_line = len(field.empty) > LONG_EMPTY
        self._next += LINES
        if not rare:
            self._made(row)

    def _made(self, row: _Row) -> _Parts:
        """Return the widgets of a field, which are made at the first call."""
        if row.parts is not None:
            return row.parts
        field, before = row.field, self._before(row)
        label, editor = QLabel(_lines(field.label)), self._editor(row)
        unit = QLabel(_lines(field.unit)) if field.unit else None
        if unit is not None:
            unit.setProperty("role", "hint")
            unit.setProperty("size", "caption")
            self._grid.addWidget(unit, row.line, UNIT)
        editor.setMinimumWidth(LEAST)
        label.setBuddy(editor)
        editor.setAccessibleName(field.label)
        self._grid.addWidget(label, row.line, LABEL)
        wide = unit is None and field.kind not in ("bool", "shown")  # it takes the room of a unit
        self._grid.addWidget(editor, row.line, EDITOR, 1, 1 + wide)
        if before is not None:
            QWidget.setTabOrder(before, editor)
        row.parts = _Parts(label, editor, unit)
        self._fill(row, row.parts)
        return row.parts

    def _before(self, row: _Row) -> QWidget | None:
        """Return the widget that has the focus before the widgets of a folded field."""
        if not row.rare:
            return None
        above = [one for one in self._rows.values() if one.rare and one.parts is not None and one.line < row.line]
        nearest = max(above, key=lambda one: one.line, default=None)
        return self.search or self.head if nearest is None or nearest.parts is None else nearest.parts.last()

    def _fill(self, row: _Row, parts: _Parts) -> None:
        """Show in new widgets what was set before they were made; last of all themselves, so they are styled once."""
        key = row.field.key
        if row.own_line:
            self._place_below(row, parts)
        if key in self._values:
            self._show_value(key, parts.editor, self._values[key])
        if row.source is not None:
            self._show_source(row, parts)
        self._enable(row, parts)
        self._mark_changed(row, parts)
        for widget in parts.widgets():
            widget.setVisible(self._seen(row))
        self._offer_reset(row, parts)

    def _heading(self, name: str) -> QLabel:
        """Return the heading of a group, which is made at the first call."""
        at, made = self._headings[name]
        if made is None:
            made = heading(name)
            self._grid.addWidget(made, at, LABEL, 1, RESET + 1)
            self._headings[name] = at, made
        return made

    def _editor(self, row: _Row) -> QWidget:
        field, key = row.field, row.field.key
        if field.kind == "choice":
            box = _ChoiceBox()
            for value, text in row.choices:
                box.addItem(text, value)
            box.currentIndexChanged.connect(lambda _=0: self._changed(key))
            return box
        if field.kind == "bool":
            tick = QCheckBox()
            tick.toggled.connect(lambda _=False: self._changed(key))
            return tick
        if field.kind == "shown":
            label = QLabel(wordWrap=True)
            return label
        edit = _NumberEdit() if field.kind == "float" else QLineEdit()
        edit.setPlaceholderText(field.empty)
        if field.kind in ("float", "int", "floats") or field.unit or field.read is not None:
            edit.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        if field.file:
            chosen = add_chooser(edit, f"Choose {field.label.lower()}", f"Choose a file (Alt+Down). {field.tip}")
            chosen.connect(lambda: self._browse(key, edit))
        edit.textEdited.connect(lambda _="": self._changed(key, ended=not field.late))
        edit.editingFinished.connect(lambda: self._ended(key))
        edit.selectionChanged.connect(lambda: self._select(key, edit))
        return edit

    def own_line(self, key: str) -> None:
        """Place the field of a long text on a line below its label, which then contains the unit."""
        row = self._rows[key]
        row.own_line = True
        if row.parts is not None:
            self._place_below(row, row.parts)

    def _place_below(self, row: _Row, parts: _Parts) -> None:
        self._grid.addWidget(parts.editor, row.line + 1, LABEL, 1, RESET + 1)
        if parts.unit is not None:
            parts.label.setText(f"{parts.label.text()} ({parts.unit.text()})")
            self._grid.addWidget(parts.label, row.line, LABEL, 1, EDITOR - LABEL + 1)
            self._grid.removeWidget(parts.unit)
            parts.unit.hide()
            parts.unit.deleteLater()
            parts.unit = None

    def fold_line(self, *parts: QWidget, above: bool = False) -> None:
        """Add widgets side by side to the folded part, below or ``above`` its fields."""
        holder = QWidget()
        row = line(*parts)
        row.setContentsMargins(0, 2, 0, 2)
        holder.setLayout(row)
        at = self._above if above else self._next
        self._grid.addWidget(holder, at, LABEL, 1, RESET + 1)
        if above:
            self._above += 1
        else:
            self._next += 1
        self._extras.append(holder)
        self._show_rows()

    # -- the fold --------------------------------------------------------------------------------------
    def open(self) -> None:
        """Show the folded fields."""
        self.head.setChecked(True)

    def set_shown(self, key: str, shown: bool) -> None:
        """Show or hide one field with its label."""
        if self._rows[key].shown != shown:
            self._rows[key].shown = shown
            self._show_rows()
            self._report()

    def set_folded(self, key: str, folded: bool) -> None:
        """Move one field into the folded part, or out of it."""
        if self._rows[key].rare != folded:
            self._rows[key].rare = folded
            self._show_rows()
            self._report()

    def _seen(self, row: _Row) -> bool:
        """Return whether a field is in view."""
        opened = self.head.isChecked()
        words = self.search.text().casefold().split() if self.search is not None else []
        return row.shown and (not row.rare or (opened and row.found(words)))

    def _show_rows(self) -> None:
        self._grid.setEnabled(False)  # else Qt would arrange the form again after each widget
        self._show_parts()
        self._grid.setEnabled(True)
        self._grid.invalidate()
        self._grid.activate()

    def _show_parts(self) -> None:
        opened, searched = self.head.isChecked(), self.search is not None and bool(self.search.text().strip())
        if self.search is not None:
            self.search.setVisible(opened)
        groups: set[str] = set()
        for row in self._rows.values():
            seen = self._seen(row)
            if seen:
                self._made(row)
            if row.parts is not None:
                for widget in row.parts.widgets():
                    widget.setHidden(not seen)
                self._offer_reset(row, row.parts)
            if seen and row.rare and row.field.group:
                groups.add(row.field.group)
        for name, (_, title) in self._headings.items():
            if name in groups or title is not None:
                self._heading(name).setVisible(name in groups)
        for extra in self._extras:
            extra.setVisible(opened and not searched)

    def set_state(self, values: Mapping[str, Any], marks: Mapping[str, tuple[str, str]]) -> None:
        """Show values and their marks; fields without a value are hidden."""
        for key, row in self._rows.items():
            row.shown = key in values
        self.set_values(values)
        self.set_marks(marks)
        self._show_rows()

    # -- marks -----------------------------------------------------------------------------------------
    def set_marks(self, marks: Mapping[str, tuple[str, str]]) -> None:
        """Show the sources of values, as words of `MARKS` with tooltips. Ticking an assumed value confirms it."""
        for key, source in marks.items():
            row = self._rows[key]
            row.source = source
            if row.parts is not None:
                self._show_source(row, row.parts)
        self._report()

    def _show_source(self, row: _Row, parts: _Parts) -> None:
        assert row.source is not None
        word, tip = row.source
        assumed = word == "assumed"
        mark = parts.mark
        if mark is None or isinstance(mark, QToolButton) != assumed:
            mark = self._make_mark(row, parts, assumed)
        mark.setText(MARKS[word])
        mark.setAccessibleName(f"{row.field.label}: {word}" + ", confirm" * assumed)
        mark.setToolTip(tip)
        # screen readers read the description after the name
        parts.editor.setAccessibleDescription(tip)
        set_look(mark, "mark", word)

    def _make_mark(self, row: _Row, parts: _Parts, assumed: bool) -> QToolButton | QLabel:
        """Make the mark of a value; the mark of an assumed value is a button."""
        if parts.mark is not None:
            parts.mark.hide()
            parts.mark.deleteLater()
        made: QToolButton | QLabel
        if assumed:
            made = _small("", "mark", "", "")
            made.clicked.connect(lambda: self.confirmed.emit(row.field.key))
        else:
            made = QLabel()
            made.setFixedWidth(SMALL)
            made.setAlignment(Qt.AlignmentFlag.AlignCenter)
        parts.mark = made
        self._grid.addWidget(made, row.line, MARK)
        QWidget.setTabOrder(parts.editor, made)
        made.setVisible(not parts.label.isHidden())
        return made

    def mark(self, key: str) -> QToolButton | QLabel:
        """Return the widget that shows the source of a value; its property ``mark`` is the word of `MARKS`."""
        found = self._made(self._rows[key]).mark
        assert found is not None
        return found

    # -- defaults --------------------------------------------------------------------------------------
    def set_defaults(self, defaults: Mapping[str, Any]) -> None:
        """Set the defaults, with which values are compared and to which they are reset; `UNKNOWN`: no default."""
        for key, value in defaults.items():
            if key in self.fields:
                self._defaults[key] = value
        self._defaults = {key: value for key, value in self._defaults.items() if value is not UNKNOWN}
        self._grid.setColumnMinimumWidth(RESET, SMALL if self._defaults else 0)
        self._report()

    @property
    def changed(self) -> tuple[str, ...]:
        """Keys of the fields whose values differ from their defaults."""
        return tuple(row.field.key for row in self._rows.values() if row.shown and self._differs(row))

    def enterEvent(self, event: QEnterEvent) -> None:
        """Show the reset buttons."""
        super().enterEvent(event)
        self._attend(True)

    def leaveEvent(self, event: QEvent) -> None:
        """Hide the reset buttons, unless the form has the focus."""
        super().leaveEvent(event)
        self._focus_moved(None, QApplication.focusWidget())

    def _focus_moved(self, _: QWidget | None, now: QWidget | None) -> None:
        self._attend(self.underMouse() or (now is not None and self.isAncestorOf(now)))

    def _attend(self, on: bool) -> None:
        if on != self._attended:
            self._attended = on
            self._report()

    def _differs(self, row: _Row) -> bool:
        key = row.field.key
        return key in self._defaults and not same(row.field, self._values.get(key), self._defaults[key])

    def reset(self, key: str) -> None:
        """Report the default of a field as its new value, or show why it is refused."""
        row, value = self._rows[key], self._defaults[key]
        why = self.check(key, value)
        if why:
            self._last = key
            self._mark(self._made(row).editor, why)
            self._show_error()
            return
        self._untouched.pop(key, None)
        if row.parts is not None:
            self._mark(row.parts.editor, "")
        self.edited.emit(key, value)

    def _reset_folded(self) -> None:
        for _ in range(2):  # one value may depend on another
            for key in self.changed:
                if self._rows[key].rare:
                    self.reset(key)
        self.head.setFocus()

    def _report(self) -> None:
        """Mark changed values, and show their number in the head of the folded part."""
        for row in self._rows.values():
            if row.parts is not None:
                self._mark_changed(row, row.parts)
        if not self._folds:
            return
        rare = [row for row in self._rows.values() if row.rare and row.shown]
        sources = [row.source[0] for row in rare if row.source is not None]
        assumed, count = sources.count("assumed"), sum(map(self._differs, rare))
        said = [f"{count} changed" if count else "", f"{assumed} assumed" if assumed else ""]
        known = any(row.field.key in self._defaults for row in rare)
        self.head.say(", ".join(filter(None, said)) or ("defaults" if known else "all known" * bool(sources)))
        self.reset_all.setVisible(self._attended and bool(count))
        self._grid.addWidget(self.head, self._at_head, LABEL, 1, RESET if count else RESET + 1)

    def _mark_changed(self, row: _Row, parts: _Parts) -> None:
        """Show whether a value differs from its default."""
        key, differs = row.field.key, row.shown and self._differs(row)
        if differs and parts.reset is None:
            parts.reset = _small("↺", "reset", f"Reset {row.field.label}", "")
            parts.reset.clicked.connect(lambda _=False, key=key: self._reset_one(key))
            self._grid.addWidget(parts.reset, row.line, RESET)
            QWidget.setTabOrder(parts.mark or parts.editor, parts.reset)
        if parts.reset is not None:
            parts.reset.setToolTip(f"Reset to the default: {self._default_words(row)}")
        self._offer_reset(row, parts)
        for widget in (parts.label, parts.editor):
            set_look(widget, "changed", differs)

    def _offer_reset(self, row: _Row, parts: _Parts) -> None:
        """Show the reset button of a changed value that is in view while the user is in the form."""
        if parts.reset is not None:
            parts.reset.setVisible(self._attended and not parts.label.isHidden() and row.shown and self._differs(row))

    def _default_words(self, row: _Row) -> str:
        value = self._defaults.get(row.field.key)
        if row.field.kind == "bool":
            return "on" if value else "off"
        text = dict(row.field.choices).get(value) or text_of(row.field, value)
        return f"{text} {row.field.unit}".strip() if text else row.field.empty or "empty"

    def _reset_one(self, key: str) -> None:
        self.reset(key)
        self.editor(key).setFocus()  # the button was hidden and lost the focus

    # -- values ----------------------------------------------------------------------------------------
    def editor(self, key: str) -> QWidget:
        """Return the widget of a field."""
        return self._made(self._rows[key]).editor

    def set_values(self, values: Mapping[str, Any]) -> None:
        """Show values without reporting them; a field that is being edited keeps its text if it means the same.

        Values without a field are ignored.
        """
        for key, value in values.items():
            if key not in self._rows:
                continue
            parts = self._rows[key].parts
            if parts is not None:
                self._show_value(key, parts.editor, value)
            self._values[key] = value
        self._show_error()
        self._report()

    def _show_value(self, key: str, editor: QWidget, value: Any) -> None:
        with QSignalBlocker(editor):
            if isinstance(editor, QLineEdit):
                self._set_text(key, editor, value)
            elif isinstance(editor, QComboBox):
                editor.setCurrentIndex(max(0, editor.findData(value)))
            elif isinstance(editor, QCheckBox):
                editor.setChecked(bool(value))
            elif isinstance(editor, QLabel):
                editor.setText(str(value))

    def set_choices(self, key: str, choices: tuple[tuple[Any, str], ...]) -> None:
        """Set the choices of a field."""
        row = self._rows[key]
        row.choices = choices
        if row.parts is None:
            return
        editor = row.parts.editor
        assert isinstance(editor, QComboBox)
        with QSignalBlocker(editor):
            editor.clear()
            for value, text in choices:
                editor.addItem(text, value)
            editor.setCurrentIndex(max(0, editor.findData(self._values.get(key))))

    def _set_text(self, key: str, editor: QLineEdit, value: Any) -> None:
        unchanged = self._stands_for(key, value)
        if not unchanged and key != self._reported:  # changed elsewhere: forget the value before typing
            self._untouched.pop(key, None)
        if unchanged and (editor.property("reason") or (self.fields[key].late and editor.isModified())):
            return  # the user can still correct or complete the refused text
        if not editor.text() or not means(self.fields[key], editor.text(), value):
            editor.setText(text_of(self.fields[key], value))
            editor.setCursorPosition(0)  # show the start of a long number
        self._mark(editor, "")

    def set_enabled(self, key: str, enabled: bool, why: str = "") -> None:
        """Enable or disable one field with its label; while it is disabled, its tooltip contains the reason ``why``."""
        row = self._rows[key]
        row.enabled, row.why = enabled, why
        if row.parts is not None:
            self._enable(row, row.parts)

    def _enable(self, row: _Row, parts: _Parts) -> None:
        editor = parts.editor
        if not row.enabled and isinstance(editor, QLineEdit) and editor.property("reason"):
            self._mark(editor, "")
            editor.setText(text_of(row.field, self._values.get(row.field.key)))
            self._show_error()
        for widget in parts.widgets():
            widget.setEnabled(row.enabled)
        for widget in (editor, parts.label):
            widget.setToolTip(row.why or row.field.tip)

    def _browse(self, key: str, editor: QLineEdit) -> None:
        field = self.fields[key]
        path = QFileDialog.getOpenFileName(self, field.label, editor.text(), field.file)[0]
        if path:
            editor.setText(path)
            self._changed(key)

    # -- typing ----------------------------------------------------------------------------------------
    def _select(self, key: str, editor: QLineEdit) -> None:
        """Record whether all of the text is selected: typing then starts a new value."""
        if editor.selectedText() and editor.selectedText() == editor.text():
            self._selected[key] = editor.text()

    def _ended(self, key: str) -> None:
        editor = self.editor(key)
        assert isinstance(editor, QLineEdit)
        if self.fields[key].late and not means(self.fields[key], editor.text(), self._values.get(key)):
            self._changed(key)
        self._untouched.pop(key, None)

    def _read(self, key: str) -> tuple[Any, str]:
        """Return the value of a field, and why it is refused (empty: accepted)."""
        editor, field = self.editor(key), self.fields[key]
        if isinstance(editor, QComboBox):
            return editor.currentData(), ""
        if isinstance(editor, QCheckBox):
            return editor.isChecked(), ""
        assert isinstance(editor, QLineEdit)
        if self._selected.pop(key, editor.text()) not in editor.text():
            self._untouched.pop(key, None)
        self._untouched.setdefault(key, self._values.get(key, None if field.optional else UNKNOWN))
        try:
            return parse(field, editor.text()), ""
        except InputError as refused:
            return None, str(refused)

    def _changed(self, key: str, *, ended: bool = True) -> None:
        value, error = self._read(key)
        error = error or self.check(key, value)
        self._last = key
        self._mark(self.editor(key), error)
        self._show_error()
        if not ended:
            return
        if error:
            value = self._untouched.get(key, UNKNOWN)
            if value is UNKNOWN or self._stands_for(key, value):
                return
        self._values[key], self._reported = value, key
        self._report()
        try:
            self.edited.emit(key, value)
        finally:
            self._reported = ""

    def _stands_for(self, key: str, value: Any) -> bool:
        """Return whether the field was last shown, or reported, with this value."""
        return key in self._values and text_of(self.fields[key], self._values[key]) == text_of(self.fields[key], value)

    def _mark(self, editor: QWidget, error: str) -> None:
        set_look(editor, "invalid", bool(error))
        editor.setProperty("reason", error)

    def _show_error(self) -> None:
        made = {key: row.parts.editor for key, row in self._rows.items() if row.parts is not None}
        errors = {key: str(editor.property("reason")) for key, editor in made.items() if editor.property("reason")}
        key = self._last if self._last in errors else next(iter(errors), "")
        self._error.setText(errors.get(key, ""))
        self._error.setVisible(bool(errors))
        if errors:
            self._grid.addWidget(self._error, self._rows[key].line + LINES - 1, LABEL, 1, RESET + 1)

    @property
    def error(self) -> str:
        """The displayed reason why a value is refused; empty if there is none."""
        return self._error.text() if not self._error.isHidden() else ""


def add_chooser(edit: QLineEdit, name: str, tip: str) -> SignalInstance:
    """Add a button to the field of a path; Alt+Down also presses it. Return its signal."""
    icon = edit.style().standardIcon(QStyle.StandardPixmap.SP_DirOpenIcon)
    browse = edit.addAction(icon, QLineEdit.ActionPosition.TrailingPosition)
    browse.setText(name)
    browse.setToolTip(tip)
    browse.setShortcut("Alt+Down")
    browse.setShortcutContext(Qt.ShortcutContext.WidgetShortcut)
    return browse.triggered


def _small(text: str, role: str, name: str, tip: str) -> QToolButton:
    button = QToolButton()
    button.setText(text)
    button.setProperty("role", role)
    button.setAccessibleName(name)
    button.setToolTip(tip)
    button.setFixedSize(SMALL, SMALL)
    button.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
    return button


def _lines(text: str) -> str:
    """Return a long label, wrapped into two lines."""
    if len(text) <= LONGEST or " " not in text:
        return text
    middle = min((k for k, letter in enumerate(text) if letter == " "), key=lambda k: abs(2 * k - len(text)))
    return f"{text[:middle]}\n{text[middle + 1 :]}"
