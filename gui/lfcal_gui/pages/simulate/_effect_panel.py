"""The selected effect: why it is on or off, its magnitudes, and what it does to one position."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QGridLayout, QLabel, QPushButton, QScrollArea, QSplitter, QVBoxLayout, QWidget

from lfcal_gui.models import Shot, levels_of
from lfcal_gui.pages.simulate._magnitude_form import MagnitudeForm
from lfcal_gui.pages.simulate.model_effects import FRAMES_ONLY, EffectRow
from lfcal_gui.pages.simulate.model_influence import InfluencePictures
from lfcal_gui.widgets import Picture, clear, heading, line, link, share_contrast

TITLES = ("without", "with", "difference")


class InfluenceView(QWidget):
    """Pictures that pan and zoom together; the first two share their levels."""

    def __init__(self) -> None:
        super().__init__()
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setSpacing(4)
        self.pictures = tuple(Picture() for _ in TITLES)
        link(*self.pictures)
        share_contrast(*self.pictures[:2])
        for k, (picture, title) in enumerate(zip(self.pictures, TITLES, strict=True)):
            picture.setAccessibleName(f"pattern of a position: {title}")
            grid.addWidget(picture, k // 2, k % 2)
        self.words = QLabel()
        self.words.setWordWrap(True)
        self.words.setProperty("role", "hint")
        self.influence: InfluencePictures | None = None
        grid.addWidget(self.words, 1, 1)
        for k in range(2):
            grid.setRowStretch(k, 1)
            grid.setColumnStretch(k, 1)

    def show_influence(self, influence: InfluencePictures | None, words: str = "") -> None:
        """Show the pictures of one position; None clears them and says why."""
        self.influence = influence
        self.words.setText(words or (influence.words if influence is not None else ""))
        if influence is None:
            for picture in self.pictures:
                picture.set_shot(None)
            return
        shown = influence.without, influence.with_it, influence.difference
        common = levels_of(np.stack(shown[:2]))
        for k, (picture, title, values) in enumerate(zip(self.pictures, TITLES, shown, strict=True)):
            signed = k == 2
            quantity = title if signed else influence.value
            levels = None if signed else common
            picture.setToolTip("{1} over {0}".format(*influence.axes))
            shot = Shot(values, title, quantity, f"effect_{title}", levels, signed, origin=influence.origin)
            picture.set_shot(shot)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for picture in self.pictures:
            picture.apply_theme()


class EffectPanel(QWidget):
    """What is known of one effect.

    Signals
    -------
    given(effect, field, value, mark)
        The user gave a magnitude, or with a value of None takes it back.
    stop_asked()
        The user waits no longer for the pictures.
    """

    given = Signal(str, str, object, str)
    stop_asked = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.title = heading("Choose an effect to see its magnitudes and what it does.")
        self.why = QLabel()
        self.formula = QLabel()
        for label in (self.title, self.why, self.formula):
            label.setWordWrap(True)
        self.formula.setProperty("role", "hint")
        self.note = QLabel("This effect has no magnitudes. Its values are in the camera description.")
        self.note.setProperty("role", "hint")
        self.note.setWordWrap(True)
        self._typical = False
        self.form = MagnitudeForm()
        self.form.given.connect(self.given.emit)
        self.influence = InfluenceView()
        self.stop_button = QPushButton("Stop")
        self.stop_button.setToolTip("Stop computing these pictures; the effect stays on")
        self.stop_button.clicked.connect(lambda _=False: self.stop_asked.emit())
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 6, 0, 0)
        both = QSplitter(Qt.Orientation.Vertical)
        both.setChildrenCollapsible(False)
        both.setHandleWidth(8)
        both.addWidget(self._words_area())
        both.addWidget(self.influence)
        both.setStretchFactor(0, 0)
        both.setStretchFactor(1, 1)
        both.setSizes([230, 400])
        layout.addWidget(both)
        self.show_row(None)

    def _words_area(self) -> QScrollArea:
        inner = QWidget()
        column = QVBoxLayout(inner)
        column.setContentsMargins(0, 0, 4, 0)
        column.setSpacing(5)
        for widget in (self.title, self.why, self.form, self.note, self.formula):
            column.addWidget(widget)
        column.addLayout(line(self.stop_button))
        column.addStretch()
        area = QScrollArea()
        area.setWidgetResizable(True)
        area.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        area.setWidget(inner)
        clear(area)
        return area

    # -- showing ---------------------------------------------------------------------------------------
    def show_row(self, row: EffectRow | None) -> None:
        """Show what is known of an effect; None: none is selected."""
        there = row is not None
        for widget in (self.why, self.form, self.note, self.formula, self.influence, self.stop_button):
            widget.setVisible(there)
        self.stop_button.setEnabled(False)
        if row is None:
            return
        self._typical = row.effect.deviation and not row.given and row.share > 0
        self.title.setText(row.title if row.enters_h else f"{row.title}: {FRAMES_ONLY}")
        self.why.setText(row.verdict_text())
        self.formula.setText(f"Estimate: {row.formula}")
        self.note.setVisible(not row.magnitudes)
        self.form.show_row(row)

    def show_waiting(self, words: str) -> None:
        """Say that pictures are being computed; they may be stopped."""
        self.stop_button.setEnabled(True)
        self.influence.show_influence(None, words)

    def show_influence(self, influence: InfluencePictures | None, why: str = "") -> None:
        """Show the pictures, or why there are none."""
        self.stop_button.setEnabled(False)
        size = "At a typical size, " if self._typical else ""
        self.influence.show_influence(influence, why or (f"{size}{influence.words}" if influence is not None else ""))
