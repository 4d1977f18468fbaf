"""Record > Folder: how they are corrected, how their positions are found, how they are cut."""

from __future__ import annotations

from PySide6.QtCore import QRegularExpression, QSignalBlocker, Signal
from PySide6.QtGui import QRegularExpressionValidator
from PySide6.QtWidgets import QCheckBox, QComboBox, QFormLayout, QHBoxLayout, QLineEdit, QVBoxLayout, QWidget

from lfcal.tasks import Assemble
from lfcal_gui.models import check_of, fields_of, shown_of
from lfcal_gui.pages.frames.model import CORRECTIONS, HELD, WAYS, FrameSettings
from lfcal_gui.pages.frames.orientation import CHOICES
from lfcal_gui.widgets import Folded, Form, choice_box, heading

__all__ = ["FrameChoices"]

TITLE = "How the frames are read"

DARK_TIP, WHITE_TIP = CORRECTIONS[0][2], CORRECTIONS[1][2]


class FrameChoices(QWidget):
    """The settings of the frames.

    Signals
    -------
    correction_toggled(setting, on)
        One of `lfcal_gui.pages.frames.model.CORRECTIONS`, or ``skip_damaged``.
    setting_chosen(setting, value)
        How positions are found in file names or a manifest, and how cutouts between pixels are taken.
    option_edited(name, value)
        Another field of `lfcal.tasks.Assemble`.
    """

    correction_toggled = Signal(str, bool)
    setting_chosen = Signal(str, str)
    option_edited = Signal(str, object)

    def __init__(self) -> None:
        super().__init__()
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        self.fold = Folded(TITLE, "Corrections, positions in names and lists, and all other settings of H")
        outer.addWidget(self.fold)
        column = self.fold.column
        column.addWidget(heading("Corrections"))
        column.addLayout(self._corrections())
        column.addWidget(heading("Positions and cutout"))
        column.addLayout(self._reading())
        column.addWidget(heading("H"))
        self.options = Form(fields_of(Assemble, without=HELD), dense=True)
        self.options.check = check_of(Assemble)
        self.options.edited.connect(self.option_edited.emit)
        column.addWidget(self.options)

    def _corrections(self) -> QHBoxLayout:
        self.boxes: dict[str, QCheckBox] = {}
        grid = QHBoxLayout()
        for pair in (CORRECTIONS[:2], CORRECTIONS[2:]):
            part = QVBoxLayout()
            for key, text, tip in pair:
                box = QCheckBox(text)
                box.setToolTip(tip)
                box.toggled.connect(lambda on, key=key: self.correction_toggled.emit(key, on))
                self.boxes[key] = box
                part.addWidget(box)
            grid.addLayout(part)
        return grid

    def _origin_edit(self) -> QLineEdit:
        edit = QLineEdit()
        edit.setPlaceholderText("whole sensor, or row,column")
        # what is no place is not taken: the edit does not finish
        edit.setValidator(QRegularExpressionValidator(QRegularExpression(r"(\s*\d{1,6}\s*,\s*\d{1,6}\s*)?")))
        edit.setToolTip("Of frames that are a part of the sensor: sensor row and column of their first pixel")
        edit.setAccessibleName("first pixel")
        edit.editingFinished.connect(lambda: self.setting_chosen.emit("origin", edit.text().strip()))
        return edit

    def _reading(self) -> QFormLayout:
        self.pattern, self.manifest = QLineEdit(), QLineEdit()
        self.pattern.setPlaceholderText("z{z}_y{y}_x{x}.png")
        self.pattern.setToolTip("Where the position stands in file names, for folders without a manifest")
        self.manifest.setPlaceholderText("found with the frames")
        self.manifest.setToolTip("A manifest that lies elsewhere: file, z, y, x, and exposure where it differs")
        for key, edit in (("pattern", self.pattern), ("manifest", self.manifest)):
            edit.setAccessibleName({"pattern": "file names"}.get(key, key))
            edit.editingFinished.connect(lambda key=key, edit=edit: self.setting_chosen.emit(key, edit.text().strip()))
        self.origin = self._origin_edit()
        self.interpolation = choice_box(WAYS, "How a cutout that lies between pixels is taken")
        self.interpolation.setAccessibleName("interpolation")
        self.interpolation.currentIndexChanged.connect(
            lambda _: self.setting_chosen.emit("interpolation", self.interpolation.currentData())
        )
        self.skip_damaged = QCheckBox("left out of H")
        self.skip_damaged.setAccessibleName("leave out damaged frames")
        self.skip_damaged.setToolTip(
            "Frames that cannot be read do not stand in the way of H, which lacks their positions; "
            "every frame is read once for it when they are opened"
        )
        self.skip_damaged.toggled.connect(lambda on: self.correction_toggled.emit("skip_damaged", on))
        self.orientation = choice_box(CHOICES, "What makes the frames upright: rows and columns as the plan has them")
        self.orientation.setAccessibleName("orientation")
        # the panel is narrower than the words
        self.orientation.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.orientation.setMinimumContentsLength(12)
        self.orientation.currentIndexChanged.connect(
            lambda _: self.setting_chosen.emit("orientation", self.orientation.currentData())
        )
        form = QFormLayout()
        form.addRow("File names", self.pattern)
        form.addRow("Manifest", self.manifest)
        form.addRow("Interpolation", self.interpolation)
        form.addRow("Orientation", self.orientation)
        form.addRow("First pixel", self.origin)
        form.addRow("Damaged", self.skip_damaged)
        return form

    def show_settings(self, settings: FrameSettings) -> None:
        """Show the settings; a white image is needed to divide by one."""
        for key, box in (*self.boxes.items(), ("skip_damaged", self.skip_damaged)):
            blocker = QSignalBlocker(box)
            box.setChecked(getattr(settings, key))
            blocker.unblock()
        self.boxes["use_white"].setEnabled(bool(settings.white))
        self.boxes["use_white"].setToolTip(WHITE_TIP if settings.white else f"{WHITE_TIP}; no folder of them was found")
        edits = (self.pattern, self.manifest, self.interpolation, self.orientation, self.origin)
        blockers = [QSignalBlocker(w) for w in edits]
        self.pattern.setText(settings.pattern)
        self.manifest.setText(settings.manifest)
        self.interpolation.setCurrentIndex(self.interpolation.findData(settings.interpolation))
        self.origin.setText(settings.origin)
        self.orientation.setCurrentIndex(self.orientation.findData(settings.orientation))
        for one in blockers:
            one.unblock()
        changed = settings.changed
        self.fold.head.setText(f"{TITLE}: {changed} changed" if changed else TITLE)
        shown = shown_of(Assemble, settings.option_values)
        self.options.set_values({key: shown[key] for key in self.options.fields})

    def show_positions(self, words: str) -> None:
        """Say where positions come from while no manifest is named."""
        self.manifest.setPlaceholderText(words)

    def show_dark(self, words: str, *, wanted: bool) -> None:
        """Say what is subtracted as no light; where nothing was found, the choice is none."""
        box, there = self.boxes["use_dark"], bool(words) or not wanted
        blocker = QSignalBlocker(box)
        box.setChecked(wanted and there)
        blocker.unblock()
        box.setEnabled(there)
        found = f"Subtracted now: {words}" if words else "" if there else "No dark frame was found, nor a black level"
        box.setToolTip(f"{DARK_TIP}. {found}".rstrip(". "))
