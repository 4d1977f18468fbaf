"""Linked pictures: reconstructions by both routes, their difference or the truth, and the recorded frame."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QSignalBlocker, Qt, Signal
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QVBoxLayout, QWidget

from lfcal_gui.models import Shot
from lfcal_gui.pages.multiplex.model_scene import Reconstructions, shown
from lfcal_gui.widgets import Picture, card, line, link, name_controls, set_role, share_contrast

RIGHT = (("difference", "spatial − Fourier"), ("truth", "truth"))
HEADS = ("Spatial", "Fourier", "Difference", "Recorded frame")


class MultiplexPictures(QWidget):
    """Four linked pictures, whose axes are in pixels of the frame."""

    right_chosen = Signal(str, arguments=["name"])
    """The user chose the content of the third picture: ``"difference"`` or ``"truth"``."""
    sample_chosen = Signal(int, arguments=["index"])
    """The user chose a sample; -1: all colours."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.names: tuple[str, ...] = ()
        self._third = RIGHT[0][0]
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 8, 0, 0)
        outer.setSpacing(6)
        self.sample = QComboBox()
        self.sample.setMinimumWidth(120)
        self.sample.setAccessibleName("Colour or view")
        self.sample.setToolTip("Colour or view shown in all images")
        self.sample.currentIndexChanged.connect(lambda _: self.sample_chosen.emit(self.sample_index))
        self.right = QComboBox()
        for key, text in RIGHT:
            self.right.addItem(text, key)
        self.right.setAccessibleName("Third image")
        self.right.setToolTip(
            "Bottom-left image: the difference between the results of the spatial and the Fourier route, or the "
            "true scene. The true scene is unknown for recorded frames"
        )
        self.right.currentIndexChanged.connect(lambda _: self.right_chosen.emit(self.right.currentData()))
        self.readout = QLabel("")
        self.readout.setProperty("role", "hint")
        outer.addLayout(line("Shown", self.sample, "Third image", self.right, self.readout, stretch=4))
        self.heads = [QLabel(title) for title in HEADS]
        self._grid = QGridLayout()
        self._grid.setSpacing(8)
        outer.addLayout(self._grid, 1)
        self.status = QLabel("", textFormat=Qt.TextFormat.PlainText, wordWrap=True)
        outer.addWidget(self.status)

    @cached_property
    def views(self) -> list[Picture]:
        """The four pictures, which are created when they are first shown."""
        views = []
        for k, head in enumerate(self.heads):
            head.setMinimumWidth(60)
            frame, column = card(head)
            view = Picture("intensity (1)", axes=("column (px)", "row (px)"))
            view.hovered.connect(self._hovered)
            view.blank.words = "The reason is given below."
            column.addWidget(view, 1)
            self._grid.addWidget(frame, k // 2, k % 2)
            views.append(view)
        link(*views)
        share_contrast(*views[:2])
        for k in range(2):
            self._grid.setColumnStretch(k, 1)
            self._grid.setRowStretch(k, 1)
        name_controls(self)
        return views

    def showEvent(self, event: QShowEvent) -> None:
        """Create the pictures when the widget is first shown."""
        for view in self.views:
            view.show()
        super().showEvent(event)

    @property
    def sample_index(self) -> int:
        """Index of the selected sample; -1: all colours."""
        index = self.sample.currentData()
        return 0 if index is None else int(index)

    def show_right(self, name: str) -> None:
        """Select the content of the third picture without reporting it."""
        with QSignalBlocker(self.right):
            self.right.setCurrentIndex(max(0, self.right.findData(name)))

    def show_samples(self, names: tuple[str, ...], coloured: bool) -> None:
        """Set the samples to choose from; in a new set, all colours or the middle view are selected."""
        if names == self.names:
            return
        self.names = names
        with QSignalBlocker(self.sample):
            self.sample.clear()
            if coloured:
                self.sample.addItem("all colours", -1)
            for k, name in enumerate(names):
                self.sample.addItem(name, k)
            self.sample.setCurrentIndex(0 if coloured else len(names) // 2)

    def show_reconstructions(self, found: Reconstructions, right: str) -> None:
        """Draw both routes and the third picture with the same zoom."""
        self.show_samples(found.names, found.names == ("R", "G", "B"))
        if right == "truth" and found.truth is None:
            right = "difference"
        if found.fourier is None:
            right = "truth"
        pictures = (*shown(found, self.sample_index, right), found.frame)
        self._third, signed = right, right == "difference"
        low = min(float(np.min(p)) for p in pictures[:2] if p is not None)
        high = max(float(np.max(p)) for p in pictures[:2] if p is not None)
        levels = (low, high if high > low else low + 1.0)
        for k, (view, image) in enumerate(zip(self.views, pictures, strict=True)):
            if image is None:
                view.set_shot(None)
                continue
            step = found.step if k < 3 else 1.0  # all in pixels of the frame
            middle = ((step - 1) / 2, (step - 1) / 2)
            plain = k == 3 or (k == 2 and signed)
            shot = Shot(
                image,
                name=right if k == 2 else HEADS[k].lower(),
                levels=None if plain else levels,
                signed=k == 2 and signed,
                step=step,
                origin=middle if found.origin is None or k == 3 else found.origin,
            )
            view.set_shot(shot)
        titles = (found.spatial.words, *_titles(found, signed), HEADS[3])
        for head, text in zip(self.heads, titles, strict=True):
            head.setText(text)
        self.show_status(found.words)

    def clear_pictures(self) -> None:
        """Clear the pictures."""
        for view, head, title in zip(self.views, self.heads, HEADS, strict=True):
            view.set_shot(None)
            head.setText(title)

    def show_reconstructing(self) -> None:
        """Announce a new reconstruction; until it is complete, the previous pictures stay, without their numbers."""
        for head, title in zip(self.heads, HEADS, strict=True):
            head.setText(title)
        before = any(view.values is not None for view in self.views)
        self.show_status("reconstructing …" + "; the images show the previous settings" * before)

    def show_status(self, text: str, *, bad: bool = False) -> None:
        """Show a description of the pictures, or why there are none."""
        set_role(self.status, "error" if bad else "hint")
        self.status.setText(text)

    def _hovered(self, row: int, column: int, _: float) -> None:
        if row < 0:
            self.readout.setText("")
            return
        images: list[NDArray[np.float64] | None] = [view.values for view in self.views]
        parts = [
            f"{name} {image[row, column]:.4g}"
            for name, image in zip(("spatial", "Fourier", self._third), images[:3], strict=True)
            if image is not None and row < image.shape[0] and column < image.shape[1]
        ]
        self.readout.setText(f"row {row}, column {column}: {', '.join(parts)}")

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for view in self.views if "views" in self.__dict__ else ():
            view.apply_theme()


def _titles(found: Reconstructions, signed: bool) -> tuple[str, str]:
    """Return the titles of the second and the third picture."""
    if found.fourier is None:
        return "No second route", "Truth" if found.truth is not None else "Truth: unknown for frames"
    if not signed:
        return found.fourier.words, "Truth"
    rms = float(np.sqrt(np.mean((found.spatial.samples - found.fourier.samples) ** 2)))
    return found.fourier.words, f"Spatial − Fourier: {rms:.2g} rms, all samples"
