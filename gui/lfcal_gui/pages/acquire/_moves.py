"""Moves of the stage: asked for in any hurry, made one after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, QTimer, Signal

from lfcal.base import LfcalError
from lfcal_gui.context import Context
from lfcal_gui.pages.acquire.model import target_of
from lfcal_gui.pages.acquire.model_station import Station, read_target
from lfcal_gui.pages.acquire.stage_panel import StagePanel

__all__ = ["StageMoves"]

Point = tuple[float, float, float]
POLL_MS = 200
WAITS, MOVES, REST, USED = "waiting for the frame under way …", "moving …", "at rest", "in use"


class StageMoves(QObject):
    """Makes the moves that a `StagePanel` asks for.

    Parameters
    ----------
    context, panel
        Where moves are made in the background, and shown.
    station
        Returns the devices, None while they are not connected.

    Signals
    -------
    refused(words)
        Why a move was not made, or not to its end.
    plane_reached(z)
        The way to the middle of a depth plane was begun.
    placed(stage_um)
        The position (um) was read.
    """

    refused = Signal(str)
    plane_reached = Signal(int)
    placed = Signal(object)

    def __init__(
        self, context: Context, panel: StagePanel, station: Callable[[], Station | None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._context, self._panel, self._station = context, panel, station
        self._moves: list[Callable[[], Any]] = []
        self._moving, self._free = False, True
        self.poll_timer = QTimer(self)
        self.poll_timer.setInterval(POLL_MS)
        self.poll_timer.timeout.connect(self._poll)
        panel.jogged.connect(self.jog)
        panel.target_asked.connect(self.go_to)
        panel.plane_asked.connect(self.go_plane)
        panel.stop_asked.connect(self.stop)

    def follow(self, on: bool, *, free: bool = True) -> None:
        """Read the position several times a second, or not; ``free``: nothing but the live view uses the stage."""
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
            self._panel.set_position(stage_um)
            self.placed.emit(stage_um)

    @property
    def moving(self) -> bool:
        """Whether a move is under way, or waits."""
        return self._moving

    def jog(self, axis: int, by_um: float) -> None:
        """Move one axis by a step; steps asked for in a hurry are all made, one after the other."""
        station = self._station()
        if station is not None:
            self._queue(lambda: station.jog(axis, by_um))

    def go_to(self, words: str) -> None:
        """Go to a typed position; one that is none, or beyond the limits, is refused before anything moves."""
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
        """Go to the middle of the cell in plane ``z``."""
        station, plan = self._station(), self._context.state.plan
        if station is not None and plan is not None:
            target = target_of(plan, z)
            self._queue(lambda: station.move(target))
            self.plane_reached.emit(z)

    def stop(self) -> None:
        """Stop the move under way, and forget those that wait."""
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
        self._panel.set_position(stage_um)
        self.placed.emit(stage_um)
        self._next()

    def _failed(self, words: str) -> None:
        self._moves.clear()
        self._moving = False
        self._panel.show_motion(REST)
        self._refuse(words)

    def _refuse(self, words: str) -> None:
        self._panel.say(words)
        self.refused.emit(words)
