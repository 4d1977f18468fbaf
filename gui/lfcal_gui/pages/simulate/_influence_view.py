"""Three pictures and words: a position without an effect, with it, and the difference."""

from __future__ import annotations

import numpy as np
from PySide6.QtWidgets import QGridLayout, QLabel, QWidget

from lfcal_gui.models import Shot, levels_of
from lfcal_gui.pages.simulate.model_influence import InfluencePictures
from lfcal_gui.widgets import Picture, link, share_contrast

__all__ = ["InfluenceView"]

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
