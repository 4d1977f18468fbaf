"""First, middle and last of the frames that are to be imported, with their cutouts."""

from __future__ import annotations

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QHBoxLayout, QLabel, QStackedLayout, QVBoxLayout, QWidget

from lfcal_gui.jobs import Jobs
from lfcal_gui.pages.frames.model_frame import Loaded
from lfcal_gui.widgets import FrameView, heading

__all__ = ["ImportPreviews"]

SHOWN = ("first frame", "middle frame", "last frame")
NONE = "no frame yet"
HEIGHT = 200
"""Pixels on the screen, at least: lower ones show axes only."""


class ImportPreviews(QWidget):
    """Three pictures side by side."""

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        self.views, self.labels, self.stacks = [], [], []
        for k, title in enumerate(SHOWN):
            part, label, view = QVBoxLayout(), heading(title), FrameView(jobs, f"frames import {k}")
            view.setMinimumHeight(HEIGHT)
            empty, stack = QLabel(NONE), QStackedLayout()
            empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
            empty.setProperty("role", "hint")
            stack.addWidget(empty)
            stack.addWidget(view)
            self.views.append(view)
            self.labels.append(label)
            self.stacks.append(stack)
            part.addWidget(label)
            part.addLayout(stack, 1)
            row.addLayout(part)

    def show_frames(self, shown: tuple[Loaded, ...]) -> None:
        """Show up to three frames."""
        for k, view in enumerate(self.views):
            self._show_frame(k, view, shown[k] if k < len(shown) else None)

    def _show_frame(self, k: int, view: FrameView, loaded: Loaded | None) -> None:
        label = self.labels[k]
        # axes around nothing would be read as a picture
        self.stacks[k].setCurrentIndex(0 if loaded is None else 1)
        if loaded is None:
            label.setText(SHOWN[k])
            view.set_frame(None, (0, 1))
            view.clear_cutout()
            return
        z, y, x = loaded.position
        label.setText(f"{SHOWN[k]}: z {z}, y {y}, x {x}")
        label.setToolTip(loaded.label)
        view.set_frame(loaded.raw, (float(loaded.raw.min()), float(loaded.raw.max())))
        row, column, rows, columns = loaded.window
        view.set_cutout(row, column, (rows, columns), loaded.point)
        view.show_all()

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        for view in self.views:
            view.apply_theme()
