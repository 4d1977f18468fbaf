"""Picture of a volume that can be rotated with the mouse and the arrow keys: coarse during rotation, then sharp."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, QTimer, Signal
from PySide6.QtGui import QKeyEvent, QMouseEvent

from lfcal.base import format_length
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import BEGIN, CUTOUT, Levels, Projection, Shot, Tint, Viewpoint, project_solid
from lfcal_gui.pages.reconstruct.model_volume import Prepared, axes_in, box_of, marks_at
from lfcal_gui.widgets import Picture

REST_MS = 150
"""Delay between the last rotation and the sharp picture (ms)."""

STEP = math.radians(5)
"""Rotation by an arrow key (rad)."""

A_PIXEL = math.radians(0.4)
"""Rotation per pixel of mouse movement (rad)."""

CLICK = 4
"""Largest mouse movement that counts as a click (px)."""

MOST_PIXELS, QUICK_PIXELS = 1.2e6, 2e5
"""Largest number of pixels of a picture at rest, and during rotation."""

AXES_PX = 24

ZOOM = 1.25


class Newest:
    """Run one piece of work at a time; of those that wait, only the newest is run. Without jobs, run it immediately."""

    def __init__(self, jobs: Jobs | None, group: str) -> None:
        self._jobs, self._group = jobs, group
        self._busy = False
        self._next: tuple[Callable[[], Any], Callable[[Any], None]] | None = None

    def ask(self, work: Callable[[], Any], take: Callable[[Any], None]) -> None:
        """Run ``work`` in the background, then call ``take`` with its result in the window's thread."""
        if self._jobs is None:
            take(work())
        elif self._busy:
            self._next = work, take
        else:
            self._busy = True
            self._jobs.compute(self._group, work, lambda found: self._done(lambda: take(found)), self._failed)

    def _done(self, take: Callable[[], None]) -> None:
        self._busy = False
        following, self._next = self._next, None
        take()
        if following is not None:
            self.ask(*following)

    def _failed(self, words: str) -> None:
        assert self._jobs is not None
        self._jobs.trouble.emit(words)
        self._done(lambda: None)


@dataclass(frozen=True, eq=False)
class View:
    """View of a volume: its rotation, and the elements that are drawn; ``cross`` is (plane, row, column)."""

    turn: NDArray[np.float64]
    by_depth: bool = True
    box: bool = True
    cross: tuple[int, int, int] | None = None
    levels: Levels = (0.0, 1.0)
    caption: str = ""


class SolidPicture(Picture):
    """Picture of a rotated volume: drag or use the arrow keys to rotate, the wheel to zoom, Shift and drag to pan."""

    turned = Signal(float, float, arguments=["across", "down"])
    """The user rotated the volume (rad)."""
    begun_again = Signal()
    """The user restored the initial view."""
    picked = Signal(int, int, int, arguments=["z", "y", "x"])
    """A voxel was clicked."""

    def __init__(self, quantity: str, name: str, jobs: Jobs | None = None) -> None:
        super().__init__(quantity, legend=False)
        self.setAccessibleName(name)
        self.setToolTip(
            "Drag or arrow keys: rotate. Wheel or + and -: zoom. Shift and drag: move. Click: put "
            "the cross on the brightest voxel under the pointer. Home: initial view"
        )
        self._prepared: Prepared | None = None
        self._view = View(BEGIN)
        self._name = name
        self._drawn: tuple[Viewpoint, Projection, Prepared] | None = None
        self._newest = Newest(jobs, f"volume {id(self)}")
        self._grip: tuple[QPointF, bool] | None = None
        self._rest = QTimer(self, singleShot=True, interval=REST_MS)
        self._rest.timeout.connect(lambda: self._render(quick=False))
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.graphics.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.graphics.viewport().installEventFilter(self)
        self.box.sigRangeChanged.connect(lambda *_: self._changed())

    # -- content ---------------------------------------------------------------------------------------
    def show_volume(self, prepared: Prepared | None, view: View) -> None:
        """Show a volume. None: show nothing."""
        before, self._prepared, self._view = self._prepared, prepared, view
        if prepared is None:
            self._drawn = None
            self._rest.stop()
            self.set_shot(None)
            return
        if before is None or before.solid.radius != prepared.solid.radius:
            # the first picture after an update takes seconds: its kernels are compiled
            waiting = Shot(np.zeros((1, 1), np.float32), "Drawing …", whole=self._whole(prepared))
            self.set_shot(waiting, keep_view=False)
        self._changed()

    @staticmethod
    def _whole(prepared: Prepared) -> tuple[float, float, float, float]:
        radius = prepared.solid.radius
        return -radius, -radius, 2 * radius, 2 * radius

    def _changed(self) -> None:
        if self._prepared is not None and self.isVisible():
            self._render(quick=True)
            self._rest.start()

    def showEvent(self, event: Any) -> None:
        """Draw the picture that was requested while the widget was hidden."""
        super().showEvent(event)
        self._changed()

    def _render(self, *, quick: bool) -> None:
        prepared, view = self._prepared, self._view
        scene = None if prepared is None else self._scene(quick=quick)
        if prepared is None or scene is None:
            return
        corner, length = self._corner()

        def work() -> tuple[Shot, Projection]:
            found = project_solid(prepared.solid, scene, quick=quick)
            return self._shot_of(prepared, view, scene, found, corner, length)

        def take(made: tuple[Shot, Projection]) -> None:
            if self._prepared is not None:
                self._drawn = scene, made[1], prepared
                self.set_shot(made[0])

        self._newest.ask(work, take)

    def _scene(self, *, quick: bool) -> Viewpoint | None:
        """Return the viewpoint of the visible part of the volume; None if nothing is visible."""
        seen, ratio = self.box.viewRect(), self.devicePixelRatioF()
        width, height = self.box.width() * ratio, self.box.height() * ratio
        if not (width > 1 and height > 1 and seen.width() > 0):
            return None
        coarser = max(1.0, math.sqrt(width * height / (QUICK_PIXELS if quick else MOST_PIXELS)))
        shape = max(1, round(height / coarser)), max(1, round(width / coarser))
        pixel = seen.width() / shape[1]
        return Viewpoint(self._view.turn, (seen.top() + pixel / 2, seen.left() + pixel / 2), pixel, shape)

    def _corner(self) -> tuple[tuple[float, float], float]:
        """Return position (down, across) and length of the drawn axes."""
        seen = self.box.viewRect()
        point = seen.width() / max(1.0, self.box.width())
        return (seen.top() + 3 * AXES_PX * point, seen.right() - 2 * AXES_PX * point), AXES_PX * point

    @staticmethod
    def _shot_of(
        prepared: Prepared,
        view: View,
        scene: Viewpoint,
        found: Projection,
        corner: tuple[float, float],
        length: float,
    ) -> tuple[Shot, Projection]:
        solid = prepared.solid
        overlays = ()
        if view.box:
            overlays += (*box_of(solid, scene.turn), *axes_in(scene, corner, length))
        if view.cross is not None:
            overlays += marks_at(solid, scene.turn, solid.place_of(*view.cross), CUTOUT)
        tint = None
        near, far = float(solid.depths[0]), float(solid.depths[-1])
        if view.by_depth and far > near:
            words = tuple(format_length(d) if solid.measured else f"plane {d:.0f}" for d in (near, far))
            tint = Tint((found.depths - np.float32(near)) / np.float32(far - near), (words[0], words[1]))
        shot = Shot(
            found.values,
            view.caption,
            name="volume",
            levels=view.levels,
            origin=scene.origin,
            step=scene.pixel,
            overlays=overlays,
            pixel_um=scene.pixel if solid.measured else None,
            tint=tint,
            whole=SolidPicture._whole(prepared),
        )
        return shot, found

    def voxel_at(self, row: int, column: int) -> tuple[int, int, int] | None:
        """Return the voxel that is visible at a pixel; None if there is none."""
        if self._drawn is None:
            return None
        scene, found, prepared = self._drawn
        if not (0 <= row < scene.shape[0] and 0 <= column < scene.shape[1]):
            return None
        if not np.isfinite(found.values[row, column]):
            return None
        return prepared.solid.voxel_at(found.place_at(scene, row, column))

    # -- turning ---------------------------------------------------------------------------------------
    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Rotate the volume with the left mouse button; with Shift, pan it as in other pictures."""
        if not isinstance(event, QMouseEvent):
            return super().eventFilter(watched, event)
        kind, shifted = event.type(), bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier)
        if kind == QEvent.Type.MouseButtonPress and event.button() == Qt.MouseButton.LeftButton and not shifted:
            self.setFocus(Qt.FocusReason.MouseFocusReason)
            self._grip = event.position(), False
            return True
        if self._grip is None:
            return super().eventFilter(watched, event)
        if kind == QEvent.Type.MouseMove:
            self._drag(event.position())
        elif kind == QEvent.Type.MouseButtonRelease:
            (place, moved), self._grip = self._grip, None
            if not moved:
                self._pick(place)
        return True

    def _drag(self, place: QPointF) -> None:
        assert self._grip is not None
        before, moved = self._grip
        by = place - before
        if moved or by.manhattanLength() >= CLICK:
            self._grip = place, True
            self.turned.emit(by.x() * A_PIXEL, by.y() * A_PIXEL)

    def _pick(self, place: QPointF) -> None:
        pixel = self.pixel_at(self.graphics.mapToScene(place.toPoint()))
        voxel = None if pixel is None else self.voxel_at(*pixel)
        if voxel is not None:
            self.picked.emit(*voxel)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Rotate with the arrow keys, zoom with + and -, and restore the initial view with Home."""
        turns = {
            Qt.Key.Key_Left: (-STEP, 0.0),
            Qt.Key.Key_Right: (STEP, 0.0),
            Qt.Key.Key_Up: (0.0, -STEP),
            Qt.Key.Key_Down: (0.0, STEP),
        }
        zooms = {Qt.Key.Key_Plus: 1 / ZOOM, Qt.Key.Key_Equal: 1 / ZOOM, Qt.Key.Key_Minus: ZOOM}
        key = Qt.Key(event.key())
        if key in turns:
            self.turned.emit(*turns[key])
        elif key in zooms:
            self.box.scaleBy((zooms[key], zooms[key]))
            self.moved.emit()
        elif key == Qt.Key.Key_Home:
            self.begun_again.emit()
        else:
            super().keyPressEvent(event)
