"""Multiplexing: filters, masks and lenslets in one formalism, their noise, and reconstructions from their frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QFileDialog

from lfcal.base import drain
from lfcal.camera import Camera
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.models import PageSpec, ProjectState, is_image
from lfcal_gui.pages.multiplex import model as view
from lfcal_gui.pages.multiplex.figures_view import Drawing
from lfcal_gui.pages.multiplex.model import IMAGES, ModulatorPicture, MultiplexSettings
from lfcal_gui.pages.multiplex.model_compare import ModulatorComparison, compare
from lfcal_gui.pages.multiplex.model_scene import Reconstructions, iter_reconstruct, opened, white_of
from lfcal_gui.pages.multiplex.panel import MultiplexPanel
from lfcal_gui.pages.multiplex.search_view import Searching

FILES = ("dead", "white", "transmissions")
CHOSEN = ("family", "cfa", "pattern", "mask", "size", "written", "scene", "filter", "weighted", "noise", "image")
CHOSEN += ("route", "dead", "white", "transmissions", "spacing", "smoothness")

RECONSTRUCTED = (*CHOSEN, "gain")
"""Settings that change what is reconstructed; the gain only with noise."""


class Page(BasePage):
    """Page with settings on the left; modulator and gain, or reconstructions, on the right."""

    def __init__(self, spec: PageSpec, context: Context) -> None:
        super().__init__(spec, context)
        self.panel = MultiplexPanel()
        self.picture: ModulatorPicture | None = None
        self.comparison: ModulatorComparison | None = None
        self.found: Reconstructions | None = None
        self._entered = False
        self._job = 0
        self._request = 0
        self._asked: tuple[Any, ...] = ()
        self._live: tuple[Any, tuple[int, int]] | None = None
        self._live_busy = False
        self._in_colour = ""
        self.set_panel(self.panel)
        self.forms = self.panel.forms
        for form in self.forms:
            form.check = lambda key, value: self.settings.why_not(key, value)
            form.edited.connect(self._edited)
        self.panel.compared.connect(self._compared)
        self.panel.pictures.right_chosen.connect(lambda name: self._edited("right", name))
        self.panel.pictures.sample_chosen.connect(lambda _: self._show_found())
        self.panel.open_asked.connect(self.choose_image)
        self.panel.tabs.currentChanged.connect(lambda _: self._tab_changed())
        self.panel.figures.figure_chosen.connect(lambda number: self._edited("figure", number))
        self.panel.figures.camera_chosen.connect(lambda own: self._edited("own_camera", own))
        self.drawing = Drawing(context, self.panel.figures)
        self.searching = Searching(context, self.panel.search)
        self.searching.used.connect(self._show_design)
        context.frame_seen.connect(self._frame_seen)
        context.jobs.finished.connect(self._job_finished)
        self.theme_changed.connect(self._apply_theme)
        self._show(context.state)

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> MultiplexSettings:
        """The user's settings."""
        return MultiplexSettings.of(self.context.state)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the page if settings or camera changed."""
        if old.camera != new.camera or MultiplexSettings.of(old) != MultiplexSettings.of(new):
            self.searching.follow(new)
            self._show(new)

    def entered(self) -> None:
        """Compute the content and show it."""
        self._entered = True
        self._show(self.context.state)

    def _show(self, state: ProjectState) -> None:
        settings = MultiplexSettings.of(state)
        for form in self.forms:
            form.set_values(vars(settings))
        self._show_used(settings)
        self.panel.show_choices(view.choices_to_compare(settings.family), settings.compared)
        self.panel.pictures.show_right(settings.right)
        self.panel.figures.show_choice(settings.figure, settings.own_camera)
        self.panel.file.setText(Path(settings.image).name if settings.image else "no image opened")
        if not self._entered:
            return
        sensor, name = state.camera.sensor, state.camera.name
        self.panel.show_computing()
        self.context.jobs.compute(
            "multiplex modulator",
            lambda: (view.picture(settings), compare(settings, sensor, name)),
            self._computed,
            self._refused,
        )
        self._tab_changed()

    def _show_used(self, settings: MultiplexSettings) -> None:
        self.panel.show_used(settings, colour=bool(settings.image) and settings.image == self._in_colour)

    def _take_kind(self, path: str, *, colour: bool) -> None:
        """Store whether the opened image is in colour, which determines the fields that apply."""
        if colour != (path == self._in_colour):
            self._in_colour = path if colour else ""
            self._show_used(self.settings)

    def _tab_changed(self) -> None:
        self._reconstruct()
        if self._entered and self.panel.tabs.currentIndex() == 2:
            self.drawing.draw()

    def _computed(self, result: tuple[ModulatorPicture, ModulatorComparison]) -> None:
        self.picture, self.comparison = result
        for step in (*self.panel.drawing(self.picture), lambda: self.panel.curve, self._show_comparison):
            self.context.jobs.later(step)

    def _show_comparison(self) -> None:
        if self.comparison is not None:
            self.panel.show_comparison(self.comparison, self.context.state.camera.name)

    def _refused(self, words: str) -> None:
        self.picture = self.comparison = None
        self.panel.show_refusal(words)
        self.context.message.emit(words)

    # -- widgets -> project ----------------------------------------------------------------------------
    def _edited(self, key: str, value: Any) -> None:
        settings = self.settings.changed(key, value).into(self.context.state)
        if key in FILES:
            self._asked = ()  # chosen again, a file may hold something else
        self.context.project.merge(f"change of {key.replace('_', ' ')}", settings=settings)
        if key in FILES:
            self._reconstruct()

    def _compared(self, ticked: tuple[str, ...]) -> None:
        settings = self.settings
        here = view.choices_to_compare(settings.family)
        self._edited("compared", tuple(n for n in settings.compared if n not in here) + ticked)

    def choose_image(self) -> None:
        """Ask for an image, and open it."""
        path = QFileDialog.getOpenFileName(self, "Open image", "", IMAGES)[0]
        if path:
            self.open_image(path)

    def _show_design(self) -> None:
        """Show a new design of the search; its file may have contained another one before."""
        self._asked = ()
        self.drawing.forget()
        self._show(self.context.state)
        self.panel.tabs.setCurrentIndex(0)

    def open_image(self, path: str) -> None:
        """Open an image as a recorded frame or as a scene after checking that it can be read."""

        def read(found: tuple[Any, Any, str]) -> None:
            self._take_kind(path, colour=found[0] is not None)
            settings = self.settings.changed("image", path).changed("scene", "image")
            self._asked = ()  # opened again, a file may hold something else
            self.context.project.update("open image", settings=settings.into(self.context.state))
            self.panel.tabs.setCurrentIndex(1)
            self._reconstruct()

        self.load(Path(path).name, lambda: opened(path), read)

    def accept_drop(self, paths: list[str]) -> bool:
        """Accept a dropped image."""
        if len(paths) == 1 and is_image(paths[0]):
            self.open_image(paths[0])
            return True
        return False

    # -- reconstruction --------------------------------------------------------------------------------
    def _resolved(self) -> MultiplexSettings:
        """Return the settings with the default white image if none is named."""
        return replace(self.settings, white=white_of(self.context.state))

    def _reconstruct(self) -> None:
        """Reconstruct if the tab is visible and the input changed: scenes immediately, opened images as a job."""
        settings, camera = self._resolved(), self.context.state.camera
        sensor, asked = camera.sensor, _asked(settings, camera)
        if not self._entered or self.panel.tabs.currentIndex() != 1:
            return
        if asked == self._asked:
            self._show_found()
            return
        self._asked, self.found = asked, None
        self._request += 1
        request = self._request
        if self._job:
            self.context.jobs.cancel(self._job)
            self._job = 0
        if settings.scene == "live":
            self._show_live(first=True)
            return
        if settings.scene == "image" and not settings.image:
            self._failed(
                "Open an image: a frame recorded behind this modulator, or a colour image as the scene.", bad=False
            )
            return
        self.panel.pictures.show_reconstructing()
        if settings.scene == "image":
            self._job = self.context.jobs.start(
                f"Demultiplex {Path(settings.image).name}",
                "multiplex",
                lambda: iter_reconstruct(settings, sensor, camera=camera),
                lambda found: self._reconstructed(request, found),
                at_once=True,
            )
        else:
            self.context.jobs.compute(
                "multiplex scene",
                lambda: drain(iter_reconstruct(settings, sensor, camera=camera)),
                lambda found: self._reconstructed(request, found),
                lambda words: self._failed(words) if request == self._request else None,
            )

    def _reconstructed(self, request: int, found: Reconstructions) -> None:
        if request == self._request:
            self.found = found
            if self.settings.scene == "image":
                self._take_kind(self.settings.image, colour=found.truth is not None)
            self._show_found()

    def _show_found(self) -> None:
        if self.found is not None:
            self.panel.pictures.show_reconstructions(self.found, self.settings.right)

    def _failed(self, words: str, *, bad: bool = True) -> None:
        self.found = None
        self.panel.pictures.clear_pictures()
        self.panel.pictures.show_status(words, bad=bad)

    # -- live frames -----------------------------------------------------------------------------------
    def _frame_seen(self, frame: Any, first: tuple[int, int]) -> None:
        """Store the newest frame of the camera, and demultiplex it if the tab is visible."""
        self._live = (frame, first)
        if self._entered and self.isVisible() and self.panel.tabs.currentIndex() == 1:
            self._show_live()

    def _show_live(self, first: bool = False) -> None:
        """Demultiplex the newest frame; of the frames that arrive meanwhile, only the last is used."""
        settings, camera, live = self._resolved(), self.context.state.camera, self._live
        if settings.scene != "live" or self._live_busy:
            return
        if live is None:
            if first:
                self._failed("No live frame yet: connect the camera in Record > Rig (Connect).", bad=False)
            return
        self._live_busy, asked = True, self._asked

        def done(found: Reconstructions) -> None:
            self._live_busy = False
            if asked == self._asked:
                self.found = found
                self._show_found()
            if self._live is not live or asked != self._asked:
                self._show_live()

        def failed(words: str) -> None:
            self._live_busy = False
            if asked == self._asked:
                self._failed(words)
            else:
                self._show_live()

        self.context.jobs.compute(
            "multiplex live", lambda: drain(iter_reconstruct(settings, camera.sensor, live, camera)), done, failed
        )

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._job = 0
        if job.state is JobState.FAILED:
            self._failed(job.error)
        elif job.state is JobState.CANCELLED:
            self._asked = ()
            self._failed("stopped", bad=False)

    def _apply_theme(self) -> None:
        self.panel.apply_theme()
        self._show_comparison()


def _asked(settings: MultiplexSettings, camera: Camera) -> tuple[Any, ...]:
    """Return everything on which a reconstruction depends."""
    noisy = settings.noise or settings.weighted
    keys = RECONSTRUCTED if noisy else CHOSEN
    lattice = camera if settings.route == "lattice" else None
    return (*(getattr(settings, key) for key in keys), camera.sensor if noisy else None, lattice)
