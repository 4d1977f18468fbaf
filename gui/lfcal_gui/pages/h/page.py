"""H and its transpose for any plane and position, with checks, fit, and comparison with another H."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QFileDialog, QWidget

from lfcal.base import LfcalError, format_bytes, format_count
from lfcal.psf import PSFMatrix, mat_orders_of, opening_notes
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.models import (
    JOBS,
    OpeningSettings,
    PageSpec,
    Place,
    ProjectState,
    filled_of,
    kept_verdict,
    stated_order,
)
from lfcal_gui.pages.h import model, takes
from lfcal_gui.pages.h._checking import Checking
from lfcal_gui.pages.h._comparing import ProjectComparing
from lfcal_gui.pages.h.model import HIntent, LoadedPlane, PlaneData
from lfcal_gui.pages.h.model_checks import QualitySettings
from lfcal_gui.pages.h.panel import LEVELS, HPanel

if TYPE_CHECKING:
    from lfcal.judge import Pair
    from lfcal_gui.pages.h._fitting import Fitting
    from lfcal_gui.pages.h.model_fit_run import FoundFit

FILES = "PSF matrices (*.h5 *.mat *.npy *.lfc)"


OPEN = "An H file, a file of another program (.mat, .lfc), or a NumPy array (.npy)"


class Page(BasePage):
    """Page of H: turns an intent (position and view) into pictures."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.intent = HIntent()
        self.matrix: PSFMatrix | None = None
        self.reference: PSFMatrix | None = None
        self.plane: LoadedPlane | None = None
        self.reference_plane: LoadedPlane | None = None
        self._asked = ""  # a file that is opened for the project
        self._held = self._offering = False
        self._levels: Mapping[str, tuple[float, float]] = {}
        self._summed: PSFMatrix | None = None
        self._sent: dict[str, Any] = {}
        self._plane_data: PlaneData | None = None
        self._both: Pair | None = None
        self.level = ""
        """The displayed level of the inspector: one of `lfcal_gui.pages.h.panel.LEVELS`, empty: the verdict."""
        self.panel = HPanel()
        self._fill_header()
        self.panel.asked.connect(lambda changes: self.set_intent(**changes))
        self.panel.display_asked.connect(self._set_display)
        self.panel.own_scale_toggled.connect(self._show_picture)
        self.panel.hovered.connect(self._hovered)
        self.panel.clicked.connect(self._hold)
        self.panel.level_asked.connect(self.look_into)
        self.panel.frame_asked.connect(self._show_frame)
        self.set_panel(self.panel)
        self.checking = Checking(self)
        self._add_shortcuts()
        self.theme_changed.connect(self._apply_theme)
        context.matrices.changed.connect(self._matrix_changed)
        self._open()

    def _fill_header(self) -> None:
        for button in self.panel.view_buttons.values():
            self.segments.addWidget(button)
        self.header.insertWidget(2, self.panel.readout, 1)
        self.tools.addWidget(self.panel.own_scale)
        self.stop_button = self.stop_tool("Stop the running job of this page; earlier results are kept")
        self.stop_button.hide()
        self.context.jobs.changed.connect(lambda _: self._show_stop_button())
        self.tool_button("Open H …", OPEN, self.choose_file)

    def _show_stop_button(self) -> None:
        """Show the stop button if there are jobs that the line of the next step does not show."""
        others = (job.active and job.page == self.spec.key and job.kind not in JOBS for job in self.context.jobs.jobs())
        self.stop_button.setVisible(any(others))

    # -- levels of the inspector -------------------------------------------------------------------------
    @cached_property
    def fitting(self) -> Fitting:
        """The fit of the optics, which is created when it is first shown."""
        from lfcal_gui.pages.h._fitting import Fitting

        return Fitting(self)

    @cached_property
    def comparing(self) -> ProjectComparing:
        """The comparison with another H, which is created when it is first shown."""
        return ProjectComparing(self)

    @property
    def _parts(self) -> dict[str, Any]:
        """The controllers of levels that were already created, by name."""
        names = {"checks": "checking", "fit": "fitting", "compare": "comparing"}
        return {level: self.__dict__[name] for level, name in names.items() if name in self.__dict__}

    def look_into(self, level: str) -> None:
        """Show a level of the inspector: ``"checks"``, ``"fit"``, ``"compare"``, or the verdict (empty)."""
        if level and self.panel.findChild(QWidget, level) is None:
            views = {
                "checks": lambda: self.checking.make_view(),
                "fit": lambda: self.fitting.view,
                "compare": lambda: self.comparing.view,
            }
            self.panel.add_level(level, views[level](), scrolled=level != "checks")
        self.level = level
        self.panel.show_level(level)
        if level:
            self._parts[level].entered()
        self.show_levels()
        self.show_map()

    def show_levels(self) -> None:
        """Show the state of each level in the lines of the inspector."""
        parts = self._parts
        if "checks" in parts:
            self.panel.say_level("checks", *parts["checks"].row_words)
        for level, otherwise in (("fit", "not fitted"), ("compare", Path(self.context.state.reference).name)):
            state = parts[level].row_words if level in parts else otherwise
            self.panel.say_level(level, LEVELS[level][0], state or "none")

    def show_fit(self, found: FoundFit | None) -> None:
        """Offer the patterns of a fit in addition to H. None: there is no fit."""
        self.panel.show_fit(found)
        if found is None and self.intent.view == "fit":
            self.intent = replace(self.intent, view="both")
            self.set_intent()
        elif found is not None and self.level == "fit":
            self.set_intent(view="fit")
        self.show_map()

    def show_map(self) -> None:
        """Show the map of the current level, else the map of the errors of the positions, else that of their light."""
        matrix, z = self.matrix, self.intent.z
        if matrix is None:
            return
        part, data = self._parts.get(self.level), self._plane_data
        shown = None if part is None else part.map_at(z)
        if shown is None:
            if data is None or data.plane.z != z:
                return  # it is being read
            kept = kept_verdict(self.context.state)
            worst, missing = () if kept is None else kept.redo, matrix.recorded[z] == 0
            shown = self.checking.error_at(z, worst, missing)
            unit = "counts" if "counts" in model.unit_of(matrix) else ""
            shown = shown or model.light_map(data, worst, missing, unit)
        self.panel.show_map(shown)

    @property
    def part(self) -> str:
        """Level of the inspector whose command is copied; empty: the export of H."""
        return self.level if self.level in ("checks", "fit") else ""

    def _begin(self) -> None:
        """Inspect, fit or compare H again, depending on the current level."""
        (self._parts.get(self.level) or self.checking).begin()

    def _show_frame(self) -> None:
        self.context.go.emit("frames", (self.intent.z, self.intent.y, self.intent.x))

    def _apply_theme(self) -> None:
        self.panel.apply_theme()
        self.checking.apply_theme()
        if "fitting" in self.__dict__:
            self.fitting.apply_theme()

    def _add_shortcuts(self) -> None:
        self.shortcut("F5", self._begin)
        self.shortcut("Backspace", lambda: self.look_into(""))
        self.shortcut("W", self._show_worst)
        self.shortcut("D", lambda: self.set_intent(view="both" if self.intent.view == "difference" else "difference"))
        self.shortcut("Left", lambda: self._step(0, -1))
        self.shortcut("Right", lambda: self._step(0, 1))
        self.shortcut("Up", lambda: self._step(-1, 0))
        self.shortcut("Down", lambda: self._step(1, 0))
        self.shortcut("PgUp", lambda: self._step_plane(-1))
        self.shortcut("PgDown", lambda: self._step_plane(1))
        self.shortcut("T", lambda: self.set_intent(**self.intent.next_view()))
        self.shortcut("L", lambda: self.panel.toggle_scale("log"))
        self.shortcut("G", lambda: self.panel.toggle_scale("gamma"))

    # -- files -----------------------------------------------------------------------------------------
    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return the actions that the next step may request, by name."""
        return self.checking.deeds()

    def let_go(self) -> None:
        """Stop opening files for the previous project, and discard its comparison."""
        self._sent = {}
        asked, self._asked = self._asked, ""
        if asked and self.context.matrices.opening(asked):
            self.context.forget(asked)
        if "comparing" in self.__dict__:
            self.comparing.let_go()

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Open the H and the reference of the project if they changed, and update the levels and the verdict."""
        if (old.psf, old.reference) != (new.psf, new.reference):
            self._open()
        elif old.camera != new.camera and self.matrix is not None:
            self._show_hint(self.matrix)
        by_number = QualitySettings.of(old).by_number != QualitySettings.of(new).by_number
        if by_number and (old.psf, old.reference) == (new.psf, new.reference):
            self._show_matrices()
        for part in self._parts.values():
            part.state_changed(old, new)
        self._show_verdict()
        self.show_levels()

    def entered(self) -> None:
        """Discard results that belong to an earlier file of H."""
        for part in self._parts.values():
            part.follow()
        if self.level:
            self._parts[self.level].entered()

    def _show_verdict(self) -> None:
        """Show the verdict on H that is stored in the project."""
        verdict = kept_verdict(self.context.state)
        if verdict is None:
            self.panel.verdict.show_verdict("", "")
            return
        # those that a model has filled are no longer offered for repair
        left = verdict.bad - filled_of(verdict, self.context.matrix(self.context.state.psf))
        if verdict.few and left > 0:
            head = f"Good, except {format_count(left, 'position', 'positions')}"
            self.panel.verdict.show_verdict("fair", verdict.sentence, head)
        else:
            self.panel.verdict.show_verdict(verdict.merit, verdict.sentence)

    def _open(self) -> None:
        """Open the H and the reference of the project in the background."""
        state = self.context.state
        for path in (state.psf, state.reference):
            self.context.matrices.want(path)
        self._show_matrices()

    def _matrix_changed(self, path: str) -> None:
        if path in (self.context.state.psf, self.context.state.reference):
            self._show_matrices()
            if "fitting" in self.__dict__:
                self.fitting.follow()

    def _show_matrices(self) -> None:
        """Show H and the reference if they are open."""
        self._show_verdict()
        state, before = self.context.state, self.matrix
        self.plane = self.reference_plane = self._plane_data = None
        self.matrix = matrix = self.context.matrix(state.psf)
        if matrix is None:
            self.reference = self._both = None
            self.context.attention.emit("simulate", False)
            self._show_none(state.psf)
            return
        self._both = self._comparable(matrix, state.reference)
        self.reference = None if self._both is None else self._both.b
        self.panel.readout.show()
        self.panel.frame_button.setVisible(bool(state.frames))
        self.show_body()
        self._show_hint(matrix)
        pixel = None if matrix.camera is None else matrix.camera.sensor.pixel_um
        self.panel.show_matrix(matrix.known_depths, model.unit_of(matrix), pixel, reference=self.reference is not None)
        self._summed = None
        if matrix is before:
            self.set_intent()
        else:
            self.set_intent(z=len(matrix) // 2, y=matrix.period[0] // 2, x=matrix.period[1] // 2, pixel=None)
            self._offer_order()
        self._show_sent()

    def _offer_order(self, *, again: bool = False) -> None:
        """Offer the other order of axes if the order of H was guessed or, with ``again``, stated by the user before."""
        path = self.context.state.psf
        orders = () if self.matrix is None else mat_orders_of(self.matrix)
        if not orders or (not again and stated_order(self.context.state, path)):
            if self._offering:
                self._offering = False
                self.notice.clear()
            return
        self._offering = True
        taken, other = orders
        words = f"{Path(path).name} is read {_plain(taken)}, but the file does not state the order of the axes of H."
        self.notice.offer(
            words,
            f"Read {_plain(other)}",
            lambda: self._state_order(path, other),
            lambda: self._state_order(path, taken),
            stay=f"Keep {_plain(taken)}",
            stay_tip="Keep this order of the axes for the file, and do not ask again",
            tip="Open the file again with this order of the axes. Undo (Ctrl+Z) restores the previous order",
        )

    def _state_order(self, path: str, order: str) -> None:
        """Store the order of the axes of a .mat file; the file is reopened if the order changed."""
        self._offering = False
        settings = OpeningSettings.of(self.context.state).with_order(path, order)
        self.context.project.update("order of axes", settings=settings.into(self.context.state))

    def _show_hint(self, matrix: PSFMatrix) -> None:
        """Describe H and how it was read, and warn if the reference is of another camera than that of the project."""
        state = self.context.state
        notes = [f"{Path(state.psf).name}: (z, y, x, t, s) = {matrix.shape}, {format_bytes(matrix.nbytes)}"]
        notes += opening_notes(matrix)
        stale = self.reference is not None and self.reference.camera not in (None, state.camera)
        self.context.attention.emit("simulate", stale)
        if stale:
            notes.append("the other H belongs to another camera than the one described now; compute it again")
        self.hint.setText("; ".join(notes), Path(state.psf).name)

    def _comparable(self, matrix: PSFMatrix, path: str) -> Pair | None:
        """Return H and the reference, paired by plane and position, if they can be compared."""
        from lfcal.judge import pair

        reference, problem = self.context.matrix(path), self.context.matrices.problem(path)
        if problem:
            self.refuse(f"other H: {problem}")
        if reference is None:
            return None
        try:
            return pair(matrix, reference, by_number=QualitySettings.of(self.context.state).by_number)
        except LfcalError as error:
            self.refuse(f"other H: {error}")
            return None

    def _show_none(self, path: str) -> None:
        self.panel.readout.hide()
        self.panel.view_buttons["Difference"].hide()
        self.hint.setText(self.spec.hint)
        self.show_no_matrix(
            path,
            "No H yet\nAssemble H from the frames of a scan or a folder, compute it from the camera, or open a file.",
            {
                "Open H …": (OPEN, self.choose_file),
                "Folder": self.lead("frames", "Assemble H from recorded frames"),
                "Compute": self.lead("simulate", "Compute H from the camera and the plan; no recording is needed"),
            },
        )

    @property
    def shown(self) -> bool:
        """Whether the plane is drawn and the depth-plane sums of all planes have been requested."""
        return self._summed is self.matrix

    def _load_sums(self, matrix: PSFMatrix) -> None:
        """Compute all depth-plane sums in the background, one after the other, then all apertures.

        Call it after the visible plane is drawn: reading all of H at the same time halves the speed of drawing.
        """
        if matrix is self._summed:
            return
        self._summed, count = matrix, len(matrix)

        def load(k: int) -> None:
            if k < 2 * count and matrix is self.matrix:
                known = partial(_sum_of if k < count else _apertures_of, matrix, k % count)
                self.context.jobs.compute("psf planes", known, lambda found: done(k, found), lambda _: done(k, {}))

        def done(k: int, found: dict[str, Any]) -> None:
            if matrix is self.matrix:
                self.panel.show_tile(k % count, **found)
                load(k + 1)

        load(0)

    def choose_file(self) -> None:
        """Ask for an H file, and open it."""
        path = QFileDialog.getOpenFileName(self, "Open H", "", FILES)[0]
        if path:
            self.open_file(path)

    def open_file(self, path: str) -> None:
        """Make a file the project's H after checking that it can be opened."""

        def opened() -> None:
            self.notice.clear()
            self.context.project.update("open H", psf=path)
            self._offer_order(again=True)

        self._asked = path
        self.notice.wait(f"Opening {Path(path).name} …", lambda: self.context.matrices.cancel(path))
        self.context.matrices.take(path, opened, self.refuse)

    def accept_drop(self, paths: list[str]) -> bool:
        """Accept a dropped H file."""
        if len(paths) == 1 and takes(paths[0]):
            self.open_file(paths[0])
            return True
        return False

    def receive(self, payload: Any) -> None:
        """Show a position (z, y, x), a level of the inspector or a fit that another page sent.

        A mapping has a ``place`` and a ``view``, which are shown once H and the reference are open.
        """
        if isinstance(payload, str):
            self.look_into(payload)
        elif isinstance(payload, tuple) and len(payload) == 3:
            self.set_intent(z=payload[0], y=payload[1], x=payload[2])
        elif isinstance(payload, dict):
            self._sent = payload
            self._show_sent()
        else:
            self.look_into("fit")
            self.fitting.take(payload)

    def _show_sent(self) -> None:
        """Show what another page sent, if H and its reference are open."""
        if self._sent and self.matrix is not None and self.reference is not None:
            (z, y, x), view = self._sent["place"], self._sent["view"]
            self._sent = {}
            self.set_intent(z=z, y=y, x=x, view=view)

    # -- intent ----------------------------------------------------------------------------------------
    def set_intent(self, **changes: Any) -> None:
        """Change the requested view, and show it."""
        if self.matrix is None:
            return
        there = self.reference is not None
        self.intent = replace(self.intent, **changes).clamped(self.matrix.shape, reference=there)
        if self.intent.view == "fit" and "fitting" in self.__dict__:
            z, y, x = self.panel.fitted.nearest((self.intent.z, self.intent.y, self.intent.x))
            self.intent = replace(self.intent, z=z, y=y, x=x)
        self.panel.show_intent(self.intent, *model.place_words(self.matrix, self.intent))
        if self.plane is None or self.plane.z != self.intent.z:
            self._load_plane()
            self.show_map()
        else:
            self._show_picture()

    def _set_display(self, changes: dict[str, Any]) -> None:
        self.intent = replace(self.intent, display=replace(self.intent.display, **changes))
        self.panel.set_display(self.intent.display)

    def _step(self, dy: int, dx: int) -> None:
        if self.intent.view == "fit":
            self._show_place(self.panel.fitted.step(dy + dx))
        elif self.matrix is not None:
            moved = self.intent.moved(dy, dx, self.matrix.period)
            self.set_intent(y=moved.y, x=moved.x)

    def _step_plane(self, by: int) -> None:
        if self.intent.view == "fit":
            self._show_place(self.panel.fitted.step_plane(by))
        else:
            self.set_intent(z=self.intent.z + by)

    def _show_place(self, place: Place | None) -> None:
        if place is not None:
            self.set_intent(z=place[0], y=place[1], x=place[2])

    def _show_worst(self) -> None:
        if "fitting" in self.__dict__:
            self.fitting.show_worst()

    def _hovered(self, row: int, column: int, value: float) -> None:
        if self._held or self.plane is None:
            return
        pixel = None if row < 0 else (row, column)
        if pixel != self.intent.pixel:
            self.set_intent(pixel=pixel)

    def _hold(self, row: int, column: int) -> None:
        self._held = not self._held
        self.set_intent(pixel=(row, column))

    # -- data --------------------------------------------------------------------------------------------
    def _load_plane(self) -> None:
        """Read the plane in the background; only the newest request is shown."""
        matrix, both, z = self.matrix, self._both, self.intent.z
        assert matrix is not None
        self.plane = self._plane_data = None
        self.panel.show_reading(f"Reading plane {z} …")
        self.panel.show_made(model.made_words(matrix, z))

        def failed(words: str) -> None:
            self.context.message.emit(words)
            if matrix is self.matrix:
                self.panel.show_no_plane(words)
            self._load_sums(matrix)

        self.context.jobs.compute("psf plane", lambda: model.read_plane(matrix, both, z), self._plane_read, failed)

    def _plane_read(self, loaded: PlaneData) -> None:
        self.plane, self.reference_plane, self._levels = loaded.plane, loaded.reference, loaded.levels
        matrix = self.matrix
        if matrix is None or self.plane.z != self.intent.z:
            return
        self._show_picture()
        # in a later turn of the event loop: drawing picture and plane together would block the window
        QTimer.singleShot(0, self, lambda: QTimer.singleShot(0, self, partial(self._show_plane, matrix, loaded)))

    def _show_plane(self, matrix: PSFMatrix, loaded: PlaneData) -> None:
        """Show the data of the whole plane, and fit its aperture in the background."""
        if loaded.plane is not self.plane:
            return
        self._plane_data = loaded
        self.panel.show_plane(loaded)
        QTimer.singleShot(0, self, self.show_map)
        self.context.jobs.compute(
            "psf aperture",
            lambda: _apertures_of(matrix, loaded.plane.z),
            lambda found: self._show_aperture(loaded, found),
            self.panel.aperture_text.setText,
        )
        self._load_sums(matrix)

    def _show_picture(self) -> None:
        if self.intent.view == "fit" and "fitting" in self.__dict__:
            self.panel.fitted.show_place((self.intent.z, self.intent.y, self.intent.x))
            self.panel.readout.setText(*self.panel.fitted.words)
            return
        if self.plane is None:
            return
        assert self.matrix is not None
        intent = self.intent
        picture = model.resolve(intent, self.plane, self.reference_plane)
        unit = model.shown_unit(intent, self.matrix, self.reference)
        show = intent.show if intent.view != "difference" else "measured"
        own = self.panel.own_scale.isChecked()
        ends = (None, None) if own else (self._levels.get(show), self._levels.get("difference"))
        self.panel.show_picture(picture, intent, ends, unit)
        if self.intent is not intent:  # the pointer left a view while it was drawn
            self._show_picture()
        elif self.reference_plane is None and "difference" in (intent.view, show):
            self.panel.readout.setText("The other H has no plane at this depth.")

    def _show_aperture(self, loaded: PlaneData, found: dict[str, Any]) -> None:
        if self.matrix is not None and loaded.plane is self.plane:  # else it is of a plane that was looked at before
            self.panel.show_aperture(found["fitted"], found["expected"], self.matrix.cutout)


def _plain(order: str) -> str:
    """Return a description of an order of axes."""
    return order.replace("-", " ")


def _sum_of(matrix: PSFMatrix, z: int) -> dict[str, Any]:
    return {"image": matrix.depth_sum(z), "made": model.made_words(matrix, z)}


def _apertures_of(matrix: PSFMatrix, z: int) -> dict[str, Any]:
    found = {"fitted": matrix.aperture(z), "expected": model.expected_in(matrix, z)}
    for one in found.values():
        if one is not None:
            one.outline()  # loads what draws it: that held the window's thread for 25 ms
    return found
