"""The inspector of Set up: presets, the camera, the scan, and the comparison with a white image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QPushButton, QToolButton, QWidget

from lfcal.camera import NOISE, PRESETS, Camera, Microscope, ScanPlan
from lfcal_gui.pages.setup import model
from lfcal_gui.pages.setup.model_scan import BASIC_OF_SCAN, scan_fields, suggested_values
from lfcal_gui.pages.setup.model_scan import values_of as values_of_plan
from lfcal_gui.pages.setup.model_target import PlanSettings
from lfcal_gui.widgets import (
    ElidedLabel,
    FoldedForm,
    VerdictCard,
    WrappedLabel,
    button,
    card,
    choice_box,
    column_of,
    line,
    set_role,
    wrapped,
)

if TYPE_CHECKING:
    from lfcal.simulate import AssumedEffect

GROUPS = (
    ("Main optics", (*model.MAIN_LENS, *model.MICROSCOPE[1:])),
    ("Lenslet array", model.LATTICE),
    ("Sensor", model.SENSOR),
    ("Light", model.LIGHT),
)
FIELDS = {field.key: replace(field, group=title) for title, fields in GROUPS for field in fields}
ALL_VALUES = "All values of optics, lenslets, sensor and light, and their source"

MORE = "Anchor, stage axes, order, averages, half-cell scan and rates of the forecast; plan files and targets"

BUTTONS = {
    "import": ("Import …", "Read the camera from a file of a manufacturer or of another program"),
    "white": ("White image …", "Compare pitch, rotation and offset of the camera with a uniformly lit frame"),
    "confirm": (
        "Confirm all",
        "Confirm all assumed values. Numbers that depend on them are then no longer marked ≈",
    ),
    "sensor": ("Sensor …", "Measure gain, noise and saturation from flat and dark frames"),
    "dark": (
        "Dark frame …",
        "Choose a frame without light that is subtracted from white images, if the camera has a "
        "black level or hot pixels",
    ),
    "save": ("Save camera …", "Save this camera as JSON, for other projects and for commands (--camera)"),
    "make": ("Make a plan", "Derive planes, cutout and anchor from the geometry of the camera, as a starting point"),
    "open": ("Open a plan …", "Open a saved plan (.json) of a scan or of a target"),
    "again": ("Open …", "Replace this plan by a saved plan (.json) of a scan or of a target"),
    "save_plan": (
        "Save …",
        "Save this plan as JSON, for lfcal acquire and lfcal assemble, or its stage positions for another program",
    ),
    "default": ("Default", "Replace this plan by the plan derived from the geometry of the camera"),
    "target": (
        "Target of many points …",
        "Record many points in each frame, so that the same positions need far fewer frames",
    ),
    "take": ("Use measured lattice", "Use pitch, rotation and offset of the white image in the camera"),
    "details": ("Details …", "Show each value compared with the white image, and maps of the lattice"),
}
"""Key, title and tooltip of each button."""

HEADS = {
    "good": "✓ The white image agrees",
    "fair": "▲ The white image differs",
    "bad": "▲ The white image disagrees",
}
"""Headlines of the comparison with a white image."""


PRESET = "Start with a camera that comes with lfcal, and change what differs. Undo restores your camera"
SMALL = 18
"""Side of a check box (px)."""


class Inspector(QWidget):
    """Inspector of the page: a column of cards.

    Parameters
    ----------
    check, check_scan
        Return why a field of the camera, or of the scan, cannot take a value, or an empty string.
    """

    preset_chosen = Signal(str, arguments=["name"])
    """The user chose a preset."""
    edited, scan_edited = (
        Signal(str, object, arguments=["key", "value"]),
        Signal(str, object, arguments=["key", "value"]),
    )
    """The user changed a field of the camera or of the scan to a valid value."""
    confirmed = Signal(tuple, arguments=["paths"])
    """The user confirmed the values at these paths."""
    asked = Signal(str, arguments=["what"])
    """A button was pressed: its name in `BUTTONS`."""

    def __init__(self, check: Callable[[str, Any], str], check_scan: Callable[[str, Any], str]) -> None:
        super().__init__()
        self.buttons: dict[str, QPushButton] = {}
        self._suggested: Camera | None = None
        self._assumed: tuple[str, ...] = ()
        self.setProperty("dense", True)
        parts = (self._start(), self._camera(check), self._scan(check_scan), self._checks())
        column = column_of(*parts, of=self, spacing=6)
        column.setContentsMargins(0, 0, 4, 0)
        column.addStretch()

    def _button(self, name: str) -> QPushButton:
        text, tip = BUTTONS[name]
        made = self.buttons[name] = button(text, tip, lambda: self.asked.emit(name))
        made.setProperty("role", "tight")
        return made

    def _start(self) -> QWidget:
        frame, column = card("Start from")
        self.presets = choice_box((("", "Preset …"), *((name, name) for name in PRESETS)), PRESET, "preset")
        self.presets.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.presets.setMinimumContentsLength(7)
        self.presets.activated.connect(self._preset)
        column.addLayout(line(self._button("import"), self.presets, stretch=1))
        column.addLayout(line(self._button("white")))
        return frame

    def _preset(self, index: int) -> None:
        name = self.presets.itemData(index)
        self.presets.setCurrentIndex(0)  # a preset is a start, not a state: the camera may be changed afterwards
        if name:
            self.preset_chosen.emit(name)

    def _camera(self, check: Callable[[str, Any], str]) -> QWidget:
        frame, column = card("Camera")
        rest = tuple(field for key, field in FIELDS.items() if key not in model.BASIC)
        self.values = FoldedForm(tuple(FIELDS[key] for key in model.BASIC), rest, "All values", ALL_VALUES)
        self.values.check = check
        self.values.edited.connect(self.edited)
        self.values.confirmed.connect(lambda key: self.confirmed.emit((model.path_of(key),)))
        self.assumed_list = AssumedList()
        self.assumed_list.confirmed.connect(lambda path: self.confirmed.emit((path,)))
        assumed = QWidget()
        column_of(self.assumed_list, line(self._button("confirm"), self._button("sensor")), of=assumed)
        self.values.fold_line(assumed, above=True)
        self.values.fold_line(self._button("save"), self._button("dark"), above=True)
        column.addWidget(self.values)
        return frame

    def _scan(self, check: Callable[[str, Any], str]) -> QWidget:
        frame, column = card("Scan")
        every = scan_fields()
        rest = tuple(field for key, field in every.items() if key not in BASIC_OF_SCAN)
        basic = tuple(every[key] for key in BASIC_OF_SCAN)
        self.scan = FoldedForm(basic, rest, "Stage, order, targets", MORE)
        self.scan.check = check
        self.scan.edited.connect(self.scan_edited)
        for key in ("virtual_depths", "depths"):  # lists are read as a whole
            self.scan.own_line(key)
        self.refused = WrappedLabel()
        set_role(self.refused, "error")
        self.no_plan = QWidget()
        hint = wrapped("hint", "The plan lists the positions of the point source. lfcal derives it from the camera.")
        column_of(hint, line(self._button("make"), self._button("open")), of=self.no_plan)
        for part in (self.no_plan, self.scan, self.refused):
            column.addWidget(part)
        self.scan.fold_line(self._button("again"), self._button("save_plan"), self._button("default"))
        self.scan.fold_line(self._button("target"))
        return frame

    def _checks(self) -> QWidget:
        self.check_card = VerdictCard(BUTTONS["details"][1])
        self.buttons["details"] = self.check_card.why
        self.check_card.why.setText(BUTTONS["details"][0])
        self.check_card.why_asked.connect(lambda: self.asked.emit("details"))
        holder = QWidget()
        column_of(self.check_card, line(self._button("take")), of=holder)
        self.show_verdict("", "")
        return holder

    # -- showing ---------------------------------------------------------------------------------------
    def show_camera(self, camera: Camera) -> None:
        """Show the values of a camera and their sources."""
        values = model.values_of(camera)
        marks = {key: model.mark_of(camera, key) for key in values}
        self.values.set_state(values, {key: (mark, model.TIPS[mark]) for key, mark in marks.items()})
        self._assumed = camera.marks.paths("assumed")
        self.values.head.name(f"All {len(values)} values")
        self.buttons["confirm"].setEnabled(bool(self._assumed))

    def show_effects(self, effects: tuple[AssumedEffect, ...]) -> None:
        """Show the assumed values with the effects of an error; without ``effects``, show only their names."""
        known = {one.path: one.words for one in effects}
        if known:
            known |= {path: "noise of H" for path in NOISE if path in self._assumed}
        order = sorted(self._assumed, key=lambda path: list(known).index(path) if path in known else len(known))
        self.assumed_list.show_values(
            [(path, model.name_at(path)[:1].upper() + model.name_at(path)[1:], known.get(path, "")) for path in order]
        )

    @property
    def assumed(self) -> tuple[str, ...]:
        """Paths of the assumed values."""
        return self._assumed

    def show_plan(self, plan: ScanPlan | None, settings: PlanSettings, refused: str) -> None:
        """Show the values of a plan, and why a half-cell scan is ``refused`` (empty: it is possible)."""
        self.no_plan.setVisible(plan is None)
        self.scan.setVisible(plan is not None)
        self.refused.setText(refused)
        self.refused.setVisible(bool(refused))
        if plan is not None:
            if plan.camera != self._suggested:
                self._suggested = plan.camera
                self.scan.set_defaults(suggested_values(plan.camera))
            microscope = isinstance(plan.camera.optics, Microscope)
            self.scan.set_folded("virtual_depths", microscope)  # one of two ways to name the planes is enough
            self.scan.set_folded("depths", not microscope)
            self.scan.set_values({**settings.shown(), **values_of_plan(plan)})

    def show_verdict(self, merit: str, words: str, *, found: bool = False, measured: bool = False) -> None:
        """Show whether a white image agrees; ``found``: details exist, ``measured``: its lattice can be used."""
        self.check_card.show_verdict(merit, words, HEADS.get(merit, "White image"))
        self.check_card.setVisible(bool(words))
        self.buttons["details"].setVisible(found)
        self.buttons["take"].setVisible(measured)


class AssumedList(QWidget):
    """List of assumed values with the effect of an error, and a check box to confirm each."""

    confirmed = Signal(str, arguments=["path"])
    """The user confirmed the value at this path of the description."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[tuple[str, str, str]] = []
        self.ticks: dict[str, QToolButton] = {}
        self.grid = QGridLayout(self)
        self.grid.setContentsMargins(0, 0, 0, 0)
        self.grid.setHorizontalSpacing(6)
        self.grid.setVerticalSpacing(2)
        self.grid.setColumnStretch(0, 1)
        self.hide()

    def show_values(self, rows: list[tuple[str, str, str]]) -> None:
        """Show values in their order, as path, name, and effect of an error."""
        if rows == self.rows:
            return
        self.rows = rows
        while (item := self.grid.takeAt(0)) is not None:
            if (old := item.widget()) is not None:
                old.deleteLater()
        self.ticks = {}
        for at, (path, label, words) in enumerate(rows):
            name, effect, tick = ElidedLabel(), QLabel(words), QToolButton()
            name.setText(label)
            effect.setProperty("role", "hint")
            effect.setToolTip("Effect on the scan if the true value is at the end of its plausible range")
            tick.setText("✓")
            tick.setFixedSize(SMALL, SMALL)
            tick.setProperty("role", "mark")
            tick.setProperty("mark", "assumed")
            tick.setAccessibleName(f"Confirm {label}")
            tick.setToolTip(model.TIPS["assumed"])
            tick.clicked.connect(lambda _=False, path=path: self.confirmed.emit(path))
            self.ticks[path] = tick
            for column, part in enumerate((name, effect, tick)):
                self.grid.addWidget(part, at, column)
        self.setVisible(bool(rows))
