"""A sensor frame of one position, as the simulated camera records it; it can be saved."""

from __future__ import annotations

from pathlib import Path

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QLabel, QPushButton, QVBoxLayout, QWidget

from lfcal_gui.jobs import Jobs
from lfcal_gui.models import Shot, cutout_of
from lfcal_gui.pages.simulate.model_frames import SimulatedFrame, write_frame
from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.widgets import Picture, line


class FramePanel(QWidget):
    """A simulated frame with its caption, and the buttons that make and save it.

    Signals
    -------
    frame_asked()
        The user wants a frame of the selected position.
    """

    frame_asked = Signal()

    def __init__(self, jobs: Jobs) -> None:
        super().__init__()
        self.frame: SimulatedFrame | None = None
        self.make_button = QPushButton("Make a frame")
        self.make_button.setToolTip("A sensor frame of the position below, with every effect on for frames")
        self.make_button.clicked.connect(lambda _=False: self.frame_asked.emit())
        self.save_button = QPushButton("Save …")
        self.save_button.setToolTip("Save the samples as TIFF or PNG")
        self.save_button.setEnabled(False)
        self.save_button.clicked.connect(lambda _=False: self.save())
        self.words = QLabel("A frame has every effect that is on for frames: noise, stage errors, rounding.")
        self.words.setWordWrap(True)
        self.words.setProperty("role", "hint")
        self.view = Picture("counts", jobs=jobs)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 6, 0, 0)
        column.addLayout(line(self.make_button, self.save_button))
        column.addWidget(self.view, 1)
        column.addWidget(self.words)

    def show_waiting(self) -> None:
        """Say that a frame is being made."""
        self.words.setText("The frame is being made …")
        self.make_button.setEnabled(False)

    def show_frame(self, frame: SimulatedFrame | None, words: str = "") -> None:
        """Show a frame and the position's cutout in it; None leaves what is there and says why."""
        self.make_button.setEnabled(True)
        if frame is None:
            self.words.setText(words)
            return
        self.frame = frame
        self.save_button.setEnabled(True)
        top, left = frame.window()
        nt, ns = frame.question.plan.cutout
        cutout = cutout_of(top, left, (nt, ns), (top + nt // 2, left + ns // 2))
        self.view.set_shot(Shot(frame.samples, name="frame", overlays=cutout))
        self.words.setText(frame.words())

    def show_none(self) -> None:
        """Take away a frame of another plan, or of other choices."""
        self.frame = None
        self.make_button.setEnabled(True)
        self.save_button.setEnabled(False)
        self.view.set_shot(None)
        self.words.setText("Plan or choices changed since a frame was made: make another one.")

    def save(self, path: str = "") -> None:
        """Write the samples of the frame."""
        frame = self.frame
        if frame is None:
            return
        path = path or ask_target(self, "Save frame", "frame.tif", "TIFF (*.tif);;PNG (*.png)")
        if path:
            write_file(self, path, lambda part: write_frame(frame, Path(path), part))

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.view.apply_theme()
