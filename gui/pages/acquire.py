"""Acquire: set the devices up, record a session, see at once whether it is good."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QFileDialog, QTabWidget, QVBoxLayout

from gui.context import Context
from gui.jobs import Job, JobState
from gui.models import acquire_view as view
from gui.models.acquire_view import AcquireSettings, LivePicture
from gui.models.recorder import FolderState, Recorder, RecordPicture, folder_state, record_picture
from gui.models.session import SessionState
from gui.models.stages import Stage
from gui.models.station import Station, open_station
from gui.pages._base import StagePage
from gui.widgets.acquire_record import RecordPanel
from gui.widgets.acquire_setup import FINDINGS, SetupPanel
from lfcal.errors import LfcalError
from lfcal.psf import PSFMatrix
from lfcal.units import format_length, format_seconds

__all__ = ["Page"]

LIVE_MS = 30
POLL_MS = 120


class Page(StagePage):
    """Two tabs over one set of devices."""

    def __init__(self, stage: Stage, context: Context) -> None:
        super().__init__(stage, context)
        self.station: Station | None = None
        self.recorder: Recorder | None = None
        self.folder = FolderState()
        self.found: dict[str, Any] = {}
        self._job = self._find_job = 0
        self._record: Job | None = None
        self._moves: list[Callable[[], Any]] = []
        self._moving = self._connecting = self._looked_for = False
        self._then: Callable[[], None] | None = None
        self.setup, self.record = SetupPanel(context.jobs), RecordPanel(context.jobs)
        self.tabs = QTabWidget()
        self.tabs.setDocumentMode(True)
        self.tabs.addTab(self.setup, "Set up")
        self.tabs.addTab(self.record, "Record")
        layout = QVBoxLayout(self.body)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.tabs)
        self.live_timer = QTimer(self)
        self.live_timer.setSingleShot(True)
        self.live_timer.setInterval(LIVE_MS)
        self.live_timer.timeout.connect(self._look)
        self.poll_timer = QTimer(self)
        self.poll_timer.setInterval(POLL_MS)
        self.poll_timer.timeout.connect(self._poll)
        self._connect_signals()
        context.on_close(self._close_station)
        self._show(context.state)

    def _connect_signals(self) -> None:
        setup, record, context = self.setup, self.record, self.context
        setup.devices.edited.connect(self._devices_edited)
        setup.devices.connect_asked.connect(self.connect_devices)
        setup.devices.disconnect_asked.connect(self.disconnect_devices)
        setup.live_toggled.connect(self._live_toggled)
        setup.find_asked.connect(self.find)
        setup.use_asked.connect(self.use)
        setup.stage.jogged.connect(self.jog)
        setup.stage.plane_asked.connect(self.go_plane)
        setup.stage.stop_asked.connect(self._stop_move)
        record.form.check = self._check_field
        record.form.edited.connect(self._field_edited)
        record.folder_edited.connect(self.set_folder)
        record.folder_asked.connect(self._choose_folder)
        record.view_changed.connect(self._refresh_picture)
        record.plane_asked.connect(self.open_plane)
        record.pressed.connect(self._pressed)
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)
        context.theme_changed.connect(self._apply_theme)

    # -- session ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> AcquireSettings:
        """What the user chose on this page."""
        return AcquireSettings.from_dict(self.context.state.extra.get("acquire"))

    def state_changed(self, old: SessionState, new: SessionState) -> None:
        """Follow plan, settings, recording and redo list."""
        keys = ("plan", "camera", "extra", "recording", "redo")
        if any(getattr(old, k) != getattr(new, k) for k in keys):
            self._show(new, folder=old.recording != new.recording)

    def entered(self) -> None:
        """Look for devices the first time."""
        if not self._looked_for:
            self._looked_for = True
            self.context.jobs.compute("acquire backends", _backends, self._backends_found, self.context.message.emit)

    def _show(self, state: SessionState, *, folder: bool = True) -> None:
        if state.plan is None:
            self.show_empty("Recording needs a scan plan: which positions, planes and cutout.",
                            {"Plan": lambda: self.context.go.emit("plan", None)})  # fmt: skip
            return
        self.show_body()
        self.record.form.set_values(self.settings.values(state.plan))
        self.setup.stage.set_planes(state.plan.depths_um)
        self.record.set_planes(len(state.plan.depths_um))
        chosen = self.settings
        self.setup.devices.set_choice(chosen.backend, dict(chosen.device_options), chosen.stage)
        if self.setup.exposure.value() == self.setup.exposure.minimum():
            self.setup.set_exposure(state.plan.exposures[0])
        self.record.folder.setText(state.recording)
        if folder:
            self._look_into_folder()
        self._show_controls()

    def _update(self, label: str, settings: AcquireSettings, **changes: Any) -> None:
        extra = {**self.context.state.extra, "acquire": settings.to_dict()}
        self.context.session.update(label, extra=extra, **changes)

    def _check_field(self, key: str, value: Any) -> str:
        plan = self.context.state.plan
        try:
            if plan is not None:
                self.settings.changed(plan, key, value)
        except LfcalError as error:
            return str(error)
        return ""

    def _field_edited(self, key: str, value: Any) -> None:
        plan = self.context.state.plan
        if plan is not None:
            settings, changed = self.settings.changed(plan, key, value)
            self._update(f"change of {key.replace('_', ' ')}", settings, plan=changed)

    def _devices_edited(self, backend: str, options: tuple[tuple[str, str], ...], stage: str) -> None:
        self._update("choice of devices", replace(self.settings, backend=backend, device_options=options, stage=stage))

    # -- devices ---------------------------------------------------------------------------------------
    def _backends_found(self, found: tuple[Any, Any, Any]) -> None:
        self.setup.devices.set_backends(*found)
        chosen = self.settings
        self.setup.devices.set_choice(chosen.backend, dict(chosen.device_options), chosen.stage)

    def connect_devices(self) -> None:
        """Open the chosen devices in the background."""
        plan, chosen = self.context.state.plan, self.settings
        if plan is None or self.station is not None or self._connecting:
            return
        self._connecting = True
        self.setup.devices.set_connected("connecting …", connected=False, busy=True)
        self.context.jobs.compute(
            "acquire connect",
            lambda: open_station(plan, chosen.backend, dict(chosen.device_options), chosen.stage),
            self._connected, self._not_connected,
        )  # fmt: skip

    def _connected(self, station: Station) -> None:
        self.station, self._connecting = station, False
        self.setup.devices.set_connected(station.title, connected=True)
        self.setup.stage.set_limits(station.limits)
        self._show_controls()
        if self._then is not None:
            then, self._then = self._then, None
            then()
        else:
            self.setup.live.setChecked(True)

    def _not_connected(self, words: str) -> None:
        self._connecting, self._then = False, None
        self.setup.devices.set_connected(words, connected=False)
        self.context.message.emit(words)
        self._show_controls()

    def disconnect_devices(self) -> None:
        """Release the devices."""
        station, self.station = self.station, None
        if station is not None:
            self.context.jobs.compute("acquire connect", station.close, lambda _: None, self.context.message.emit)
        self.setup.devices.set_connected("", connected=False)
        self.setup.stage.set_limits(None)
        self._show_controls()

    def _close_station(self) -> None:
        if self.station is not None:
            self.station.close()
            self.station = None

    @property
    def at_work(self) -> bool:
        """Whether a job of this page uses the devices."""
        return bool(self._job or self._find_job)

    def _show_controls(self) -> None:
        connected, free = self.station is not None, not self.at_work
        self.setup.set_connected(connected, free=free)
        if connected:
            self.setup.devices.set_free(free)
        recording, there = bool(self._job), self.folder.there is not None
        held = self.recorder is not None and self.recorder.control.pausing
        state, buttons = self.context.state, self.record.buttons
        buttons["start"].setText("Resume session" if there and not self.folder.complete else "Start")
        buttons["start"].setEnabled(free and not self._connecting and not self.folder.complete)
        buttons["pause"].setText("Resume" if recording and held else "Pause")
        for key in ("pause", "stop", "abort"):
            buttons[key].setEnabled(recording)
        count = len(state.redo)
        buttons["redo"].setText(f"Record again ({count})" if count else "Record again")
        buttons["redo"].setEnabled(free and bool(count) and self.folder.complete)
        buttons["assemble"].setEnabled(there and not recording)
        buttons["pack"].setEnabled(self.folder.complete and not recording)
        for widget in (self.record.form, self.record.folder):
            widget.setEnabled(not recording)
        self.record.why.setText(self._advice(recording))

    def _advice(self, recording: bool) -> str:
        if recording:
            return "The session goes on whichever page you look at."
        if self.folder.complete:
            return "Complete. Assemble H, or choose another folder for a new session."
        if self.station is None:
            name = "the simulator" if self.settings.backend == "sim" else self.settings.backend
            return f"Start connects {name} and asks for a folder if there is none."
        if "stage" not in self.found:
            return "The stage's sign is not measured yet: do so under Set up, it takes seconds."
        return ""

    # -- live view -------------------------------------------------------------------------------------
    def _live_toggled(self, on: bool) -> None:
        if on:
            self._look()

    def _look(self) -> None:
        station, plan = self.station, self.context.state.plan
        if station is None or plan is None or self.at_work or not self.setup.live.isChecked():
            return
        exposure, reference = self.setup.exposure.value() / 1e3, self._reference()
        self.context.jobs.compute(
            "acquire live", lambda: view.live_picture(station.look(exposure, plan), plan, reference),
            self._looked, self._live_failed,
        )  # fmt: skip

    def _reference(self) -> PSFMatrix | None:
        state = self.context.state
        try:
            return self.context.matrix(state.reference) or self.context.matrix(state.psf)
        except LfcalError:
            return None

    def _looked(self, picture: LivePicture) -> None:
        self.setup.show_live(picture, self.context.state.camera)
        if self.setup.live.isChecked() and not self.at_work:
            self.live_timer.start()

    def _live_failed(self, words: str) -> None:
        self.setup.live.setChecked(False)
        self.setup.readout.setText(words)
        self.context.message.emit(words)

    # -- stage -----------------------------------------------------------------------------------------
    def jog(self, axis: int, by_um: float) -> None:
        """Move one axis by a step; steps asked for in a hurry are all made, one after the other."""
        if self.station is not None:
            self._queue_move(lambda station=self.station: station.jog(axis, by_um))

    def go_plane(self, z: int) -> None:
        """Go to the middle of the cell in plane ``z``."""
        plan = self.context.state.plan
        if self.station is not None and plan is not None:
            target = view.target_of(plan, z)
            self._queue_move(lambda station=self.station: station.move(target))
            self.setup.set_exposure(plan.exposures[z])

    def _queue_move(self, move: Callable[[], Any]) -> None:
        self._moves.append(move)
        if not self._moving:
            self._next_move()

    def _next_move(self) -> None:
        self._moving = bool(self._moves)
        if self._moves:
            self.context.jobs.compute("acquire move", self._moves.pop(0), self._moved, self._move_failed)

    def _moved(self, stage_um: tuple[float, float, float]) -> None:
        self.setup.stage.set_position(stage_um)
        self._next_move()

    def _move_failed(self, words: str) -> None:
        self._moves.clear()
        self._moving = False
        self.setup.readout.setText(words)
        self.context.message.emit(words)

    def _stop_move(self) -> None:
        self._moves.clear()
        if self.station is not None:
            self.station.moving.stop()

    # -- finding ---------------------------------------------------------------------------------------
    def find(self, key: str) -> None:
        """Measure one of `FINDINGS` as a job."""
        from lfcal.acquire import setup as library

        station, plan = self.station, self.context.state.plan
        if station is None or plan is None or self.at_work:
            return
        options, z = self.settings.options(), max(0, self.setup.stage.plane.currentIndex())
        works: dict[str, Callable[[], Any]] = {
            "stage": lambda: library.iter_stage_fit(station.rig, plan, z=z, options=options),
            "axis": lambda: library.iter_optical_axis(station.rig, plan, options=options),
            "exposure": lambda: library.iter_exposures(station.rig, plan, options=options),
        }
        title = {name: text for name, text, _ in FINDINGS}[key]
        self.setup.show_result(key, "measuring …")
        self._find_job = self.context.jobs.start(
            title, "acquire", lambda: station.use(works[key]()), lambda found: self._found(key, found),
            lambda job: self.setup.show_result(key, f"<b>{job.error}</b>", good=False),
        )  # fmt: skip
        self._show_controls()

    def _found(self, key: str, found: Any) -> None:
        plan = self.context.state.plan
        if plan is None:
            return
        self.found[key] = found
        if key == "stage":
            words, good = view.fit_words(found, plan)
            self.context.attention.emit("acquire", not good)
            self.setup.show_result(key, words, good=good, usable=found.axes != plan.stage)
        elif key == "axis":
            self.setup.show_result(key, view.axis_words(found, plan))
        else:
            self.setup.show_result(key, view.exposure_words(found, plan), usable=True)

    def use(self, key: str) -> None:
        """Take what was found into the plan."""
        plan, found = self.context.state.plan, self.found.get(key)
        if plan is None or found is None:
            return
        if key == "stage":
            changed = replace(plan, stage=found.axes)
            self.context.session.update("stage axes as measured", plan=changed)
            self.context.attention.emit("acquire", False)
            self.setup.show_result(key, "Taken into the plan. Measure again to make sure.")
        else:
            self.context.session.update("exposures as measured", plan=replace(plan, exposure_s=found))
            self.setup.show_result(key, view.exposure_words(found, plan))

    # -- session folder --------------------------------------------------------------------------------
    def _choose_folder(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Folder of the session")
        if path:
            self.set_folder(path)

    def set_folder(self, path: str) -> None:
        """Record into (or go on in) another folder."""
        self.context.session.update("session folder", recording=path)

    def _look_into_folder(self) -> None:
        path = self.context.state.recording
        self.context.jobs.compute("acquire folder", lambda: folder_state(path), self._folder_seen)

    def _folder_seen(self, found: FolderState) -> None:
        self.folder = found
        self.record.folder_words.setText(found.words() if self.context.state.recording else "")
        self._show_controls()
        if self.recorder is None:
            self._refresh_picture()

    def accept_drop(self, paths: list[str]) -> bool:
        """Take a dropped session folder."""
        if len(paths) == 1 and (Path(paths[0]) / "session.json").is_file():
            self.set_folder(paths[0])
            self.tabs.setCurrentWidget(self.record)
            return True
        return False

    # -- recording -------------------------------------------------------------------------------------
    def _pressed(self, key: str) -> None:
        actions: dict[str, Callable[[], None]] = {
            "start": self.start, "pause": self.pause, "stop": lambda: self._ask("stop"),
            "abort": lambda: self._ask("abort"), "redo": lambda: self.start(redo=True), "assemble": self.assemble,
            "pack": self.pack,
        }  # fmt: skip
        actions[key]()

    def start(self, *, redo: bool = False) -> None:
        """Record, or go on, or record the named positions again; connects first if need be."""
        state = self.context.state
        if state.plan is None or self.at_work:
            return
        if not state.recording:
            self._choose_folder()
            if not self.context.state.recording:
                return
        if self.station is None:
            self._then = lambda: self.start(redo=redo)
            self.connect_devices()
            return
        folder = Path(self.context.state.recording)
        now = folder_state(str(folder))
        options = now.options if now.options is not None else self.settings.options()
        self.setup.live.setChecked(False)
        try:
            self.recorder = Recorder(
                folder, state.plan, options, resume=now.there is not None and not redo, redo=state.redo if redo else ()
            )
        except LfcalError as error:
            self.record.show_status("Cannot begin.", str(error), 0.0)
            self.context.message.emit(str(error))
            return
        self.folder = now
        recorder, station = self.recorder, self.station
        self._job = self.context.jobs.start(
            f"Record {folder.name}", "acquire", lambda: recorder.work(station), self._recorded, self._failed
        )
        self.poll_timer.start()
        self._show_controls()

    def pause(self) -> None:
        """Hold, or go on."""
        if self.recorder is not None and self._job:
            control = self.recorder.control
            (control.resume if control.pausing else control.pause)()
            self._show_controls()

    def _ask(self, what: str) -> None:
        if self.recorder is not None and self._job:
            getattr(self.recorder.control, what)()
            self.record.buttons[what].setEnabled(False)

    def _poll(self) -> None:
        """Show the newest frame and the quality; the recording thread never waits for this."""
        if self.recorder is None:
            return
        frame = self.recorder.preview.latest()
        if frame is not None:
            point = None
            if frame.position is not None:
                row, column = self.recorder.plan.image_px(frame.position).tolist()
                point = (row, column)
                if self.record.follow.isChecked():
                    self.record.set_plane(frame.position.z)
            self.record.show_frame(frame, point)
        self._refresh_picture()

    def _refresh_picture(self) -> None:
        plan = self.context.state.plan
        if plan is None:
            return
        recorder, earlier = self.recorder, self.folder.there
        z, quantity = self.record.plane.value(), self.record.quantity.currentData()
        if recorder is None:
            recorder = Recorder(Path(), plan, self.settings.options())
        depths, made = recorder.plan.depths_um, recorder
        self.context.jobs.compute(
            "acquire quality",
            lambda: record_picture(made.quality.state(), made.order, z, quantity, earlier),
            lambda picture: self._show_picture(picture, z, depths),
        )  # fmt: skip

    def _show_picture(self, picture: RecordPicture, z: int, depths: tuple[float, ...]) -> None:
        if z >= len(depths):
            return
        words = f"Plane {z} of {len(depths)}: z = {format_length(depths[z])}" + (", complete" * picture.complete)
        self.record.show_picture(picture, words)
        if not self._job:
            there = self.folder.there is not None
            self.record.show_status(
                "Not recording.", self.folder.words() if there else "", picture.done / max(1, picture.total)
            )
        if picture.alarms and self._job:
            self.context.attention.emit("acquire", True)
        self._lamp = picture.lamp

    def _job_changed(self, job: Job) -> None:
        if job.number != self._job or job.progress is None or self.recorder is None or not job.active:
            return
        record, recorder = job.progress, self.recorder
        rate = recorder.rate
        left = (record.total - record.done) / rate if rate > 0 else None
        words = f"{record.done} of {record.total} positions"
        detail = record.note or (f"{rate:.0f} per second, about {format_seconds(left)} to go" if left else "")
        self.record.show_status(words, detail, record.fraction)

    def _recorded(self, outcome: Any) -> None:
        words = f"{outcome.how}: {outcome.acknowledged} of {outcome.total} positions are safe"
        self.context.message.emit(words)
        if outcome.how == "complete" and self.recorder is not None and self.recorder.redo:
            self.context.session.update("positions recorded again", redo=())

    def _failed(self, job: Job) -> None:
        self.record.show_status("Stopped by a fault.", "", 0.0)
        self.record.why.setText(job.error)
        self.context.attention.emit("acquire", True)

    def _job_finished(self, job: Job) -> None:
        if job.number == self._find_job:
            self._find_job = 0
            if job.state is JobState.CANCELLED:
                for key, label in self.setup.results.items():
                    if label.text() == "measuring …":
                        self.setup.show_result(key, "")
            self._show_controls()
            self._look()
        elif job.number == self._job:
            self._job = 0
            self.poll_timer.stop()
            self._poll()
            self._look_into_folder()
            if job.state is JobState.FAILED:
                self.record.show_status("Stopped by a fault.", job.error, 0.0)

    # -- afterwards ------------------------------------------------------------------------------------
    def open_plane(self, z: int) -> None:
        """Assemble a complete plane beside the recording and show it, while others are being recorded."""
        folder = Path(self.context.state.recording)
        self._assemble(folder / f"plane-{z:02d}.h5", planes=[z])

    def assemble(self, path: str = "") -> None:
        """Assemble H as a job."""
        folder = Path(self.context.state.recording)
        path = path or QFileDialog.getSaveFileName(self, "Assemble H", str(folder / "H.h5"), "H file (*.h5)")[0]
        if path:
            self._assemble(Path(path))

    def _assemble(self, out: Path, planes: list[int] | None = None) -> None:
        from lfcal.acquire.finish import iter_assemble_session

        folder = Path(self.context.state.recording)
        self.context.forget(str(out))
        self.context.jobs.start(
            f"Assemble {out.name}", "acquire", lambda: iter_assemble_session(folder, out, planes=planes),
            self._assembled,
        )  # fmt: skip

    def _assembled(self, report: Any) -> None:
        path = report.matrix.path
        report.matrix.close()
        for note in report.notes:
            self.context.message.emit(f"{Path(path).name}: {note}")
        self.context.session.update("assembly", psf=str(path))
        self.context.go.emit("psf", None)

    def pack(self) -> None:
        """Compress the finished recording as a job."""
        from lfcal.acquire.finish import iter_finish

        folder = Path(self.context.state.recording)
        self.context.jobs.start(
            f"Pack {folder.name}", "acquire", lambda: iter_finish(folder),
            lambda gained: self.context.message.emit(f"packed: {gained / 1e6:.1f} MB gained"),
        )  # fmt: skip

    def _apply_theme(self) -> None:
        self.setup.apply_theme()
        self.record.apply_theme()


def _backends() -> tuple[Any, dict[str, Any], dict[str, bool]]:
    """Return what was found, the options of each backend, and whether it brings a stage."""
    from lfcal.acquire.registry import find_backends, get_backend

    findings = find_backends()
    options, stages = {}, {}
    for finding in findings:
        try:
            backend = get_backend(finding.name)
        except LfcalError:
            continue
        options[finding.name], stages[finding.name] = dict(backend.options), backend.has_stage
    return findings, options, stages
