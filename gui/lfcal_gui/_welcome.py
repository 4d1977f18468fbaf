"""Welcome dialog, and the project of the sample session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QCheckBox, QDialog, QHBoxLayout, QLabel, QListWidget, QPushButton, QVBoxLayout, QWidget

from lfcal.base import Work
from lfcal.camera import ScanPlan
from lfcal_gui.models import ProjectState
from lfcal_gui.theme import style_sheet
from lfcal_gui.widgets import button, heading, line

WORDS = (
    "lfcal measures the point spread function of a plenoptic camera: describe the camera, "
    "plan a scan, record it or import frames, assemble H, judge it, fit the optics and "
    "reconstruct volumes. The buttons on the left follow this order."
)
STARTS = (
    ("sample", "Open the sample session", "A small recorded session: frames, dark and white frames, assembled into H"),
    ("new", "Describe a camera", "Begin with a preset, a Raytrix file or a white image of the camera"),
    ("open", "Open a project …", "A saved project (.lfcal)"),
)
SIZE = (560, 420)


class Welcome(QDialog):
    """Dialog with ways to start, and recent projects."""

    chosen = Signal(str, arguments=["key"])
    """Key of the chosen entry of `STARTS`."""
    project_chosen = Signal(str, arguments=["path"])
    """A recent project was chosen."""
    kept = Signal(bool, arguments=["on"])
    """The user chose whether to show this dialog at the next start."""

    def __init__(self, recent: list[Path], shown: bool, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setWindowTitle("Welcome")
        self.setStyleSheet(style_sheet())
        self.resize(*SIZE)
        title, words = QLabel("Welcome to lfcal"), QLabel(WORDS)
        title.setProperty("role", "title")
        words.setWordWrap(True)
        column = QVBoxLayout(self)
        column.setSpacing(10)
        column.addWidget(title)
        column.addWidget(words)
        self.buttons: dict[str, QPushButton] = {}
        for key, text, tip in STARTS:
            one = button(text, tip)
            one.setAccessibleDescription(tip)
            one.clicked.connect(lambda _=False, key=key: self._choose(key))
            self.buttons[key] = one
            column.addWidget(one)
        self.buttons["sample"].setProperty("role", "primary")
        column.addWidget(heading("Recent projects"))
        self.list = QListWidget()
        self.list.setAccessibleName("Recent projects")
        self.list.setToolTip("Press Enter or double-click to open a project")
        self.list.addItems([str(path) for path in recent])
        self.list.itemActivated.connect(lambda item: self._open(item.text()))
        self.none = QLabel("No recent projects")
        self.none.setProperty("role", "hint")
        self.list.setVisible(bool(recent))
        self.none.setVisible(not recent)
        column.addWidget(self.list, 1)
        column.addWidget(self.none, 1, Qt.AlignmentFlag.AlignTop)
        column.addLayout(self._last_line(shown))

    def _last_line(self, shown: bool) -> QHBoxLayout:
        self.box, close = QCheckBox("Show at startup"), QPushButton("Close")
        self.box.setToolTip(
            "Untick to start with an empty project. Preferences > Show the welcome dialog at startup shows it again"
        )
        close.setToolTip("Close this dialog. Help > Welcome opens it again")
        self.box.setChecked(shown)
        self.box.toggled.connect(self.kept.emit)
        close.clicked.connect(self.close)
        return line(self.box, QWidget(), close, stretch=1)

    def _choose(self, key: str) -> None:
        self.close()
        self.chosen.emit(key)

    def _open(self, path: str) -> None:
        self.close()
        self.project_chosen.emit(path)


def iter_demo(folder: Path) -> Work[ProjectState]:
    """Return a project of the sample session with its H, which is kept in ``folder`` for the next start."""
    from lfcal.simulate import sample_session
    from lfcal_gui.pages.frames import FrameSettings

    session = sample_session()
    plan = ScanPlan.from_json((session / "plan.json").read_text(encoding="utf-8"))
    target = folder / "sample_H.h5"
    if not target.is_file():
        yield from _assemble(session, plan, target)
    corrections = FrameSettings(dark=str(session / "dark"), white=str(session / "white"))
    made = ProjectState("sample", plan.camera, plan, frames=str(session / "frames"), psf=str(target))
    return replace(made, settings=corrections.into(made))


def _assemble(session: Path, plan: ScanPlan, target: Path) -> Work[None]:
    from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    from lfcal.psf import iter_assemble_plan

    with open_frames(session / "frames", plan_shape=plan.shape[:3]) as source:
        recipe = CorrectionRecipe(dark=session / "dark", white=session / "white")
        report = yield from iter_assemble_plan(corrected_view(source, recipe, plan), plan, target)
    report.matrix.close()
