"""What is fitted: the positions of H, the camera that it starts from, and groups of unknowns."""

from __future__ import annotations

from collections.abc import Mapping

from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import (
    QLabel,
    QLineEdit,
    QListWidget,
    QListWidgetItem,
    QVBoxLayout,
    QWidget,
)

from lfcal.fit import Fit
from lfcal.tasks import FitMatrix
from lfcal_gui.models import ProjectState, check_of, fields_of, shown_of, typeset
from lfcal_gui.pages.h.model_fit import HELD, START, FitSettings, Offer, group_rows
from lfcal_gui.widgets import Folded, FoldedForm, WrappedLabel, choice_box, set_role

NAME = Qt.ItemDataRole.UserRole
WAYS = (("auto", "found: those that help"), ("chosen", "those chosen below"))


class _Groups(QListWidget):
    """A list as high as its lines, however they are wrapped."""

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Wrap the lines again."""
        super().resizeEvent(event)
        self.fit_height()

    def fit_height(self) -> None:
        """Be as high as all lines."""
        self.doItemsLayout()
        lines = [self.visualItemRect(self.item(k)) for k in range(self.count())]
        self.setFixedHeight(lines[-1].bottom() - lines[0].top() + 2 * self.frameWidth() + 6)


class ChoicesPanel(QWidget):
    """Folded form of the fit: its settings and groups of unknowns.

    Signals
    -------
    edited(key, value)
        The user changed a value of `FitSettings`.
    group_toggled(name, on)
        The user switched the fit of a group of unknowns on or off.
    """

    edited = Signal(str, object)
    group_toggled = Signal(str, bool)

    def __init__(self) -> None:
        super().__init__()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(6)
        column.addWidget(self._start())
        self.unknowns = self._unknowns()
        column.addWidget(self.unknowns)

    # -- building --------------------------------------------------------------------------------------
    def _start(self) -> Folded:
        frame = Folded("Patterns and start", "Positions, noise and camera that the fit begins with")
        column = frame.column
        self.source, self.use, self.start, self.noise = (_wrapped() for _ in range(4))
        some, rare = (fields_of(FitMatrix, without=HELD, more=more) for more in (False, True))
        self.form = FoldedForm((START, *some), rare, tip="Effects that the simulation begins with, and what H is saved")
        self.form.check = check_of(FitMatrix)
        self.form.edited.connect(self.edited.emit)
        column.addWidget(self.source)
        column.addWidget(self.form)
        for label in (self.use, self.start, self.noise):
            column.addWidget(label)
        return frame

    def _unknowns(self) -> Folded:
        frame = Folded("Unknowns", "Groups of values that the fit may change in the described camera")
        column = frame.column
        self.way = choice_box(WAYS, "Found: the fit chooses groups that lower the error of held-out patterns")
        self.way.setAccessibleName("choice of unknowns")
        self.way.currentIndexChanged.connect(lambda _: self.edited.emit("auto", self.way.currentData() == "auto"))
        self.groups = _Groups()
        self.groups.setAccessibleName("groups of unknowns")
        self.groups.setToolTip("Tick the groups that may differ from the description; the others are fixed")
        for name, title, _ in group_rows():
            item = QListWidgetItem(title)
            item.setData(NAME, name)
            self.groups.addItem(item)
        self.groups.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.groups.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.groups.setWordWrap(True)
        self.groups.setResizeMode(QListWidget.ResizeMode.Adjust)
        self.groups.setTextElideMode(Qt.TextElideMode.ElideNone)
        self.groups.itemChanged.connect(self._toggled)
        self.legend = _wrapped()
        column.addWidget(self.way)
        column.addWidget(self.groups)
        column.addWidget(self.legend)
        return frame

    # -- showing ---------------------------------------------------------------------------------------
    def show_source(self, name: str, offer: Offer | None, project: ProjectState) -> None:
        """Show what the H called ``name`` offers to a fit in a project; None: it is being opened."""
        settings = FitSettings.of(project)
        if offer is None:
            self.source.setText(f"{name} is being opened …")
            for label in (self.use, self.start, self.noise):
                label.setText("")
            return
        self.source.setText(offer.source_words(name))
        self.use.setText(offer.use_words(settings.positions))
        editor = self.form.editor("noise")
        assert isinstance(editor, QLineEdit)
        editor.setPlaceholderText("needed" if offer.noise is None else self.form.fields["noise"].empty)
        _say(self.start, *offer.camera_words(settings, project.camera, project.plan))
        _say(self.noise, *offer.noise_words(settings))

    def show_settings(self, settings: FitSettings, fit: Fit | None, lacking: Mapping[str, str]) -> None:
        """Show what the user chose; of a ``fit`` that found its groups, which they are.

        Groups of ``lacking`` are grey, with what the camera would need for them.
        """
        values = {**shown_of(FitMatrix, vars(settings)), "camera": settings.camera}
        self.form.set_values(values)
        blockers = [QSignalBlocker(self.way), QSignalBlocker(self.groups)]
        self.way.setCurrentIndex(0 if settings.auto else 1)
        groups = fit.groups if fit is not None and settings.auto else None
        for k, (name, title, core) in enumerate(group_rows()):
            item, needs = self.groups.item(k), lacking.get(name, "")
            flags, mark = Qt.ItemFlag.ItemIsEnabled, ""
            if needs:
                flags, mark = Qt.ItemFlag.NoItemFlags, "–  " if settings.auto else ""
            elif settings.auto:
                mark = ("✓  " if core else "?  ") if groups is None else ("✓  " if name in groups else "–  ")
            else:
                flags |= Qt.ItemFlag.ItemIsUserCheckable
            if settings.auto:
                item.setData(Qt.ItemDataRole.CheckStateRole, None)
            else:
                on = name in settings.groups and not needs
                item.setCheckState(Qt.CheckState.Checked if on else Qt.CheckState.Unchecked)
            item.setFlags(flags)
            item.setText(typeset(f"{mark}{title}" + (f"\nneeds {needs}" if needs else "")))
            always = ", always fitted where groups are found" if core else ""
            item.setToolTip(f"{name}: {title}" + (f"; needs {needs}" if needs else always))
        self.groups.fit_height()
        self.legend.setText(_legend(settings, told=groups is not None))
        self.legend.setVisible(bool(self.legend.text()))
        for blocker in blockers:
            blocker.unblock()

    def set_running(self, running: bool) -> None:
        """Keep choices as they are while a fit is at work."""
        for widget in (self.form, self.way, self.groups):
            widget.setEnabled(not running)

    def _toggled(self, item: QListWidgetItem) -> None:
        self.group_toggled.emit(item.data(NAME), item.checkState() == Qt.CheckState.Checked)


def _legend(settings: FitSettings, *, told: bool) -> str:
    if not settings.auto:
        return ""
    return "✓ fitted, – did not help" if told else "✓ always fitted, ? tried and kept if it helps"


def _say(label: QLabel, words: str, role: str) -> None:
    label.setText(words)
    set_role(label, role)


def _wrapped() -> QLabel:
    label = WrappedLabel()
    label.setProperty("role", "hint")
    return label
