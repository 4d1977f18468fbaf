"""Use: export H for another code, and reconstruct volumes from light fields."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from PySide6.QtWidgets import QFileDialog, QWidget

from lfcal.base import InputError, LfcalError, Work, format_seconds
from lfcal.psf import empty_words
from lfcal.tasks import ReconstructBars, RunSettings
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import WAITS, JobState, WindowJob
from lfcal_gui.models import (
    CommandStep,
    KeptRun,
    PageSpec,
    ProjectState,
    Shot,
    Taken,
    is_image,
    rough_seconds,
    stated_order,
)
from lfcal_gui.pages.reconstruct._costing import Costing
from lfcal_gui.pages.reconstruct._exporting import Exporting
from lfcal_gui.pages.reconstruct._volume_view import VolumeView
from lfcal_gui.pages.reconstruct.model import ReconstructSettings, device_reason
from lfcal_gui.pages.reconstruct.model_regions import DrawnLabels, labels_file
from lfcal_gui.pages.reconstruct.model_solving import (
    VOLUMES_ALONE,
    OpenedVolume,
    Solving,
    SolvingForecast,
    Synthetic,
    forecast_for,
    light_field,
    make_light_field,
    opened,
    read_volume,
    region_words,
)
from lfcal_gui.pages.reconstruct.panel import ReconstructPanel
from lfcal_gui.pages.reconstruct.step import bars_task, step
from lfcal_gui.saving import ask_target

IMAGES = "Light fields (*.tif *.tiff *.png *.pgm *.npy *.raw *.nef *.cr2 *.dng);;All files (*)"
VOLUMES = (
    "TIFF stack, opens in ImageJ (*.tif);;OME-TIFF with depths (*.ome.tif);;OME-Zarr, a folder (*.ome.zarr);;"
    "HDF5 (*.h5);;numpy (*.npy)"
)
STORED = "Volumes (*.tif *.tiff *.h5 *.hdf5 *.npy);;All files (*)"
STOPPING = "stopping after the current iteration …"
FOLLOWED = ("psf", "light_field", "volume")


class Page(BasePage):
    """Page that exports H, and reconstructs volumes in runs that you can stop and continue."""

    def __init__(self, spec: PageSpec, context: Context, panel: ReconstructPanel | None = None) -> None:
        super().__init__(spec, context)
        self.panel = ReconstructPanel(VolumeView(context.jobs)) if panel is None else panel
        self.image: NDArray[Any] | None = None
        self.solving: Solving | None = None
        self.synthetic: Synthetic | None = None
        self.saved: NDArray[Any] | None = None
        self._opened = ""
        self._ready: tuple[str, NDArray[Any]] | None = None  # read before the project changes
        self._ready_volume: OpenedVolume | None = None
        self._bare = False
        self._saved_as = ""  # file of the volume that was reconstructed here
        self._job = 0
        self._shown_iteration = -1
        self._seconds: float | None = None
        self._facts = spec.hint
        self.exporting = Exporting(self, self.panel.export)
        self.costing = Costing(context, self.panel, self._use, self)
        for segment in self.panel.view.segments:
            self.segments.addWidget(segment)
        self.tools.addWidget(self.panel.view.quantity)
        self.tools.addWidget(self.panel.view.overlay)
        self.tools.addWidget(self.panel.open_volume)
        self.set_panel(self.panel)
        for form in (self.panel.form, self.panel.more):
            context.let_edit(form, lambda: self.settings)
        self.panel.pressed.connect(self._pressed)
        self.panel.make_asked.connect(self.make_light_field)
        self.panel.volume_asked.connect(self.choose_volume)
        view = self.panel.view
        view.said.connect(self._say)
        self.shortcut("PgUp", lambda: view.set_cross(z=view.intent.z - 1))
        self.shortcut("PgDown", lambda: view.set_cross(z=view.intent.z + 1))
        self._follow_context()

    @staticmethod
    def parts(context: Context) -> Iterator[QWidget]:
        """Make the view of the volume, and then the panel."""
        view = VolumeView(context.jobs)
        yield view
        yield ReconstructPanel(view)

    def _follow_context(self) -> None:
        context = self.context
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)
        self.theme_changed.connect(self.panel.apply_theme)
        context.matrices.changed.connect(self._matrix_changed)
        context.on_close(self._close)
        context.jobs.compute("reconstruct device", device_reason, self._device_looked_for, lambda _: None)
        self._show(context.state)
        self._load()
        self._load_volume()

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> ReconstructSettings:
        """The user's settings."""
        return ReconstructSettings.of(self.context.state)

    def let_go(self) -> None:
        """Discard the volume of the previous project, and stop its reconstruction."""
        number, self._job = self._job, 0  # H is closed when the job ends
        if number:
            self.context.jobs.cancel(number)
        else:
            self._close()
        self.solving = self.synthetic = self.saved = self._seconds = None
        self._saved_as = ""
        self.panel.view.remove_regions()
        self.panel.show_no_volume()
        self._show_controls()

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Update the page if H, its verdict, light field, volume or settings changed."""
        self.exporting.show()
        same = ReconstructSettings.of(old) == ReconstructSettings.of(new)
        if not same or any(getattr(old, key) != getattr(new, key) for key in FOLLOWED):
            self._show(new)
            if old.light_field != new.light_field:
                self._load()
            else:
                self._forecast()
            if old.volume != new.volume:
                self._load_volume()

    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return the actions that the next step may request, by name."""
        return {"start": self.start, "export": self.exporting.ask_usual, "folder": self.exporting.show_folder}

    def _matrix_changed(self, path: str) -> None:
        if path == self.context.state.psf:
            self._show(self.context.state)
            self._forecast()

    def _show(self, state: ProjectState) -> None:
        self.context.matrices.want(state.psf)
        matrix = self.context.matrix(self.context.state.psf)
        self._show_bare(matrix is None and self.saved is not None)
        if self._bare:
            self.show_body()
            self._facts = Path(state.volume).name
            self._say(self.panel.view.readout)
            return
        if matrix is None:
            self._facts = self.spec.hint
            self.hint.setText(self.spec.hint)
            self.show_no_matrix(
                state.psf,
                "No H yet\nExport and reconstruction need an H. Assemble or compute one in Record, or open one in H.",
                {
                    "Go to H": self.lead("h", "Open an H that was assembled, simulated or fitted earlier"),
                    "Compute": self.lead("simulate", "Compute H from the camera and the plan; no recording is needed"),
                },
            )
            return
        self.show_body()
        nz, ny, nx, nt, ns = matrix.shape
        said = f"{Path(state.psf).name}: {nz} planes, period {nx} × {ny} px, cutout {ns} × {nt} px"
        self._facts = "; ".join(filter(None, (said, empty_words(matrix))))
        self._say(self.panel.view.readout)
        settings = self.settings
        for form in (self.panel.form, self.panel.more):
            form.set_values(vars(settings))
        self.panel.show_device(settings.device)
        self.panel.show_solver(settings)
        self.exporting.show()
        self.costing.show()
        self._show_file()
        self._show_region()
        self._show_controls()

    def _show_bare(self, bare: bool) -> None:
        """Show a volume without the inspector, which is of use only with H."""
        if bare != self._bare:
            self._bare = bare
            self.panel.area.setHidden(bare)

    def _say(self, words: str) -> None:
        """Show the readout of a voxel or, without a volume, a description of H."""
        self.hint.setText(words or self._facts)

    def _device_looked_for(self, reason: str) -> None:
        self.panel.no_device = reason
        self.panel.show_device(self.settings.device)

    def _use(self, label: str, values: dict[str, Any]) -> None:
        """Use the settings of a measured point."""
        settings = replace(self.settings, **values).into(self.context.state)
        self.context.project.update(f"settings {label}", settings=settings)

    def _show_controls(self) -> None:
        # also of the project before: its run ends after the iteration under way
        jobs = self.context.jobs.jobs()
        running = any(job.active and job.page == self.spec.key and job.kind == "reconstruct" for job in jobs)
        ready, state, panel = self.image is not None, self.context.state, self.panel
        done = self.solving is not None and self.solving.state is not None
        facts: dict[str, Any] = {
            "volume": done or bool(state.volume),
            "voxels": self._voxels(),
        }
        self.context.report(self.spec.key, **facts, reconstruct_s=self._seconds if ready else None)
        same = self.solving is not None and self.solving.fits(state.psf, self.settings, stated_order(state, state.psf))
        same = same and self._opened == state.light_field
        if running:
            panel.show_go("stop")
        elif done and same:
            panel.show_go("more", self.settings.iterations)
        else:
            panel.show_go("start", enabled=ready)
        panel.again.setEnabled(ready and not running)
        panel.save.setVisible(done)
        panel.bars.setEnabled(ready and not running)
        for widget in (panel.form, panel.more, panel.open, panel.make):
            widget.setEnabled(not running)
        if not running:
            panel.show_solver(self.settings)
            panel.show_device(self.settings.device)
        if not done and not running and self.saved is None:
            panel.view.show_none(light_field=bool(state.light_field))

    def _voxels(self) -> tuple[int, int, int]:
        """Return the size (z, y, x) of the volume that would be reconstructed; zeros if it is unknown."""
        matrix, image = self.context.matrix(self.context.state.psf), self.image
        if matrix is None or image is None:
            return 0, 0, 0
        try:
            rows, columns = self.settings.window((image.shape[0], image.shape[1]))
        except LfcalError:
            return 0, 0, 0
        return len(matrix), rows.stop - rows.start, columns.stop - columns.start

    # -- light field -----------------------------------------------------------------------------------
    def choose_light_field(self) -> None:
        """Ask for a light field, and open it."""
        path = QFileDialog.getOpenFileName(self, "Open light field", "", IMAGES)[0]
        if path:
            self.open_light_field(path)

    def open_light_field(self, path: str) -> None:
        """Make an image the light field after checking that it can be read."""
        self.load(Path(path).name, lambda: light_field(path), partial(self._take_light_field, path))

    def _take_light_field(self, path: str, image: NDArray[Any]) -> None:
        self._ready = (path, image)
        self.context.project.update("open light field", light_field=path)
        if self._ready is not None:  # same path as before: the project did not change
            self._load()

    def accept_drop(self, paths: list[str]) -> bool:
        """Accept a dropped light field or volume; an HDF5 file only if this page is visible."""
        if len(paths) != 1:
            return False
        alone = Path(paths[0]).suffix.lower() in VOLUMES_ALONE and self.isVisible()
        taken = alone or is_image(paths[0])
        if taken:
            self.open_any(paths[0])
        return taken

    def open_any(self, path: str) -> None:
        """Open a light field or a volume; an H is opened in the place H."""

        def read(found: NDArray[Any] | OpenedVolume | None) -> None:
            if isinstance(found, OpenedVolume):
                self._take_volume(found)
            elif found is not None:
                self._take_light_field(path, found)
            else:
                self.context.go.emit("h", None)
                self.context.files_offered.emit([path])

        self.load(Path(path).name, lambda: opened(path), read)

    def _load(self) -> None:
        path = self.context.state.light_field
        self.image = None
        self.panel.view.light_field.set_shot(None)
        self._show_controls()
        ready, self._ready = self._ready, None
        self.context.jobs.drop("reconstruct load")
        if ready is not None and ready[0] == path:
            self._loaded(*ready)
        elif path:
            self.panel.view.light_field.blank.wait(f"Opening {Path(path).name} …")
            self.context.jobs.load(
                "reconstruct load",
                lambda: light_field(path),
                lambda image: self._loaded(path, image),
                self._not_loaded,
            )

    def _loaded(self, path: str, image: NDArray[Any]) -> None:
        self.image, self._opened = image, path
        self._show_file()
        matrix = self.context.matrix(self.context.state.psf)
        camera = self.context.state.camera if matrix is None or matrix.camera is None else matrix.camera
        shot = Shot(image, "Light field", name="light_field", pixel_um=camera.sensor.pixel_um)
        self.panel.view.light_field.set_shot(shot, keep_view=False)
        self._show_region()
        self._show_controls()
        self._forecast()

    def _show_file(self) -> None:
        path, image = self.context.state.light_field, self.image
        size = "" if image is None or path != self._opened else f", {image.shape[1]} × {image.shape[0]} px"
        self.panel.file.setText(f"{Path(path).name}{size}" if path else "none yet")

    def _not_loaded(self, words: str) -> None:
        self.panel.view.light_field.blank.wait("")
        self.panel.file.setText(words)
        self.context.message.emit(words)

    def _show_region(self) -> None:
        if self.image is None:
            self.panel.show_region(None)
            return
        try:
            rows, columns = self.settings.window((self.image.shape[0], self.image.shape[1]))
        except LfcalError as error:
            self.panel.show_forecast(str(error))
            return
        self.panel.show_region((rows.start, rows.stop, columns.start, columns.stop))

    def make_light_field(self, phantom: str, path: str = "", shape: tuple[int, int] | None = None) -> None:
        """Project a phantom through H and use the result as the light field."""
        matrix = self.context.matrix(self.context.state.psf)
        if matrix is None or self._job:
            what = "H is being opened" if matrix is None else "a reconstruction is running"
            self.context.message.emit(f"{what}; make a light field afterwards")
            return
        if not path:
            name = Path(self.context.state.psf).with_name(f"{phantom}.tif")
            path = ask_target(self, "Light field to make", str(name), "TIFF (*.tif)")
        if path:
            self.panel.file.setText(f"making {Path(path).name} …")
            self.panel.view.light_field.blank.wait(f"Making {Path(path).name} …")
            begun = self.context.project.begun
            self.context.jobs.compute(
                "reconstruct make",
                lambda: make_light_field(matrix, phantom, path, shape=shape),
                lambda synthetic: self._made(synthetic, begun),
                self._not_loaded,
            )

    def _made(self, synthetic: Synthetic, begun: int) -> None:
        if begun != self.context.project.begun:
            return
        self.synthetic = synthetic
        if self.context.state.light_field == synthetic.path:
            self._load()  # the same file holds something else now
        else:
            self.open_light_field(synthetic.path)

    # -- forecast --------------------------------------------------------------------------------------
    def _forecast(self) -> None:
        matrix, image, settings = self.context.matrix(self.context.state.psf), self.image, self.settings
        if matrix is None or image is None or self._job:
            return
        shape = (image.shape[0], image.shape[1])
        self.panel.show_forecast("forecasting …")
        self.context.jobs.compute(
            "reconstruct forecast", lambda: forecast_for(matrix, shape, settings), self._forecasted, self._no_forecast
        )

    def _forecasted(self, found: SolvingForecast) -> None:
        self._seconds = found.seconds
        self.panel.show_forecast(found.words)
        if not self._job and (self.solving is None or not self.solving.history):
            real = self.context.paces.seconds("reconstruct", found.seconds)
            self.panel.show_took(rough_seconds(real))
        self._show_controls()

    def _no_forecast(self, words: str) -> None:
        self._seconds = None
        self.panel.show_forecast(words)
        self.panel.show_took("")
        self._show_controls()

    # -- solving ---------------------------------------------------------------------------------------
    def _pressed(self, key: str) -> None:
        actions: dict[str, Callable[[], None]] = {
            "open": self.choose_light_field,
            "start": self.start,
            "again": self.start,
            "stop": self.stop,
            "more": self.go_on,
            "save": self.save,
            "bars": self.bars,
        }
        actions[key]()

    def start(self) -> None:
        """Start a new reconstruction."""
        if self.image is None or self._job:
            return
        self._close()
        self.saved = None
        made = self.synthetic
        truth = made.truth if made is not None and made.path == self._opened else None
        state = self.context.state
        order = stated_order(state, state.psf)
        self.solving = Solving(state.psf, self.image, self.settings, truth, mat_order=order)
        self._shown_iteration = -1
        self._run()

    def go_on(self) -> None:
        """Continue the reconstruction for the same number of iterations."""
        if self.solving is not None and not self._job:
            self._run()

    def stop(self) -> None:
        """Stop after the current iteration."""
        if self.solving is not None and self._job:
            self.solving.stop()
            self.panel.show_status(STOPPING, None, busy=True)
        if self._job in self.context.jobs.waiting():
            self.context.jobs.cancel(self._job)

    def _run(self) -> None:
        solving = self.solving
        assert solving is not None
        work = solving.work(self.settings.iterations)
        title = f"Reconstruct by {solving.settings.solver}"
        taken = self.context.taken("reconstruct", title, draft=True)
        jobs, needs = self.context.jobs, (solving.psf,)

        def ended(_: WindowJob) -> None:
            if solving is not self.solving:  # another project was begun meanwhile
                solving.close()

        self._job = jobs.start(
            title, "reconstruct", lambda: work, kind="reconstruct", on_end=ended, abandon=True, needs=needs, taken=taken
        )
        self.panel.show_took("")
        self.panel.show_status(WAITS if self._job in jobs.waiting() else "setting up …", None, busy=True)
        self._show_controls()

    def _job_changed(self, job: WindowJob) -> None:
        if job.number != self._job or job.progress is None or self.solving is None or not job.active:
            return
        record = job.progress
        if self.solving.stopping or job.stopping:
            self.panel.show_status(STOPPING, record.fraction, busy=True)
            return
        words = f"{record.stage}: {record.done} of {record.total}<br>{record.note}"
        self.panel.show_status(words, record.fraction, busy=True)
        self._show_progress()

    def _show_progress(self) -> None:
        solving = self.solving
        if solving is None or not solving.history or solving.history[-1].iteration == self._shown_iteration:
            return
        self._shown_iteration = solving.history[-1].iteration
        self.panel.show_history(solving.history, solving.pixels, solving.errors)
        self._show_volume()

    def _show_volume(self) -> None:
        solving = self.solving
        if solving is None or solving.state is None:
            return
        title = f"Volume after {solving.state.iteration} iterations"
        if solving.psf != self.context.state.psf:
            title += f", by {Path(solving.psf).name}"
        self.panel.view.set_volume(solving.volume, solving.depths, solving.voxel_um, solving.truth, title)

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            if job.page == self.spec.key:
                self._show_controls()
            return
        self._job = 0
        solving = self.solving
        self._show_progress()
        self._show_volume()  # the best estimate may be from an earlier iteration
        if job.state is JobState.FAILED:
            self.panel.show_status(job.error, None, bad=True)
        elif solving is not None and solving.history:
            self.panel.show_status(solving.words(), None)
            self.panel.show_took(f"done in {format_seconds(solving.history[-1].seconds)}", "good")
        else:
            self.panel.show_status("stopped", None)
        self._show_controls()

    def save(self, path: str = "") -> None:
        """Save the reconstructed volume; without a path, ask for one."""
        from lfcal.reconstruct import save_volume

        solving, settings = self.solving, self.settings
        if solving is None or solving.state is None:
            return
        path = path or ask_target(self, "Save volume", "volume.tif", VOLUMES)
        if not path:
            return
        # with all its iterations, for the history
        done = replace(solving.settings, iterations=solving.state.iteration, voxel=settings.voxel)
        state = replace(self.context.state, psf=solving.psf)
        state = replace(state, settings=done.into(state))
        title = f"Reconstruct {Path(path).name} by {done.solver}"
        taken = self.context.taken("reconstruct", title, path, lambda: step(state, path))
        begun, depths = self.context.project.begun, solving.depths

        def write() -> str:
            placed = solving.placed(settings)
            facts = {"depths_um": depths, "voxel_um": placed.voxel_um, "origin_um": placed.details.get("origin_um")}
            save_volume(path, placed.volume, **facts, details=placed.details)
            return path

        self.context.jobs.compute(
            "reconstruct save", write, lambda path: self._volume_saved(path, taken, begun), self.refuse
        )

    def _volume_saved(self, path: str, taken: Taken, begun: int) -> None:
        self.context.history.add(taken)
        self.context.message.emit(f"volume saved as {path}")
        if begun == self.context.project.begun:  # else it is of a project that is no longer open
            self._saved_as = path
            self.context.project.update("reconstruction", volume=path)

    def bars(self, path: str = "") -> None:
        """Reconstruct the light field with error bars as a job, and show the volume; without a path, ask for one."""
        state, drawn = self.context.state, self.panel.view.drawn_labels()

        def made(out: str) -> ReconstructBars:
            return bars_task(state, out, drawn=drawn is not None)

        def files(out: Path) -> tuple[Path, ...]:
            return (*made(str(out)).files("out"), *([labels_file(str(out))] if drawn else []))

        try:
            path = path or ask_target(self, "Volume with error bars", "volume.tif", VOLUMES, files)
            if path:
                self._start_bars(made(path), path, drawn)
        except LfcalError as error:
            self.refuse(str(error))

    def _start_bars(self, task: ReconstructBars, path: str, drawn: DrawnLabels | None) -> None:
        def work() -> Work[Any]:
            if drawn is not None:
                drawn.write(path)
            try:
                # finished replicates of a stopped run are used again
                return (yield from task.work(RunSettings(resume=True)))
            except InputError:
                if drawn is not None:  # such as regions of a volume of another size
                    labels_file(path).unlink(missing_ok=True)
                raise

        title = f"Error bars of {Path(path).name}"
        self.context.jobs.start(
            title,
            "reconstruct",
            work,
            lambda _: self.load(Path(path).name, lambda: read_volume(path), self._take_volume),
            kind="bars",
            keeping=KeptRun(path),
            needs=(str(task.psf),),
            taken=self.context.taken("reconstruct", title, path, lambda: CommandStep.of(task)),
        )

    # -- stored volumes --------------------------------------------------------------------------------
    def choose_volume(self, folder: bool) -> None:
        """Ask for the file of a volume, or for its ``folder``."""
        title = "Open volume"
        path = QFileDialog.getExistingDirectory(self, title) if folder else ""
        path = path if folder else QFileDialog.getOpenFileName(self, title, "", STORED)[0]
        if path:
            self.load(Path(path).name, lambda: read_volume(path), self._take_volume)

    def _take_volume(self, found: OpenedVolume) -> None:
        """Show a volume from a file in place of a reconstructed one."""
        if self._job:
            self.refuse("a reconstruction is running; stop it, then open the volume again")
            return
        self._ready_volume, self._saved_as = found, ""
        self.context.project.update("open volume", volume=found.path)
        if self._ready_volume is not None:  # same path as before: the project did not change
            self._load_volume()

    def _load_volume(self) -> None:
        """Show the volume of the project, unless it was reconstructed here."""
        path, jobs = self.context.state.volume, self.context.jobs
        ready, self._ready_volume = self._ready_volume, None
        if self._job or (self.solving is not None and path in ("", self._saved_as)):
            return
        self._close()
        self.solving = self.saved = None
        self.panel.show_no_volume()
        self._show_controls()
        if self._bare:
            self._show(self.context.state)
        jobs.drop("reconstruct volume")

        def loaded(found: OpenedVolume) -> None:
            if self.solving is None and path == self.context.state.volume:
                self.saved = found.values
                facts = found.facts
                self.panel.view.set_volume(
                    found.values, facts.depths_um, facts.voxel_um, title=Path(path).name, maps=found.maps
                )
                self.panel.show_status(region_words(found.regions), None)
                self._show(self.context.state)

        if ready is not None and ready.path == path:
            loaded(ready)
        elif path and Path(path).exists():
            jobs.load("reconstruct volume", lambda: read_volume(path), loaded, self.refuse)

    def _close(self) -> None:
        if self.solving is not None:
            self.solving.close()
