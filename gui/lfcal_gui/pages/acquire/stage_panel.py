"""Where the stage is, jogging it, and going to a plane."""

from __future__ import annotations

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from lfcal.base import format_length
from lfcal_gui.widgets import card, heading, line

__all__ = ["StagePanel"]

Limits = tuple[tuple[float, float], ...]


class StagePanel(QWidget):
    """Position, limits and jog buttons.

    Signals
    -------
    jogged(axis, um)
        Move axis 0, 1, 2 (x, y, z) by so many µm.
    target_asked(words)
        Go to the position that was typed.
    plane_asked(z)
        Go to the middle of the cell in depth plane z.
    stop_asked()
        Stop the move under way.
    """

    jogged = Signal(int, float)
    target_asked = Signal(str)
    plane_asked = Signal(int)
    stop_asked = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.values: list[QLabel] = []
        self.buttons: list[QPushButton] = []
        frame, column = card()
        self.motion = QLabel("")
        self.motion.setProperty("role", "hint")
        self.motion.setToolTip("Whether the stage moves; its position is read several times a second")
        column.addLayout(line(heading("Stage"), self.motion))
        column.addLayout(self._jog_grid())
        column.addLayout(self._step_line())
        column.addLayout(self._target_line())
        column.addLayout(self._plane_line())
        self.refusal = QLabel("")
        self.refusal.setProperty("role", "error")
        self.refusal.setWordWrap(True)
        self.refusal.hide()
        column.addWidget(self.refusal)
        self.limits = QLabel("")
        self.limits.setProperty("role", "hint")
        self.limits.setWordWrap(True)
        self.limits.setToolTip("Soft limits: checked before anything moves")
        self.limits.hide()
        column.addWidget(self.limits)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(frame)

    # -- building --------------------------------------------------------------------------------------
    def _jog_grid(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setHorizontalSpacing(4)
        grid.setVerticalSpacing(4)
        for axis, name in enumerate("xyz"):
            value = QLabel("–")
            value.setProperty("role", "value")
            self.values.append(value)
            grid.addWidget(QLabel(name), axis, 0)
            grid.addWidget(value, axis, 1)
            for sign, text, place in ((-1, "−", 2), (1, "+", 3)):
                button = QPushButton(f"{text}{name}")
                button.setFixedWidth(44)
                button.setToolTip(f"Move {name} by one step in the {'negative' if sign < 0 else 'positive'} sense")
                button.setAutoRepeat(False)
                button.clicked.connect(lambda _=False, a=axis, s=sign: self.jogged.emit(a, s * self.step.value()))
                self.buttons.append(button)
                grid.addWidget(button, axis, place)
        grid.setColumnStretch(1, 1)
        return grid

    def _step_line(self) -> QHBoxLayout:
        self.step = QDoubleSpinBox()
        self.step.setRange(0.01, 1e6)
        self.step.setDecimals(2)
        self.step.setValue(100.0)
        self.step.setMinimumWidth(60)
        self.step.setSuffix(" µm")
        self.step.setStepType(QDoubleSpinBox.StepType.AdaptiveDecimalStepType)
        self.step.setAccessibleName("step of the stage")
        self.step.setToolTip("How far a press of − or + moves the stage: large to find the image, small to centre it")
        self.stop = QPushButton("Stop")
        self.stop.setToolTip("Halt the stage now, where it is (Esc)")
        self.stop.clicked.connect(lambda: self.stop_asked.emit())
        return line("Step", self.step, self.stop, stretch=1)

    def _target_line(self) -> QHBoxLayout:
        self.target = QLineEdit()
        self.target.setPlaceholderText("x, y, z")
        self.target.setAccessibleName("position to go to (µm)")
        self.target.setToolTip(
            "Position in µm, such as 100, -20, 1500; an axis left empty stays, as in , , 1500 (Ctrl+G, then Enter)"
        )
        self.target.setMinimumWidth(60)
        self.target.returnPressed.connect(self._go_to)
        self.move = QPushButton("Move")
        self.move.setToolTip("Go to this position; the limits are checked before anything moves")
        self.move.clicked.connect(self._go_to)
        return line("To (µm)", self.target, self.move, stretch=1)

    def _go_to(self) -> None:
        if self.move.isEnabled():
            self.target_asked.emit(self.target.text())

    def _plane_line(self) -> QHBoxLayout:
        self.plane = QComboBox()
        self.plane.setAccessibleName("depth plane to go to")
        self.plane.setToolTip("A depth plane of the plan: Go leads to the middle of its representative cell")
        self.plane.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.go = QPushButton("Go")
        self.go.setToolTip("Move there, to see whether image and cutout are where the plan expects them")
        self.go.clicked.connect(lambda: self.plane_asked.emit(self.plane.currentIndex()))
        return line("Plane", self.plane, self.go, stretch=1)

    # -- showing ---------------------------------------------------------------------------------------
    def set_planes(self, depths_um: tuple[float, ...]) -> None:
        """Offer the depth planes of a plan."""
        chosen = self.plane.currentIndex()
        self.plane.clear()
        for z, depth in enumerate(depths_um):
            self.plane.addItem(f"{z}: z = {format_length(depth)}", z)
        self.plane.setCurrentIndex(min(max(chosen, 0), self.plane.count() - 1))

    def set_limits(self, limits: Limits | None) -> None:
        """Show the travel of each axis (µm)."""
        self.limits.setVisible(limits is not None)
        if limits is None:
            self.limits.setText("")
            return
        words = [f"{name} {_travel(*ends)}" for name, ends in zip("xyz", limits, strict=True)]
        self.limits.setText(f"Limits {', '.join(words)}")

    def set_position(self, stage_um: tuple[float, float, float]) -> None:
        """Show where the stage is (µm)."""
        for label, value in zip(self.values, stage_um, strict=True):
            label.setText(f"{value:,.2f} µm".replace(",", "\N{THIN SPACE}"))

    def show_motion(self, words: str) -> None:
        """Show what the stage does, in a place that is kept for it."""
        self.motion.setText(words)

    def say(self, words: str) -> None:
        """Say why the stage does not go where it was to; empty: it does."""
        self.refusal.setText(words)
        self.refusal.setVisible(bool(words))

    def press(self, axis: int, sign: int) -> None:
        """Move an axis by one step, as its button does."""
        self.buttons[2 * axis + (sign > 0)].click()

    def type_target(self) -> None:
        """Take the keyboard for a position to go to."""
        self.target.setFocus(Qt.FocusReason.ShortcutFocusReason)
        self.target.selectAll()

    def set_free(self, free: bool) -> None:
        """Allow moving, or not."""
        for button in (*self.buttons, self.go, self.move):
            button.setEnabled(free)


def _travel(low: float, high: float) -> str:
    """Return how far an axis goes, its unit once, so that three of them are two lines."""
    (first, unit), (last, other) = (format_length(end).split(" ") for end in (low, high))
    return f"{first} … {last} {unit}" if unit == other else f"{first} {unit} … {last} {other}"
