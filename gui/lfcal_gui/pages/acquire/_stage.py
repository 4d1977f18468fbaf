"""Position of the stage, and moves by steps, to a typed position, or to a depth plane."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtGui import QFocusEvent, QKeyEvent, QWheelEvent
from PySide6.QtWidgets import QDoubleSpinBox, QGridLayout, QLabel, QWidget

from lfcal.base import LfcalError, format_length
from lfcal_gui.context import Context
from lfcal_gui.pages.acquire.model import target_of
from lfcal_gui.pages.acquire.model_station import Station, read_target
from lfcal_gui.widgets import button, column_of, heading, line, wrapped

Limits = tuple[tuple[float, float], ...]
HOW = "Type a position and press Return, or press ↑ and ↓ in a field. Esc stops."
FARTHEST_UM = 1e9
"""Largest position that can be typed (µm); limits of the stage are checked at each move."""


class _AxisField(QDoubleSpinBox):
    """Position of one axis (µm): arrows move by a step, Return moves to the typed position."""

    stepped, asked = Signal(int, arguments=["steps"]), Signal(float, arguments=["um"])
    """Requests to move by a number of steps, and to move to a position."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._typed, self._um = False, -FARTHEST_UM
        self.setRange(-FARTHEST_UM, FARTHEST_UM)
        self.setSpecialValueText("–")
        self.setValue(self._um)
        self.setSuffix(" µm")
        self.setMinimumWidth(90)
        self.setAccessibleName(f"Position {name} of the stage (µm)")
        self.lineEdit().textEdited.connect(self._edited)

    def _edited(self) -> None:
        self._typed = True

    def show_position(self, um: float) -> None:
        """Show the position of the axis, unless another one is being typed; NaN: unknown."""
        self._um = self.minimum() if math.isnan(um) else um
        if not self._typed:
            self.setValue(self._um)

    def stepBy(self, steps: int) -> None:
        """Move by steps of the stage instead of changing the last digit."""
        self.stepped.emit(steps)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Move to the typed position (Return), or discard it (Esc)."""
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.interpretText()
            self._typed = False
            if self.value() > self.minimum():
                self.asked.emit(self.value())
            return
        if event.key() == Qt.Key.Key_Escape:
            self._forget()
        super().keyPressEvent(event)

    def focusOutEvent(self, event: QFocusEvent) -> None:
        """Discard text that was not confirmed with Return, so that a click elsewhere never moves the stage."""
        super().focusOutEvent(event)
        self._forget()

    def wheelEvent(self, event: QWheelEvent) -> None:
        """Ignore the mouse wheel, so that it never moves the stage."""
        event.ignore()

    def _forget(self) -> None:
        self._typed = False
        self.setValue(self._um)


class StagePanel(QWidget):
    """Panel with position, limits and moves of the stage."""

    jogged = Signal(int, float, arguments=["axis", "um"])
    """Request to move axis 0, 1 or 2 (x, y, z) by a distance (µm)."""
    target_asked = Signal(str, arguments=["words"])
    """Request to move to the typed position."""
    stop_asked = Signal()
    """Request to stop the running move."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.motion = QLabel("")
        self.motion.setProperty("role", "hint")
        self.motion.setToolTip("State of the stage. Its position is read several times a second")
        self.stop = button("Stop", "Halt the stage now, where it is (Esc)", self.stop_asked.emit)
        self.stop.hide()
        head = line(heading("Stage"), self.stop, self.motion, stretch=0)
        head.addStrut(26)
        self.refusal, self.hint = wrapped("error"), wrapped("hint", HOW)
        self.refusal.hide()
        column_of(head, self._axes(), self.refusal, self.hint, of=self, spacing=4)
        self.set_limits(None)

    # -- building --------------------------------------------------------------------------------------
    def _axes(self) -> QGridLayout:
        grid = QGridLayout()
        grid.setVerticalSpacing(4)
        self.fields: list[_AxisField] = []
        for axis, name in enumerate("xyz"):
            field = _AxisField(name)
            field.stepped.connect(lambda steps, axis=axis: self.jogged.emit(axis, steps * self.step.value()))
            field.asked.connect(
                lambda um, axis=axis: self.target_asked.emit(", " * axis + f"{um!r}" + ", " * (2 - axis))
            )
            self.fields.append(field)
            grid.addWidget(QLabel(name), axis, 0)
            grid.addWidget(field, axis, 1)
        grid.setColumnStretch(1, 1)
        self.step = QDoubleSpinBox()
        self.step.setRange(0.01, 1e6)
        self.step.setValue(100.0)
        self.step.setMinimumWidth(60)
        self.step.setSuffix(" µm")
        self.step.setStepType(QDoubleSpinBox.StepType.AdaptiveDecimalStepType)
        self.step.setAccessibleName("Step of the stage")
        self.step.setToolTip("Distance of one step with an arrow: large to find the image, small to centre it")
        grid.addWidget(QLabel("Step"), 3, 0)
        grid.addWidget(self.step, 3, 1)
        return grid

    # -- showing ---------------------------------------------------------------------------------------
    def set_limits(self, limits: Limits | None) -> None:
        """Show the travel of each axis (µm). None: unknown."""
        for k, (name, field) in enumerate(zip("xyz", self.fields, strict=True)):
            travel = "" if limits is None else f", {format_length(limits[k][0])} to {format_length(limits[k][1])}"
            field.setToolTip(f"Position {name}{travel}. Type a value and press Return, or move by a step with ↑ and ↓")

    def set_position(self, stage_um: tuple[float, float, float]) -> None:
        """Show the position of the stage (µm); NaN: unknown."""
        for field, value in zip(self.fields, stage_um, strict=True):
            field.show_position(value)

    def show_motion(self, words: str, *, moving: bool = False) -> None:
        """Show the state of the stage, and the stop button while the stage moves."""
        self.motion.setText(words)
        self.stop.setVisible(moving)

    def say(self, words: str) -> None:
        """Show why the stage does not move to the requested position; empty: it does."""
        self.refusal.setText(words)
        self.refusal.setVisible(bool(words))

    def press(self, axis: int, sign: int) -> None:
        """Move an axis by one step, as its arrows do."""
        if self.fields[axis].isEnabled():
            self.fields[axis].stepBy(sign)

    def type_target(self) -> None:
        """Move the keyboard focus to the fields of the target position."""
        self.fields[0].setFocus(Qt.FocusReason.ShortcutFocusReason)
        self.fields[0].selectAll()

    def set_free(self, free: bool) -> None:
        """Enable or disable moves."""
        for field in self.fields:
            field.setEnabled(free)
        self.hint.setVisible(free)


Point = tuple[float, float, float]
POLL_MS = 200
WAITS, MOVES, REST, USED = "waiting for the current frame …", "moving …", "at rest", "in use"


class StageMoves(QObject):
    """Make the moves that a `StagePanel` requests.

    Parameters
    ----------
    context, panel
        Context for background work, and panel that shows the position.
    station
        Function that returns the devices; None if they are not connected.
    """

    refused = Signal(str, arguments=["words"])
    """Why a move was refused or ended early."""
    plane_reached = Signal(int, arguments=["z"])
    """A move to the middle of a depth plane has started."""
    placed = Signal(object, arguments=["stage_um"])
    """The position (µm) was read."""

    def __init__(
        self, context: Context, panel: StagePanel, station: Callable[[], Station | None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._context, self._panel, self._station = context, panel, station
        self._moves: list[Callable[[], Any]] = []
        self._moving, self._free = False, True
        self.poll_timer = QTimer(self, interval=POLL_MS)
        self.poll_timer.timeout.connect(self._poll)
        panel.jogged.connect(self.jog)
        panel.target_asked.connect(self.go_to)
        panel.stop_asked.connect(self.stop)

    def follow(self, on: bool, *, free: bool = True) -> None:
        """Start or stop reading the position several times a second; ``free``: only the live view uses the stage."""
        self._free = free
        if on and not self.poll_timer.isActive():
            self.poll_timer.start()
        elif not on:
            self.poll_timer.stop()
            self._panel.show_motion("")

    def _poll(self) -> None:
        station = self._station()
        if station is not None and self._panel.isVisible():
            self._context.jobs.compute("acquire where", station.where, self._placed)

    def _placed(self, found: tuple[Point | None, bool]) -> None:
        stage_um, under_way = found
        moving = under_way or self._moving
        self._panel.show_motion(
            MOVES if under_way else WAITS if self._moving else REST if self._free else USED, moving=moving
        )
        if stage_um is not None:
            self._show_position(stage_um)

    def _show_position(self, stage_um: Point) -> None:
        """Show the position of the stage, unless it was released meanwhile."""
        if self._station() is not None:
            self._panel.set_position(stage_um)
            self.placed.emit(stage_um)

    @property
    def moving(self) -> bool:
        """Whether a move is running or queued."""
        return self._moving

    def jog(self, axis: int, by_um: float) -> None:
        """Move one axis by a step; quickly repeated steps are queued and all made."""
        station = self._station()
        if station is not None:
            self._queue(lambda: station.jog(axis, by_um))

    def go_to(self, words: str) -> None:
        """Move to a typed position; refuse invalid text and positions beyond the limits before anything moves."""
        station = self._station()
        if station is None:
            return
        try:
            target = read_target(words, station.limits)
        except LfcalError as error:
            self._refuse(str(error))
            return
        self._panel.say("")
        self._queue(lambda: station.move_axes(target))

    def go_plane(self, z: int) -> None:
        """Move the stage to the middle of the period in plane ``z``."""
        station, plan = self._station(), self._context.state.plan
        if station is not None and plan is not None:
            target = target_of(plan, z)
            self._queue(lambda: station.move(target))
            self.plane_reached.emit(z)

    def stop(self) -> None:
        """Stop the running move, and drop queued ones."""
        self._moves.clear()
        station = self._station()
        if station is not None:
            station.moving.stop()

    def _queue(self, move: Callable[[], Any]) -> None:
        self._moves.append(move)
        if not self._moving:
            self._next()

    def _next(self) -> None:
        self._moving = bool(self._moves)
        self._panel.show_motion(WAITS if self._moving else REST, moving=self._moving)
        if self._moves:
            self._context.jobs.compute("acquire move", self._moves.pop(0), self._moved, self._failed)

    def _moved(self, stage_um: Point) -> None:
        self._show_position(stage_um)
        self._next()

    def _failed(self, words: str) -> None:
        self._moves.clear()
        self._moving = False
        self._panel.show_motion(REST)
        self._refuse(words)

    def _refuse(self, words: str) -> None:
        self._panel.say(words)
        self.refused.emit(words)
