"""Record > Folder: view recorded frames with their cutouts, correct them, and assemble H."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QFileDialog

from lfcal.base import InputError
from lfcal.frames import Position
from lfcal.frames.lists import TABLE_SUFFIXES
from lfcal.psf import FoundOrientation, find_orientation, forecast_assembly
from lfcal.tasks import Assemble
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import Filling, PageSpec, ProjectState, is_image, options_in
from lfcal_gui.pages.frames import model
from lfcal_gui.pages.frames._import_dialog import ImportDialog
from lfcal_gui.pages.frames._noticed import Noticed
from lfcal_gui.pages.frames.model import FrameSettings, ImportedFrames, Loaded, Opened
from lfcal_gui.pages.frames.model_import import open_choice
from lfcal_gui.pages.frames.orientation import refusal
from lfcal_gui.pages.frames.panel import FramesPanel
from lfcal_gui.saving import ask_target
from lfcal_gui.widgets import button

PLAY_MS = 60


IMPORT = (
    "Import a recorded session, or a folder with a list or with positions in file names. If anything is unclear, a "
    "dialog asks"
)
FILE = (
    "Open the dialog with all settings of an import, for one file that contains many frames or a list in another folder"
)
AGAIN = "Open the same folder again, for example after repairing a file or connecting a disk"


class Page(BasePage):
    """Page with a frame and its cutout; findings and settings for reading frames are on the right."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.opened: Opened | None = None
        self.found: FoundOrientation | None = None
        """Orientation of the frames; None until it is known."""
        self._ready: ImportedFrames | None = None
        """Frames that were opened before the project uses them."""
        self._seconds: float | None = None
        """Approximate duration of assembling H, measured with a few frames (s)."""
        self.loaded: Loaded | None = None
        self.dialog: ImportDialog | None = None
        self.position = Position(0, 0, 0)
        self.noticed = Noticed(context, self.notice, partial(self._edited, "orientation"))
        self.filling = Filling()
        """Progress of the assembly of H."""
        self._assembling = self._opening = self._again = self._fresh = False
        self._unread = ("", "")
        """Folder whose frames cannot be imported, and the reason."""
        self.tool_button("Import any folder …", IMPORT, self.choose_folder)
        self.assemble_button = self.tool_button(
            "Assemble H", "Correct all frames, and assemble H from their cutouts", self.assemble
        )
        self.play_timer = QTimer(self, interval=PLAY_MS)
        self.play_timer.timeout.connect(lambda: self._step(0, 1))
        self.panel = FramesPanel(context.jobs)
        self.list_button = button("File or list …", FILE, self.start_import)
        self.panel.choices.fold_line(self.list_button)
        self.set_panel(self.panel)
        self._connect_panel()
        self._add_shortcuts()
        self.theme_changed.connect(self.panel.apply_theme)
        context.jobs.changed.connect(self._fill)
        self._open()

    def _connect_panel(self) -> None:
        panel = self.panel
        panel.plane_slider.valueChanged.connect(lambda z: self.go_to(self.position._replace(z=z)))
        panel.map.chosen.connect(lambda y, x: self.go_to(Position(self.position.z, y, x)))
        panel.play_button.toggled.connect(lambda on: self.play_timer.start() if on else self.play_timer.stop())
        panel.choices.edited.connect(self._edited)
        panel.before_box.toggled.connect(lambda _: self._show_pixels())
        panel.lattice_box.toggled.connect(lambda _: self._show_overlays())
        panel.three_toggled.connect(self._show_three)

    def _add_shortcuts(self) -> None:
        panel, slider = self.panel, self.panel.plane_slider
        self.shortcut("Left", lambda: self._step(0, -1))
        self.shortcut("Right", lambda: self._step(0, 1))
        self.shortcut("Up", lambda: self._step(-1, 0))
        self.shortcut("Down", lambda: self._step(1, 0))
        self.shortcut("PgUp", lambda: slider.setValue(self.position.z - 1))
        self.shortcut("PgDown", lambda: slider.setValue(self.position.z + 1))
        self.shortcut("Space", panel.play_button.toggle)
        self.shortcut("Escape", self.stop)
        self.shortcut("L", lambda: panel.toggle_scale("log"))
        self.shortcut("G", lambda: panel.toggle_scale("gamma"))

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> FrameSettings:
        """The user's settings."""
        return FrameSettings.of(self.context.state)

    def let_go(self) -> None:
        """Discard everything about the frames of the previous project."""
        self._unread, self._again, self._fresh = ("", ""), False, False

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Open the frames of the project again if the frames, the plan or the settings changed."""
        changed = old.frames != new.frames or old.plan != new.plan
        if old.frames != new.frames:
            self.context.attention.emit("frames", False)
            self._unread = "", ""
            self._fresh = bool(new.psf) and old.psf == new.psf
        elif old.psf != new.psf:
            self._fresh = False
        if changed or FrameSettings.of(old) != FrameSettings.of(new):
            self._open()
        self._report()

    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return the actions that the next step may request, by name."""
        return {
            "import": self.choose_folder,
            "columns": lambda: self.start_import(self._unread[0]),
            "assemble": lambda: self.assemble(self._own_file()),
            "correct_dark": self._correct_dark,
        }

    def _own_file(self) -> str:
        name = Path(self.context.state.frames).name
        return self.context.own_path("H.h5" if name == "frames" else f"{name}_H.h5")

    def _correct_dark(self) -> None:
        """Subtract the dark frames, and make H again once the frames are open."""
        self._again = True
        self._edited("use_dark", True)

    def _report(self) -> None:
        opened, settings = self.opened, self.settings
        path, why = self._unread
        # without H, the button of the next step assembles it
        self.assemble_button.setVisible(bool(self.context.state.psf) and not self._fresh)
        self.context.report(
            "frames",
            folder=bool(self.context.state.frames or path),
            unread=why,
            frames=0 if opened is None else int((opened.frames >= 0).sum()),
            missing=0 if opened is None else opened.missing,
            fresh=self._fresh,
            make_s=self._seconds,
            corrections=("dark",) if settings.dark and not settings.use_dark else (),
        )

    def _edited(self, key: str, value: Any) -> None:
        if not hasattr(self.settings, key):
            self._set_option(key, value)
            return
        named = f"{key.removeprefix('use_')} correction" if key.startswith("use_") else key.replace("_", " ")
        changes: dict[str, Any] = {key: value}
        self.context.project.update(named, settings=replace(self.settings, **changes).into(self.context.state))

    def _set_option(self, key: str, value: Any) -> None:
        """Change a field of the task; refuse a value that contradicts another."""
        options = {**self.settings.option_values, key: value}
        try:
            chosen = options_in(Assemble, options)
            # a project is written as JSON, which has no paths
            plain = {name: str(one) if isinstance(one, Path) else one for name, one in chosen.items()}
            settings = replace(self.settings, options=tuple(sorted(plain.items())))
            settings.usable()
        except InputError as error:
            self.refuse(str(error))
            self.panel.choices.show_settings(self.settings)
            return
        self.context.project.update(key.replace("_", " "), settings=settings.into(self.context.state))

    def choose_folder(self) -> None:
        """Ask for a folder of frames, and import it."""
        path = QFileDialog.getExistingDirectory(self, "Folder of frames")
        if path:
            self.open_folder(path)

    def open_folder(self, path: str) -> None:
        """Import the frames of a folder with dark frames, white frames and plan near it.

        If this fails, the dialog for frames from other programs opens.
        """
        settings, plan = self.settings, self.context.state.plan

        def failed(words: str) -> None:
            # the dialog has the choices that frames of others may need
            self._unread = path, f"choose how the frames of {Path(path).name} are read"
            self._report()
            self.refuse(words)
            self.start_import(path)

        name = Path(path).name
        self.load(name, lambda: model.import_folder(path, settings, plan), self._imported, ImportedFrames.close, failed)

    def start_import(self, frames: str = "", listed: str = "") -> None:
        """Open the dialog that imports frames from other programs."""
        if self.dialog is None:  # reused: pictures drawn for it may arrive after it was closed
            self.dialog = ImportDialog(self.context.jobs, self)
            self.theme_changed.connect(self.dialog.apply_theme)
            self.dialog.accepted_frames.connect(lambda found: self._imported(open_choice(found, self.settings)))
        self.dialog.start(self.context.state.plan, self.context.state.camera)
        if frames:
            self.dialog.look_at(frames, listed)

    def _imported(self, found: ImportedFrames) -> None:
        changes: dict[str, Any] = {"frames": found.folder, "settings": found.settings.into(self.context.state)}
        if found.plan is not None:
            changes |= {"plan": found.plan, "camera": found.plan.camera}
        self._ready = found
        if not self.context.project.update("open frames", **changes):
            self._ready = None
            found.close()
        elif self._ready is not None:  # same path as before: the project did not change
            self._open()

    def accept_drop(self, paths: list[str]) -> bool:
        """Accept a dropped folder or list of frames; an image file of all frames only if this page is visible."""
        if len(paths) == 1 and Path(paths[0]).is_dir():
            self.open_folder(paths[0])
            return True
        listed = len(paths) == 1 and Path(paths[0]).suffix.lower() in TABLE_SUFFIXES
        if listed or (len(paths) == 1 and self.isVisible() and is_image(paths[0])):
            self.start_import(paths[0])
            return True
        return False

    def receive(self, payload: Any) -> None:
        """Show a position (z, y, x) another page sent."""
        if isinstance(payload, tuple) and len(payload) == 3:
            self.go_to(Position(*payload))

    def _open(self) -> None:
        state, settings = self.context.state, self.settings
        if self._opening:  # outdated: other frames or other settings
            self._opening = False
            self.context.jobs.drop("frames open")
            self.notice.clear()
        self.panel.choices.show_settings(settings)
        self.opened = self.found = self.loaded = self._seconds = None
        self.hint.setText(self.spec.hint)
        self.assemble_button.setEnabled(False)
        if not state.frames:
            self.show_empty(
                "No frames yet\nImport a folder of frames that this or another program recorded, or drop one here."
                "\nFolders named dark and white in the same folder, and plan.json, are found automatically.",
                {"Import any folder …": (IMPORT, self.choose_folder), "File or list …": (FILE, self.start_import)},
            )
            return
        if state.plan is None:
            self.show_empty(
                "No scan planned yet\nThe plan states the positions of the frames, and the cutout.",
                {"Go to Set up": self.lead("setup", "Choose the source positions and depth planes of the scan")},
            )
            return
        self.show_body()
        folder, plan = state.frames, state.plan
        ready, self._ready = self._ready, None
        if ready is not None and (ready.folder, ready.settings, ready.plan) == (folder, settings, plan):
            self._opened(ready.opened)
            return
        self.panel.position_label.setText("opening frames …")
        self.panel.show_reading("Opening frames …")
        self._opening = True
        self.notice.wait(f"Opening {Path(folder).name} …", self._stop_opening)
        self.context.jobs.load(
            "frames open",
            lambda: model.open_imported(folder, settings, plan),
            self._opened,
            self._failed,
            lambda opened: opened.close(),
        )

    def _stop_opening(self) -> None:
        self.context.jobs.drop("frames open")
        self._failed("The frames were not opened, because you stopped the import")

    def _failed(self, words: str) -> None:
        self._opening = False
        self.notice.clear()
        folder = self.context.state.frames
        self._unread = folder, f"import the frames again: “{Path(folder).name}” is not open"
        self._report()
        self.show_empty(words, {"Import any folder …": (IMPORT, self.choose_folder), "Try again": (AGAIN, self._open)})
        self.context.message.emit(words)

    def _opened(self, opened: Opened) -> None:
        self._opening = False
        self._unread = "", ""
        self.notice.clear()
        self.opened = opened
        self._report()
        self.filling = Filling()
        self.assemble_button.setEnabled(True)
        rows, columns = opened.view.shape
        self.hint.setText(f"{len(opened.source)} frames of {columns} × {rows} px")
        # these frames may have fewer planes than those before, and not all positions
        self.position = opened.recorded(self.position)
        self.panel.choices.show_positions(opened.positions)
        self.panel.choices.show_dark(opened.dark, wanted=opened.chosen.use_dark)
        self.noticed.tell_left_out(opened.left_out)
        self.panel.set_planes(opened.frames.shape[0])
        self._show_found()
        self._show_three(self.panel.three_button.isChecked())
        self._show_map()
        self.go_to(self.position)
        if self._again:
            self._again = False
            self.assemble(self._own_file())
        self.context.jobs.compute(
            "frames orientation",
            lambda: find_orientation(opened.delivered.corrected, opened.plan),
            lambda found: self._take_orientation(opened, found),
            self.context.message.emit,
        )
        self.context.jobs.compute(
            "frames forecast",
            lambda: forecast_assembly(opened.delivered.corrected, opened.plan),
            lambda seconds: self._forecasted(opened, seconds),
            lambda _: None,  # a frame that cannot be read is reported where it is looked at
        )

    def _forecasted(self, opened: Opened, seconds: float) -> None:
        if opened is self.opened:
            self._seconds = seconds
            self._report()

    def _take_orientation(self, opened: Opened, found: FoundOrientation) -> None:
        if opened is self.opened:
            self.found = found
            self._show_found()
            self._offer_turn()

    def _show_found(self) -> None:
        if self.opened is not None:
            mark, head, words = model.understood(self.opened, self.found, self.settings.orientation)
            self.panel.show_found(mark, head, words, model.facts_of(self.opened))

    def _show_three(self, on: bool) -> None:
        opened = self.opened
        if on and opened is not None:
            self.context.jobs.compute(
                "frames three",
                lambda: model.first_middle_last(opened),
                lambda shown: self.panel.three.show_frames(shown) if opened is self.opened else None,
                self.context.message.emit,
            )

    def _offer_turn(self, before: str = "") -> None:
        self.noticed.offer_turn(self.opened, self.found, self.settings.orientation, before)

    # -- stepping --------------------------------------------------------------------------------------
    def go_to(self, position: Position) -> None:
        """Show the frame of a position."""
        if self.opened is None:
            self.position = position
            return
        changed_plane = self.opened.place(position).z != self.position.z
        self.position = where = self.opened.place(position)
        self.panel.show_position(*where)
        if changed_plane:
            self._show_map()
        opened = self.opened
        if opened.frames[where] < 0:
            self.loaded = None
            self.panel.show_missing(f"z {where.z}, y {where.y}, x {where.x}: no frame")
            return

        def loaded(found: Loaded) -> None:
            if opened is self.opened and where == self.position:  # else another frame is shown by now
                self._loaded(found)

        def failed(words: str) -> None:
            self.context.message.emit(words)
            if opened is self.opened and where == self.position:  # do not leave another frame's picture
                self.loaded = None
                self.panel.show_missing(words, "This frame cannot be read.")
                if not opened.chosen.skip_damaged:
                    self.noticed.offer_without(words, lambda: self._edited("skip_damaged", True))

        self.panel.show_reading("Reading the frame …")
        self.context.jobs.compute("frames load", lambda: model.load_frame(opened, where), loaded, failed)

    def _step(self, dy: int, dx: int) -> None:
        if self.opened is not None:
            self.go_to(self.opened.step(self.position, dy, dx))

    def _show_map(self) -> None:
        """Show the plane that is being assembled, or else the selected plane."""
        if self.opened is not None:
            z = self.filling.plane if self._assembling and self.filling.plane is not None else self.position.z
            frames = self.opened.frames[z]
            words = self.filling.words(z, len(self.opened.frames), under_way=self._assembling)
            self.panel.show_map(frames >= 0, self.filling.light(z), words)

    def _fill(self, job: WindowJob) -> None:
        """Show H during its assembly: each position as soon as it has a pattern."""
        if job.page != self.spec.key or not self.filling.follows(job.number, job.progress):
            return
        self._assembling = job.active
        if self.filling.take(job.progress) or not job.active:
            self._show_map()

    def _loaded(self, loaded: Loaded) -> None:
        self.loaded = loaded
        self.noticed.forget_damage()
        self.panel.show_frame(loaded)
        self._show_overlays()

    def _show_pixels(self) -> None:
        if self.loaded is not None:
            self.panel.show_pixels(self.loaded)

    def _show_overlays(self) -> None:
        self.panel.show_overlays(self.context.state.camera, None if self.opened is None else self.loaded)

    # -- assembly --------------------------------------------------------------------------------------
    def assemble(self, path: str = "") -> None:
        """Assemble H as a job, unless the orientation of the frames is known to differ from the plan."""
        if self.opened is None:
            self.refuse("there are no frames to assemble; import some first")
            return
        if self._refused():
            return
        path = path or ask_target(self, "Assemble H", "H.h5", "H file (*.h5)")
        if not path:
            return
        opened, title = self.opened, f"Assemble {Path(path).name}"
        self.context.start_writing(
            title,
            "frames",
            path,
            lambda: model.iter_assembly(opened, path),
            self._assembled,
            lambda _: self._refused(),
            taken=self.context.taken("frames", title, path),
        )

    def _refused(self) -> bool:
        """Return whether H cannot be assembled in this orientation; if so, report it and offer a remedy."""
        refused = self.found is not None and bool(refusal(self.found, self.settings.orientation))
        if refused:
            self._offer_turn("No H: ")
        return refused

    def _assembled(self, report: Any) -> None:
        path = report.matrix.path
        notes = model.notes_of(report)
        report.matrix.close()
        for note in notes:
            self.context.message.emit(f"{Path(path).name}: {note}")
        self.context.attention.emit("frames", bool(report.missing or report.saturated))
        self.context.project.update("assembly", psf=path)
        self._fresh = False
        self._report()
        self.context.made.emit("h", None)
