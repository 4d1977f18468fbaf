"""Where the stage is, jogging it, and going to a plane."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import (
    QComboBox,
    QDoubleSpinBox,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from gui.widgets.cards import card, line
from lfcal.units import format_length

__all__ = ["StagePanel"]

Limits = tuple[tuple[float, float], ...]


class StagePanel(QWidget):
    """Position, limits and jog buttons.

    Signals
    -------
    jogged(axis, um)
        Move axis 0, 1, 2 (x, y, z) by so many µm.
    plane_asked(z)
        Go to the middle of the cell in depth plane z.
    stop_asked()
        Stop the move under way.
    """

    jogged = Signal(int, float)
    plane_asked = Signal(int)
    stop_asked = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.values: list[QLabel] = []
        self.buttons: list[QPushButton] = []
        frame, column = card("Stage")
        column.addLayout(self._jog_grid())
        column.addLayout(self._step_line())
        column.addLayout(self._plane_line())
        self.limits = QLabel("")
        self.limits.setProperty("role", "hint")
        self.limits.setWordWrap(True)
        self.limits.setToolTip("Soft limits: checked before anything moves")
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
        self.step.setToolTip("How far a press of − or + moves the stage")
        self.stop = QPushButton("Stop")
        self.stop.setToolTip("Stop the move under way")
        self.stop.clicked.connect(lambda: self.stop_asked.emit())
        return line("Step", self.step, self.stop, stretch=1)

    def _plane_line(self) -> QHBoxLayout:
        self.plane = QComboBox()
        self.plane.setToolTip("A depth plane of the plan; the middle of the representative cell")
        self.plane.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.go = QPushButton("Go")
        self.go.setToolTip("Move to the middle of the cell in this plane")
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
        if limits is None:
            self.limits.setText("")
            return
        words = [f"{n} {format_length(lo)} … {format_length(hi)}" for n, (lo, hi) in zip("xyz", limits, strict=True)]
        self.limits.setText("Limits<br>" + "<br>".join(words))

    def set_position(self, stage_um: tuple[float, float, float]) -> None:
        """Show where the stage is (µm)."""
        for label, value in zip(self.values, stage_um, strict=True):
            label.setText(f"{value:,.2f} µm".replace(",", "\N{THIN SPACE}"))

    def set_free(self, free: bool) -> None:
        """Allow moving, or not."""
        for button in (*self.buttons, self.go):
            button.setEnabled(free)
