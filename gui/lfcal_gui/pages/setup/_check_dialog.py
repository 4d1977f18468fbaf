"""Comparison of the camera with a white image: agreements, differences, and measured lattice."""

from __future__ import annotations

import numpy as np
from PySide6.QtWidgets import QDialog, QHBoxLayout, QStackedWidget, QWidget

from lfcal.judge import judgement_of
from lfcal.lattice import DIFFERS, FITS, WRONG
from lfcal_gui.models import Outline, Shot, Symbols, typeset
from lfcal_gui.pages.setup.model_check import DISTORTION, RESIDUALS, Checked, LatticeMap, lattice_words
from lfcal_gui.theme import current_theme
from lfcal_gui.widgets import Picture, RowsTable, WrappedLabel, choice_box, column_of, wrapped

PICTURE = "picture"
SHOWN = ((PICTURE, "White image"), (DISTORTION, "Distortion"), (RESIDUALS, "Residuals"))
LEGENDS = {
    PICTURE: "First corner of the frame: + measured, ○ as described.",
    DISTORTION: "Arrows from straight rows to the measured micro-images, up to {largest:.2f} px",
    RESIDUALS: "Arrows from the lattice to the micro-images, averaged over each cell, up to {largest:.3f} px",
}
STRAIGHT = "The lattice is straight: there is no distortion to draw."
LENSLETS = 12
"""Number of lenslets visible along a side of the picture."""

COLUMNS = ("", "Verdict", "Difference (px)", "Camera", "White image")
OFF_BY = 2
SIZE, ROOMY = (990, 460), 740
"""Size of the dialog, and smallest width of a table with all columns (px)."""


class CheckDialog(QDialog):
    """Dialog with the white image, both lattices, and a table of all values, which is updated while it is open."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Camera compared with a white image")
        self.resize(*SIZE)
        self.choice = choice_box(
            SHOWN, "Image with both lattices, or deviation of the micro-images from a lattice", "image of the lattice"
        )
        self.choice.currentIndexChanged.connect(lambda _: self._show())
        self.legend = wrapped()
        self.image = Picture(legend=False, colour_map="gray")
        self.map = Picture("displacement (px)", axes=("column (px)", "row (px)"), colour_map="cividis")
        self.stack = QStackedWidget()
        for view in (self.image, self.map):
            self.stack.addWidget(view)
        self.table = RowsTable(COLUMNS, 0, sizes=(OFF_BY,), spare=(OFF_BY,), roomy=ROOMY)
        self.table.setAccessibleName("Camera and white image")
        self.table.setToolTip(
            "Values of the camera as described and as measured in the white image, and their difference in pixels"
        )
        self.words, self.about = WrappedLabel(), WrappedLabel()
        self.words.setProperty("role", "value")
        row = QHBoxLayout(self)
        row.addLayout(column_of(self.choice, self.stack, self.legend, stretch=1, spacing=3), 2)
        row.addLayout(column_of(self.words, self.about, self.table, stretch=2), 5)
        self._found: Checked | None = None

    def show_check(self, found: Checked) -> None:
        """Show a comparison."""
        self._found = found
        self.words.setText(f"{found.name}: {judgement_of(found.check).verdict}")
        self.about.setText("" if found.check.fit is None else lattice_words(found.check.fit))
        marks = Symbols(found.described, "o", "#ffffff", 11), Symbols(found.centres, "+", "#ff5a5f", 9)
        self.image.set_shot(Shot(found.picture, name=found.name, step=found.step, overlays=marks), keep_view=False)
        # differences are largest in a corner
        side = LENSLETS * (found.check.fit.pitch_px if found.check.fit is not None else 30.0)
        side = min(side, found.step * max(found.picture.shape))
        self.image.show_part(-2, -2, side, side, padding=0)
        self._show()
        self._fill()

    def _show(self) -> None:
        if self._found is None:
            return
        name = self.choice.currentData()
        shown = self._found.maps.get(name)
        self.stack.setCurrentWidget(self.image if name == PICTURE else self.map)
        if shown is not None:
            self._draw(name, shown)
        elif name == PICTURE:
            self.legend.setText(LEGENDS[PICTURE])
        else:
            self.map.set_shot(None)
            fitted = self._found.check.fit is not None
            self.legend.setText(STRAIGHT if fitted else "No lattice was fitted.")

    def _draw(self, name: str, shown: LatticeMap) -> None:
        first = (shown.cell - 1) / 2
        top = max(shown.largest, 1e-3)
        pairs = np.asarray(shown.arrows, float).reshape(-1, 2, 2)
        arrows = tuple(Outline(pair, closed=False, width=1.2) for pair in pairs)
        shot = Shot(shown.size, "", "", name, (0.0, top), origin=(first, first), step=shown.cell, overlays=arrows)
        self.map.set_shot(shot, keep_view=False)
        drawn = f"; arrows magnified {shown.gain:.2g} times." if shown.largest else "."
        self.legend.setText(LEGENDS[name].format(largest=shown.largest) + drawn)

    def _fill(self) -> None:
        if self._found is None:
            return
        theme, lines = current_theme(), self._found.check.lines
        colours = {FITS: theme.good, DIFFERS: theme.fair, WRONG: theme.bad}
        rows = [
            (
                one.label[:1].upper() + one.label[1:],
                one.verdict,
                "" if one.edge_px is None else f"{one.edge_px:.2f}",
                typeset(one.expected),
                typeset(one.measured),
            )
            for one in lines
        ]
        off = [(0.0, 0.0, np.nan if one.edge_px is None else one.edge_px) for one in lines]
        self.table.show_rows(
            rows, off, lambda k, column: colours.get(lines[k].verdict, theme.muted) if column == 1 else ""
        )

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        self.image.apply_theme()
        self.map.apply_theme()
        self._fill()
