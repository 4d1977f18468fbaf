"""Quality: what shows the chosen fault or metric: the positions concerned, and a curve or map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QPushButton, QSlider, QStackedWidget, QVBoxLayout, QWidget

from lfcal_gui.models import Shot, Symbols
from lfcal_gui.widgets import LINES, LinePlot, Picture, card

__all__ = ["EvidenceView"]

MARK = "#ff5a5f"
"""Colour of the squares about positions: it stands out of every map."""

CONCERNED = "1: concerned"


class EvidenceView(QWidget):
    """Positions above, the picture below.

    Signals
    -------
    plane_chosen(z)
        Another plane is looked at.
    plane_asked()
        Show this plane on the PSF page.
    position_clicked(y, x)
        Show the frame of a position.
    """

    plane_chosen = Signal(int)
    plane_asked = Signal()
    position_clicked = Signal(int, int)

    def __init__(self) -> None:
        super().__init__()
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(8)
        self.map_card = self._map_card()
        column.addWidget(self.map_card, 5)
        column.addWidget(self._picture_card(), 4)

    # -- building --------------------------------------------------------------------------------------
    def _map_card(self) -> QFrame:
        self.map_title = QLabel("Positions of a plane")
        frame, column = card(self.map_title)
        self.map = Picture("value", axes=("position x (px)", "position y (px)"), colour_map="cividis")
        self.map.setToolTip("Click a position to look at it")
        self.map.clicked.connect(self.position_clicked.emit)
        self.map.hovered.connect(self._hovered)
        self.plane_label = QLabel("Plane 0")
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setAccessibleName("plane")
        self.slider.setToolTip("Depth plane of the map: is a fault there in all of them, or in one?")
        self.slider.valueChanged.connect(self.plane_chosen.emit)
        self.show_button = QPushButton("Show in PSF")
        self.show_button.setToolTip("See H itself in this plane, on page PSF")
        self.show_button.clicked.connect(lambda: self.plane_asked.emit())
        row = QHBoxLayout()
        row.addWidget(self.plane_label)
        row.addWidget(self.slider, 1)
        row.addWidget(self.show_button)
        self.readout = QLabel(" ")
        self.readout.setProperty("role", "hint")
        self._hint = " "
        column.addWidget(self.map, 1)
        column.addLayout(row)
        column.addWidget(self.readout)
        return frame

    def _picture_card(self) -> QFrame:
        self.picture_title = QLabel("Over depth")
        frame, column = card(self.picture_title)
        self.curve = LinePlot("depth z (mm)", "value")
        # rows and columns of it need not be pixels of one size
        self.image = Picture("value", axes=("column", "row"), square=False, colour_map="cividis")
        self.none = QLabel()
        self.none.setProperty("role", "hint")
        self.none.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.none.setWordWrap(True)
        self.pictures = QStackedWidget()
        for content in (self.none, self.curve, self.image):
            self.pictures.addWidget(content)
        column.addWidget(self.pictures, 1)
        return frame

    # -- positions -------------------------------------------------------------------------------------
    def set_planes(self, planes: int, z: int) -> None:
        """Offer so many planes, ``z`` chosen, without reporting it."""
        blocker = QSignalBlocker(self.slider)
        self.slider.setRange(0, planes - 1)
        self.slider.setValue(z)
        self.slider.setEnabled(planes > 1)
        blocker.unblock()

    def show_map(
        self, title: str, z: int, image: NDArray[np.float32] | None, name: str, label: str, none: str = ""
    ) -> None:
        """Show a value over the positions ``(ny, nx)`` of plane ``z``; None: not known in it, and ``none`` says so."""
        self.map_title.setText(title)
        self.plane_label.setText(f"Plane {z}")
        self.map.set_shot(Shot(image, "", label, name, (0.0, 1.0) if label == CONCERNED else None))
        self._hint = none if image is None else " "
        self.readout.setText(self._hint)

    def offer_map(self, there: bool) -> None:
        """Leave the room to the picture where there is no value of single positions in any plane."""
        self.map_card.setVisible(there)

    def say(self, words: str) -> None:
        """Say something under the map, until the pointer is over it."""
        self._hint = words
        self.readout.setText(words)

    def mark(self, positions: NDArray[np.intp]) -> None:
        """Mark positions (y, x) ``(n, 2)`` of the plane shown."""
        self.map.set_overlays(Symbols(positions.astype(float), "s", MARK, 9))

    def _hovered(self, y: int, x: int, value: float) -> None:
        told = f"{value:.4g}" if math.isfinite(value) else "not known"
        words = f"position y {y}, x {x}: {told}; click to look at it" if y >= 0 else self._hint
        self.readout.setText(words)

    # -- pictures --------------------------------------------------------------------------------------
    def show_curve(
        self, title: str, xlabel: str, ylabel: str, x: NDArray[np.floating], y: NDArray[np.floating]
    ) -> None:
        """Show a curve with the names and units of its axes."""
        self.picture_title.setText(title)
        self.curve.clear()
        self.curve.set_labels(xlabel, ylabel)
        self.curve.set_curve(ylabel, x, y, symbol="o" if len(x) < 60 else None, colour=LINES[0])
        self.curve.plot.autoRange()
        self.pictures.setCurrentWidget(self.curve)

    def show_image(
        self,
        title: str,
        axes: tuple[str, ...],
        label: str,
        image: NDArray[np.floating],
        origin: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Show a map ``(rows, columns)`` with the names of its axes, numbered from ``origin``, and the values' unit."""
        self.picture_title.setText(title)
        self.image.set_axes(axes[1], axes[0])
        self.image.set_shot(Shot(np.asarray(image, np.float64), "", label, title, origin=origin), keep_view=False)
        self.pictures.setCurrentWidget(self.image)

    def show_none(self, title: str, words: str) -> None:
        """Say why there is no picture."""
        self.picture_title.setText(title)
        self.none.setText(words)
        self.pictures.setCurrentWidget(self.none)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for plot in (self.map, self.image, self.curve):
            plot.apply_theme()
