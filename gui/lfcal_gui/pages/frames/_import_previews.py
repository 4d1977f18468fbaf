"""First, middle and last of the frames, with their cutouts."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QHBoxLayout, QLabel, QStackedWidget, QVBoxLayout, QWidget

from lfcal_gui.jobs import Jobs
from lfcal_gui.models import Shot, cutout_of
from lfcal_gui.pages.frames.model_frame import Loaded
from lfcal_gui.widgets import Picture, heading

SHOWN = ("first frame", "middle frame", "last frame")
NONE = "no frame yet"
HEIGHT = 200
"""Pixels on the screen, at least: lower ones show axes only."""


class ImportPreviews(QWidget):
    """Three pictures side by side."""

    def __init__(self, jobs: Jobs, *, legend: bool = True) -> None:
        super().__init__()
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        self.views, self.labels, self.stacks = [], [], []
        for title in SHOWN:
            part, label, view = (
                QVBoxLayout(),
                heading(title),
                Picture("sample value (counts)", jobs=jobs, legend=legend),
            )
            view.setMinimumHeight(HEIGHT)
            empty, stack = QLabel(NONE), QStackedWidget()
            empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
            empty.setProperty("role", "hint")
            stack.addWidget(empty)
            stack.addWidget(view)
            self.views.append(view)
            self.labels.append(label)
            self.stacks.append(stack)
            part.addWidget(label)
            part.addWidget(stack, 1)
            row.addLayout(part)

    def show_frames(self, shown: tuple[Loaded, ...]) -> None:
        """Show up to three frames."""
        for k, view in enumerate(self.views):
            self._show_frame(k, view, shown[k] if k < len(shown) else None)

    def _show_frame(self, k: int, view: Picture, loaded: Loaded | None) -> None:
        label = self.labels[k]
        # axes around nothing would be read as a picture
        self.stacks[k].setCurrentIndex(0 if loaded is None else 1)
        if loaded is None:
            label.setText(SHOWN[k])
            view.set_shot(None)
            return
        z, y, x = loaded.position
        label.setText(f"{SHOWN[k]}: z {z}, y {y}, x {x}")
        label.setToolTip(loaded.label)
        row, column, rows, columns = loaded.window
        cutout = cutout_of(row, column, (rows, columns), loaded.point)
        view.set_shot(Shot(loaded.raw, name="frame", overlays=cutout), keep_view=False)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for view in self.views:
            view.apply_theme()
