"""Views of a volume: rotated, as three slices or projections, with a slice and the light field."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QRectF, Qt, Signal
from PySide6.QtGui import QAction, QResizeEvent
from PySide6.QtWidgets import QBoxLayout, QMenu, QStackedWidget, QVBoxLayout, QWidget

from lfcal.base import format_plane
from lfcal_gui.base_page import EmptyState
from lfcal_gui.jobs import Jobs
from lfcal_gui.models import BEGIN, CUTOUT, Levels, Outline, Shot, plane_words, turned
from lfcal_gui.pages.reconstruct._solid_picture import Newest, SolidPicture, View
from lfcal_gui.pages.reconstruct.model_regions import DrawnLabels, DrawnRegions
from lfcal_gui.pages.reconstruct.model_volume import (
    MODES,
    QUANTITIES,
    Prepared,
    ViewCell,
    VolumeIntent,
    arrange,
    prepare,
    quantity_of,
    side,
)
from lfcal_gui.widgets import (
    Contrast,
    Picture,
    PlaneTile,
    Strip,
    button,
    choice_box,
    column_of,
    link,
    name_controls,
    segment,
    share_contrast,
    split,
)

VALUE = "brightness (counts)"

VIEWS = (
    "The brightest value along each line of sight. Drag to rotate, wheel to zoom",
    "Slices through the cross",
    "The brightest voxel along each axis",
)
"""Tips of `MODES`."""

TICKS = (
    (
        "by_depth",
        "Colour by depth",
        "3-D view: the colour shows depth, the brightness shows the value. Off: the colour shows the value",
    ),
    ("box", "Box and axes", "Edges of the volume, and the directions of its axes"),
    ("cross", "Cross", "The voxel through which the slices pass"),
    ("own_scale", "Scale each plane", "Slices: use a separate colour scale for each depth plane"),
    ("truth", "Truth", "The phantom from which the light field was made, rotated together with the reconstruction"),
)
"""Field of the intent, text and tooltip of each entry of the menu."""

KEYS = ("xy", "xz", "yz")
"""Names of the pictures from three sides."""

GAP = 3
"""Space between pictures (px)."""

FRONT_VIEW = ViewCell("x", "y", (0, 0, 0, 0))
"""Horizontal and vertical axis of a slice."""

LEAST = (90, 70)
"""Smallest width and height of a picture (px)."""

TILE = 60
"""Side of a picture of the strip (px)."""


class VolumePanes(QWidget):
    """View of one volume: rotated, or from three sides."""

    def __init__(self, name: str, jobs: Jobs | None, *, first: bool) -> None:
        super().__init__()
        self.name, self.short = name, "" if first else f"{name}, "
        self.prepared: Prepared | None = None
        self.cells: dict[str, ViewCell] = {}
        self._drawn: tuple[VolumeIntent, Levels] | None = None
        self.solid = SolidPicture(VALUE, name, jobs)
        self.pictures: dict[str, Picture] = {}
        self.sides = _Sides(self._show_sides)
        self._stack = QStackedWidget()
        self._stack.addWidget(self.solid)
        self._stack.addWidget(self.sides)
        column_of(self._stack, of=self)

    def make_sides(self) -> None:
        """Create the pictures from three sides."""
        for key in KEYS:
            picture = self.pictures[key] = Picture(VALUE, steered=True, legend=False, parent=self.sides)
            picture.setAccessibleName(f"{self.name}: {key}")
            picture.graphics.setMinimumSize(1, 1)

    def set_volume(self, prepared: Prepared | None) -> None:
        """Set the volume that the next `show_as` shows."""
        self.prepared = prepared
        if prepared is None:
            for picture in self.pictures.values():
                picture.set_shot(None)
            self.solid.show_volume(None, View(BEGIN))

    def show_as(self, intent: VolumeIntent, turn: NDArray[np.float64], levels: Levels, title: str) -> None:
        """Show the volume for an intent."""
        prepared = self.prepared
        if prepared is None:
            return
        solid = intent.mode == MODES[0]
        self._stack.setCurrentIndex(0 if solid else 1)
        if solid:
            cross = (intent.z, intent.y, intent.x) if intent.cross else None
            self.solid.set_display(intent.display)
            self.solid.show_volume(prepared, View(turn, intent.by_depth, intent.box, cross, levels, title))
            return
        self._drawn = intent, levels
        self._show_sides()

    def _show_sides(self) -> None:
        """Show the volume from three sides at one scale, in a layout that fits the room."""
        prepared = self.prepared
        if prepared is None or self._drawn is None or not self.pictures:
            return
        intent, levels = self._drawn
        room = max(2 * LEAST[0], self.sides.width()), max(2 * LEAST[1], self.sides.height())
        self.cells, pixel = arrange(prepared.lengths, room, GAP)
        for key, cell in self.cells.items():
            picture = self.pictures[key]
            picture.setGeometry(*cell.rect)
            own = intent.own_scale and key == "xy" and intent.mode == MODES[1]
            shot = side_shot(intent, prepared, key, cell, None if own else levels)
            depth = "" if key == "xy" or prepared.squeeze == 1 else f", depth × {prepared.squeeze:g}"
            row, column, height, width = shot.extent
            tall, wide = cell.rect[3] * pixel, cell.rect[2] * pixel
            whole = row + (height - tall) / 2, column + (width - wide) / 2, tall, wide
            picture.set_display(intent.display)
            # the scale of the three is one, so one bar is enough
            um = shot.pixel_um if key == "xy" else None
            picture.set_shot(replace(shot, caption=f"{self.short}{key}{depth}", whole=whole, pixel_um=um))

    def follow(self, moved: Picture, cell: ViewCell) -> None:
        """Apply the part and the zoom that the user chose in one of the pictures to the others."""
        seen = moved.box.targetRect()
        middle = {cell.across: seen.center().x(), cell.down: seen.center().y()}
        pixel, whole = seen.width() / max(1.0, moved.box.width()), moved.shot.whole
        for key, its in self.cells.items():
            picture = self.pictures[key]
            if picture is moved or picture.shot.whole is None:
                continue
            if whole is not None and seen == QRectF(whole[1], whole[0], whole[3], whole[2]):
                picture.show_part(*picture.shot.whole, padding=0)
                continue
            at, (width, height) = picture.box.targetRect().center(), (pixel * n for n in its.rect[2:])
            x, y = middle.get(its.across, at.x()), middle.get(its.down, at.y())
            picture.show_part(y - height / 2, x - width / 2, height, width, padding=0)


class _Sides(QWidget):
    """Container of the pictures from three sides."""

    def __init__(self, arrange: Callable[[], None]) -> None:
        super().__init__()
        self._arrange = arrange
        self.setMinimumSize(2 * LEAST[0] + GAP, 2 * LEAST[1] + GAP)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Update the layout for the new size."""
        super().resizeEvent(event)
        self._arrange()


def side_shot(intent: VolumeIntent, prepared: Prepared, key: str, cell: ViewCell, levels: Levels | None) -> Shot:
    """Return the picture of a volume from one side, with the cross and the drawn regions."""
    shown = side(intent, prepared, key, cell)
    at = {axis: float(places[getattr(intent, axis)]) for axis, places in prepared.axes.items()}
    rows, columns = (n * shown.pixel for n in shown.values.shape)
    frame = shown.origin[0] - shown.pixel / 2, shown.origin[1] - shown.pixel / 2, rows, columns
    lines = _line(True, at[cell.across], frame), _line(False, at[cell.down], frame)
    cut = {axis: None if intent.mode == MODES[2] else getattr(intent, axis) for axis in "xyz"}
    drawn = intent.regions.overlays(cell.across, cell.down, cut, prepared.edges) if intent.regions.boxes else ()
    return Shot(
        shown.values,
        name=f"volume_{key}",
        levels=levels,
        origin=shown.origin,
        step=shown.pixel,
        overlays=(*(lines if intent.cross else ()), *drawn),
        pixel_um=shown.pixel if prepared.solid.measured else None,
    )


class Looks(QWidget):
    """Container of the volume and the true volume: side by side or one above the other, whichever is larger."""

    def __init__(self, look: VolumePanes) -> None:
        super().__init__()
        self.setObjectName("looks")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self._row = QBoxLayout(QBoxLayout.Direction.LeftToRight, self)
        self._row.setContentsMargins(0, 0, 0, 0)
        self._row.setSpacing(3)
        self.add(look)

    def add(self, look: VolumePanes) -> None:
        """Add a view."""
        self._row.addWidget(look, 1)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Choose the direction for the new size."""
        super().resizeEvent(event)
        direction = QBoxLayout.Direction
        self._row.setDirection(direction.TopToBottom if self.height() > self.width() else direction.LeftToRight)


class VolumeView(QWidget):
    """View of a volume ``(Z, Y, X)`` next to the true volume, if it is known, with light field and slice on the right.

    Parameters
    ----------
    jobs
        Jobs that draw in the background. None: draw immediately.
    """

    moved = Signal(int, int, int, arguments=["z", "y", "x"])
    """The cross was moved."""
    said = Signal(str, arguments=["words"])
    """Position and value of the voxel under the pointer, or of the cross; empty: there is no volume."""

    def __init__(self, jobs: Jobs | None = None, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.intent = VolumeIntent()
        self.turn = BEGIN
        self.readout = ""
        self._title = "Volume"
        self._again: Callable[[], None] = lambda: None
        self._volume: NDArray[Any] | None = None
        self._newest = Newest(jobs, f"volume {id(self)}")
        self._emptied = 0
        self._corner: dict[str, int] = {}
        self._light_field = False
        self._jobs = jobs
        self.looks: tuple[VolumePanes, ...] = (VolumePanes("Volume", jobs, first=True),)
        self.solid, self.pictures = self.looks[0].solid, self.looks[0].pictures
        self.slice = Picture(VALUE, steered=True, legend=False)
        self.slice.setAccessibleName("Slice at the cross")
        self.slice.pressed.connect(self._press)
        self.slice.steered_to.connect(partial(self._steer_in, self.looks[0], self.slice, FRONT_VIEW))
        self.light_field = Picture(legend=False)
        self.light_field.setToolTip("Light field to reconstruct. The rectangle shows the region that is used")
        share_contrast(*self._volumes())
        self._watch(self.looks[0])
        self.contrasts = [self._contrast(self.solid)]
        self.strip = Strip(self._tip, TILE)
        self.strip.setAccessibleName("Depth planes of the volume")
        self.strip.setToolTip("Depth planes of the volume. Click one to move the cross to it (Page up, Page down)")
        self.strip.chosen.connect(lambda z: self.set_cross(z=z))
        for picture in (*self._volumes(), self.light_field):
            picture.graphics.setMinimumSize(*LEAST)
        self._lay_out()
        self._make_tools()
        self.apply_theme()

    # -- building --------------------------------------------------------------------------------------
    def _lay_out(self) -> None:
        self.looking = Looks(self.looks[0])
        self.stack = QStackedWidget()
        self.stack.addWidget(self.looking)
        self.side = split(self.light_field, self.slice, sizes=(1, 1), vertical=True)
        self.split = split(self.stack, self.side, sizes=(5, 2))
        self._column = column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(2)
        column.addWidget(self.split, 1)
        for part in (*self.contrasts, self.strip):
            column.addWidget(part)

    def _contrast(self, picture: Picture) -> Contrast:
        contrast = Contrast(picture)
        contrast.display_asked.connect(lambda changes: self._display(**changes))
        return contrast

    def _share(self) -> None:
        """Share the contrast with new pictures."""
        share_contrast(*self._volumes())
        self.solid.set_contrast(self.solid.contrast)

    def _make_sides(self) -> None:
        """Create the pictures from three sides when they are first shown."""
        new = [look for look in self.looks if not look.pictures]
        if not new:
            return
        for look in new:
            look.make_sides()
            for key, picture in look.pictures.items():
                picture.pressed.connect(self._press)
                picture.steered_to.connect(partial(self._steer, look, key))
                picture.moved.connect(partial(self._follow, look, key))
        self._share()
        if len(self.contrasts) == 1:
            self.contrasts.append(self._contrast(self.pictures["xy"]))
            self._column.insertWidget(self._column.indexOf(self.strip), self.contrasts[1])
        name_controls(self)

    def _add_truth(self) -> None:
        """Create the view of the true volume when there is one."""
        truth = VolumePanes("Truth", self._jobs, first=False)
        self.looks = (self.looks[0], truth)
        self.looking.add(truth)
        self._share()
        link(*(look.solid for look in self.looks))
        self._watch(truth)
        truth.solid.graphics.setMinimumSize(*LEAST)
        name_controls(self)

    def _watch(self, look: VolumePanes) -> None:
        look.solid.turned.connect(self._turn)
        look.solid.begun_again.connect(self.show_all)
        look.solid.hovered.connect(lambda row, column, _: self._read(look, row, column))
        look.solid.picked.connect(lambda z, y, x: self.set_cross(z=z, y=y, x=x))

    def _make_tools(self) -> None:
        """Create the tools of the header: views, and elements to draw."""
        self.segments = []
        for mode, tip in zip(MODES, VIEWS, strict=True):
            self.segments.append(segment(mode, tip, partial(self._change, mode=mode), on=mode == self.intent.mode))
            self.segments[-1].setAutoExclusive(True)
        self.quantity = choice_box(
            [(name, name) for name in QUANTITIES],
            "Value, standard uncertainty, or the value hatched where details of a voxel's size are unknown",
            "displayed quantity",
        )
        self.quantity.currentIndexChanged.connect(lambda _: self._again())
        self.quantity.hide()
        self.overlay = button("Overlay", "Choose the colours, and what is drawn over the volume")
        menu = QMenu(self.overlay)
        menu.setToolTipsVisible(True)
        self.ticks: dict[str, QAction] = {}
        for key, words, tip in TICKS:
            tick = self.ticks[key] = menu.addAction(words)
            tick.setCheckable(True)
            tick.setChecked(getattr(self.intent, key))
            tick.setToolTip(tip)
            tick.toggled.connect(lambda on, key=key: self._change(**{key: on}))
        menu.addSeparator()
        self.drawing = menu.addAction("Draw regions")
        self.drawing.setCheckable(True)
        self.drawing.setToolTip(
            "Drag in a slice or a projection to draw a region, whose sum Error bars measures. Then drag in another one "
            "to set its extent along the third axis"
        )
        self.no_regions = menu.addAction("Remove regions")
        self.no_regions.setToolTip("Remove all drawn regions")
        self.no_regions.triggered.connect(lambda _=False: self.remove_regions())
        menu.addSeparator()
        self.brightest = menu.addAction("Brightest voxel")
        self.brightest.setToolTip("Put the cross on the brightest voxel")
        self.brightest.triggered.connect(lambda _=False: self.go_to_brightest())
        self.first_view = menu.addAction("Reset view")
        self.first_view.setToolTip("Restore the initial rotation and zoom (Home)")
        self.first_view.triggered.connect(lambda _=False: self.show_all())
        self.overlay.setMenu(menu)

    def set_empty(self, empty: EmptyState) -> None:
        """Set the message that is shown without a light field."""
        self.empty = empty
        self.stack.addWidget(empty)

    # -- content ---------------------------------------------------------------------------------------
    def show_none(self, *, light_field: bool) -> None:
        """Show only the light field or, without one, the message on the next step."""
        self._light_field = light_field
        self.stack.setCurrentWidget(self.empty)
        self._show_parts()

    def set_volume(
        self,
        volume: NDArray[Any] | None,
        depths_um: NDArray[np.float64] | None = None,
        voxel_um: tuple[float, float] | None = None,
        truth: NDArray[Any] | None = None,
        title: str = "Volume",
        maps: Mapping[str, NDArray[Any]] | None = None,
    ) -> None:
        """Show ``volume`` ``(Z, Y, X)``; cross, turn and zoom stay if they fit.

        Parameters
        ----------
        volume
            The volume. None: show nothing.
        depths_um
            Depth of each plane (µm). If depths or sides of voxels are not given, voxels are drawn as cubes.
        voxel_um
            Sides of a voxel (rows, columns; µm).
        truth
            The true volume; None if it is unknown.
        title
            First words of the caption.
        maps
            Maps of the uncertainty of the volume, as in `quantity_of`. None: unknown.
        """
        self._volume, self._title = volume, title
        self._again = partial(self.set_volume, volume, depths_um, voxel_um, truth, title, maps)
        self.quantity.setVisible(bool(maps))
        if volume is None:
            self._emptied += 1
            for look in self.looks:
                look.set_volume(None)
            self.slice.set_shot(None)
            self.strip.show_tiles([])
            self._say("")
            return
        self._light_field = True
        self.stack.setCurrentWidget(self.looking)
        self._show_parts()
        asked, quantity = self._emptied, self.quantity.currentText()

        def work() -> list[Prepared]:
            shown = quantity_of(volume, maps or {}, quantity)
            return [prepare(one, depths_um, voxel_um) for one in (shown, truth) if one is not None]

        def take(found: list[Prepared]) -> None:
            if asked == self._emptied:  # else it is of a project that is no longer open
                self._take(found)

        self._newest.ask(work, take)

    def _take(self, found: list[Prepared]) -> None:
        before, shape = self.prepared, found[0].volume.shape
        first = before is None or before.volume.shape != shape
        if len(found) > len(self.looks):
            self._add_truth()
        for look, prepared in zip(self.looks, (*found, None), strict=False):
            look.set_volume(prepared)
        self.ticks["truth"].setEnabled(len(found) > 1)
        tiles = zip(found[0].tiles, found[0].depths, strict=True)
        self.strip.show_tiles([PlaneTile(depth, image) for image, depth in tiles])
        if first:
            z, y, x = found[0].brightest
            self.intent = replace(self.intent, z=z, y=y, x=x)
        if shape != self.intent.regions.shape:
            self.intent = replace(self.intent, regions=DrawnRegions(shape))
        self._show()
        if first:
            self.show_all()

    @property
    def volume(self) -> NDArray[Any] | None:
        """The requested volume."""
        return self._volume

    @property
    def prepared(self) -> Prepared | None:
        """The displayed volume."""
        return self.looks[0].prepared

    def set_cross(self, **place: Any) -> None:
        """Move the cross to new values of ``z``, ``y`` or ``x``."""
        if self.prepared is None:
            return
        moved = replace(self.intent, **place).clamped(self.prepared.volume.shape)
        changed = moved != self.intent
        self.intent = moved
        if changed:
            self._show()
            self.moved.emit(moved.z, moved.y, moved.x)

    def go_to_brightest(self) -> None:
        """Move the cross to the brightest voxel."""
        if self.prepared is not None:
            self.set_cross(**dict(zip("zyx", self.prepared.brightest, strict=True)))

    def show_all(self) -> None:
        """Restore the initial rotation and zoom."""
        self.turn = BEGIN
        for picture in self._volumes():
            picture.show_all()
        self._show()

    def _volumes(self) -> list[Picture]:
        return [self.slice, *(p for look in self.looks for p in (look.solid, *look.pictures.values()))]

    def apply_theme(self) -> None:
        """Apply the colours of the current theme."""
        for part in (*self._volumes(), self.light_field, *self.contrasts, self.strip):
            part.apply_theme()
        self._show()

    # -- inside ----------------------------------------------------------------------------------------
    def _turn(self, across: float, down: float) -> None:
        self.turn = turned(self.turn, across, down)
        self._show()

    def _follow(self, moved: VolumePanes, key: str) -> None:
        for look in self.looks:
            look.follow(moved.pictures[key], moved.cells[key])

    def _steer(self, look: VolumePanes, key: str, row: int, column: int) -> None:
        self._steer_in(look, look.pictures[key], look.cells[key], row, column)

    def _steer_in(self, look: VolumePanes, picture: Picture, cell: ViewCell, row: int, column: int) -> None:
        prepared, shot = look.prepared, picture.shot
        if prepared is None:
            return
        at = {cell.down: shot.origin[0] + row * shot.step, cell.across: shot.origin[1] + column * shot.step}
        place = {axis: int(np.argmin(np.abs(prepared.axes[axis] - to))) for axis, to in at.items()}
        if self.drawing.isChecked():
            self._draw(place)
        else:
            self.set_cross(**place)

    def _press(self) -> None:
        self._corner = {}

    def _draw(self, place: dict[str, int]) -> None:
        """Draw a region from where the button was pressed to ``place``; its third axis is the slice or the whole."""
        regions, slices = self.intent.regions, self.intent.mode != MODES[2]
        if not self._corner:
            self._corner = place
            ends = {
                axis: (at, at + 1) if slices else (0, n)
                for axis, n in zip("zyx", regions.shape, strict=True)
                for at in [getattr(self.intent, axis)]
            }
            regions = regions.begun(frozenset(place), ends)
        self._change(regions=regions.extended({axis: (self._corner[axis], at) for axis, at in place.items()}))

    def drawn_labels(self) -> DrawnLabels | None:
        """Return the labels of the drawn regions; None if there are none."""
        prepared, regions = self.prepared, self.intent.regions
        if prepared is None or not regions.boxes:
            return None
        depths = prepared.solid.given if prepared.solid.measured else None
        return DrawnLabels(regions.labels(), depths)

    def remove_regions(self) -> None:
        """Remove the regions that the user drew."""
        self._change(regions=DrawnRegions(self.intent.regions.shape))

    def _read(self, look: VolumePanes, row: int, column: int) -> None:
        """Show position and value of the voxel under the pointer, or else of the cross."""
        at = look.solid.voxel_at(row, column) or (self.intent.z, self.intent.y, self.intent.x)
        if look.prepared is not None:
            self._say(look.prepared.words_at(*at))

    def _say(self, words: str) -> None:
        self.readout = words
        self.said.emit(words)

    def _tip(self, z: int, tile: PlaneTile, count: int) -> str:
        prepared = self.prepared
        share = (
            "" if prepared is None or z >= len(prepared.shares) else f"\n{100 * prepared.shares[z]:.0f} % of the light"
        )
        return f"{plane_words(z, count)}: {format_plane(tile.depth_um, z)}{share}"

    def _change(self, **changes: Any) -> None:
        self.intent = replace(self.intent, **changes)
        self._show()

    def _display(self, **changes: Any) -> None:
        self._change(display=replace(self.intent.display, **changes))

    def _show_parts(self) -> None:
        """Show the parts that have content."""
        there, solid = self.stack.currentWidget() is self.looking, self.intent.mode == MODES[0]
        for contrast, its in zip(self.contrasts, (solid, not solid), strict=False):
            contrast.setVisible(there and its)
        self.strip.setVisible(there)
        self.slice.setVisible(there and solid)
        self.stack.setVisible(there or not self._light_field)
        self.side.setVisible(self._light_field)
        for one in self.segments:
            one.setEnabled(there)
        if self.overlay.parent() is not None:
            self.overlay.setVisible(there)

    def _show(self) -> None:
        if self.intent.mode != MODES[0]:
            self._make_sides()
        self._show_parts()
        intent, prepared = self.intent, self.prepared
        for truth in self.looks[1:]:
            truth.setVisible(truth.prepared is not None and intent.truth)
        if prepared is None:
            return
        known = [look.prepared.levels for look in self.looks if look.prepared is not None]
        levels = min(low for low, _ in known), max(high for _, high in known)
        planes, rows, columns = prepared.volume.shape
        for look, title in zip(self.looks, (self._title, "Truth"), strict=False):
            look.show_as(intent, self.turn, levels, f"{title}\n{columns} × {rows} × {planes} voxels")
        if intent.mode == MODES[0]:
            flat = replace(intent, mode=MODES[1])
            shot = side_shot(flat, prepared, "xy", FRONT_VIEW, None if intent.own_scale else levels)
            self.slice.set_display(intent.display)
            self.slice.set_shot(replace(shot, caption=f"Slice at {format_plane(prepared.depths[intent.z], intent.z)}"))
        self.strip.set_current(intent.z)
        self._say(prepared.words_at(intent.z, intent.y, intent.x))


def _line(upright: bool, at: float, frame: tuple[float, float, float, float]) -> Outline:
    """Return a line through the middle of a column, or of a row, of a picture: first row, column, height, width."""
    row, column, height, width = frame
    ends = [(row, at), (row + height, at)] if upright else [(at, column), (at, column + width)]
    return Outline(np.array(ends), CUTOUT, closed=False, width=1)
