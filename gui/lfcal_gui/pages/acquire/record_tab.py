"""Record > Rig: run a session, monitor it, and assemble its H."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, QTimer, Signal

from lfcal.acquire import EarlierFrames, check_fixed
from lfcal.base import LfcalError, StorageError, format_length
from lfcal.camera import ScanPlan
from lfcal.frames import Position
from lfcal_gui.context import Context
from lfcal_gui.jobs import WindowJob
from lfcal_gui.models import Hold, ProjectState, ScanRates, kept_verdict, plane_words, said_in_window
from lfcal_gui.pages.acquire import model_recorder
from lfcal_gui.pages.acquire._after import Afterwards
from lfcal_gui.pages.acquire._choices import FolderChoice, TargetChoice
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_folder import FolderState, folder_state
from lfcal_gui.pages.acquire.model_recorder import Recorder, RecordPicture
from lfcal_gui.pages.acquire.model_station import Station
from lfcal_gui.pages.acquire.record_panel import RecordPanel
from lfcal_gui.pages.acquire.setup_tab import SetupTab
from lfcal_gui.pages.acquire.step import REDO_FILE, step
from lfcal_gui.widgets import expected_apertures

POLL_MS, HIDDEN_MS, READ_MS, FRAME_MS = 120, 1000, 250, 80
"""Periods (ms) of updates of a visible and of a hidden session, of reading earlier frames, and of the newest frame."""
EARLIER = "acquire earlier frames"
HELD = "a session is being recorded: camera, plan and devices cannot change until it ends"


class RecordTab(QObject):
    """Run sessions with the devices of a `SetupTab`; frames and quality data are polled by a timer."""

    ended = Signal()
    """A recording ended for any reason."""
    shown = Signal()
    """The enabled buttons or the advice changed."""
    asked = Signal(str, arguments=["words"])
    """Request to the user that must be met before the recording continues; empty: the request has ended."""

    _alarms: tuple[str, ...] = ()
    """Current alarms of the recording."""

    def __init__(self, context: Context, setup: SetupTab, panel: RecordPanel, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.context, self.setup, self.panel = context, setup, panel
        self.recorder: Recorder | None = None
        self._opened: Recorder | None = None
        """Recorder that describes the folder while no recording is running."""
        self._reading: EarlierFrames | None = None
        self.folder = FolderState()
        self.after = Afterwards(context, panel, lambda: self.recording)
        self.target = TargetChoice(context, self._target_read)
        self.folder_choice = FolderChoice(context, panel.folder, self._folder_seen, self._refuse)
        self._job, self._lamp, self._refused, self._asked = 0, "", False, ""
        self._stopped, self._plane, self._follows = "", 0, True
        """Why the last recording ended early, its last plane, and whether the display follows the recording."""
        self._expected_of: tuple[Any, ...] = ()
        """Camera, depths and cutout whose apertures are shown."""
        self._under_way: WindowJob | None = None  # the recording as it was reported last
        self.poll_timer, self.frame_timer, self.read_timer = QTimer(self), QTimer(self), QTimer(self)
        for timer, ms, action in (
            (self.poll_timer, POLL_MS, self._poll),
            (self.frame_timer, FRAME_MS, self._poll_frame),
            (self.read_timer, READ_MS, self.refresh),
        ):
            timer.setInterval(ms)
            timer.timeout.connect(action)
        for form in panel.forms:
            form.check = self._check_field
            form.edited.connect(self._field_edited)
        panel.extent.currentIndexChanged.connect(lambda _: self._field_edited("extent", panel.extent.currentData()))
        panel.folder_edited.connect(self.folder_choice.take)
        panel.folder_asked.connect(self.folder_choice.ask)
        panel.choose_target.clicked.connect(lambda: self.target.ask(panel))
        panel.view_changed.connect(self.refresh)
        panel.strip.chosen.connect(self._plane_chosen)
        panel.strip.itemClicked.connect(lambda _: self._go(panel.z))
        panel.open_plane.clicked.connect(lambda: self.after.open_plane(panel.z))
        panel.pressed.connect(self._pressed)
        setup.changed.connect(self.show_controls)
        context.jobs.changed.connect(self._job_changed)
        context.jobs.finished.connect(self._job_finished)

    @property
    def recording(self) -> bool:
        """Whether a session is being recorded."""
        return bool(self._job)

    def show_state(self, state: ProjectState, *, folder: bool) -> None:
        """Show plan, settings and folder; ``folder`` states whether the folder changed."""
        self.panel.folder.setText(state.recording)
        self._refused = False  # the refusal is out of date: its context has changed
        if folder:
            if not self.recording:
                self._forget()
            self.folder_choice.look()
        if state.plan is None:
            return
        settings = AcquireSettings.of(state)
        self.target.follow(settings.target)
        self.panel.show_target(Path(settings.target).name)
        self.panel.set_values(settings.values(state.plan), settings.extent)
        self._show_planes(state.plan)
        self.show_controls()
        if self.recorder is None:
            self.refresh()

    def _show_planes(self, plan: ScanPlan) -> None:
        """Show the planes of a plan with their expected apertures."""
        strip = self.panel.strip
        strip.offer(plan.depths_um, plan.cutout)
        self._set_plane(self.panel.z)
        if self._expected_of != (asked := (plan.camera, plan.depths_um, plan.cutout)):
            self._expected_of = asked
            self.context.jobs.compute("acquire apertures", lambda: expected_apertures(plan), strip.show_expected)

    def _show_merits(self, planes: int) -> None:
        """Show the merit of each plane if the H of this session was judged."""
        state, merits = self.context.state, [""] * planes
        verdict = kept_verdict(state) if self.folder.there is not None else None
        if verdict is not None and Path(state.psf).parent == Path(state.recording):
            again = {place[0] for place in verdict.redo}
            merits = ["bad" if z in again else verdict.rest for z in range(planes)]
        self.panel.show_merits(merits)

    def _set_plane(self, z: int) -> None:
        self.setup.panel.z = z
        self.panel.set_plane(z)

    def _plane_chosen(self, z: int) -> None:
        """Show the selected plane. If it is the one being recorded, the display follows the recording again."""
        self._follows = not self.recording or z == self._plane
        self._set_plane(z)
        self.refresh()

    def _go(self, z: int) -> None:
        if self.setup.station is not None and self.setup.free:
            self.setup.moves.go_plane(z)

    def let_go(self) -> None:
        """Stop opening and reading folders for the previous project."""
        self.folder_choice.let_go()
        for group in ("acquire start", "acquire remake", EARLIER):
            self.context.jobs.drop(group)

    def _forget(self) -> None:
        """Discard the earlier recording, which belongs to another folder."""
        self.context.jobs.drop(EARLIER)
        self.recorder, self._opened, self.folder, self._lamp = None, None, FolderState(), ""
        self._stopped, self._alarms = "", ()
        self.panel.show_status("", "", 0.0)
        self._attend()

    def _check_field(self, key: str, value: Any) -> str:
        state = self.context.state
        try:
            if state.plan is not None:
                AcquireSettings.of(state).changed_on(state.plan, key, value)
        except LfcalError as error:
            return str(error)
        return HELD if self.recording else ""

    def _field_edited(self, key: str, value: Any) -> None:
        state = self.context.state
        if state.plan is not None:
            settings, plan = AcquireSettings.of(state).changed_on(state.plan, key, value)
            self.context.project.merge(f"change of {key.replace('_', ' ')}", plan=plan, settings=settings.into(state))

    def _target_read(self, words: str) -> None:
        if words:
            self._refuse(words)
        self.show_controls()
        if self.recorder is None:
            self.refresh()

    def _refuse(self, words: str) -> None:
        self._refused = True
        self.panel.show_status("Cannot start.", words, 0.0)
        self.context.message.emit(words)

    def _folder_seen(self, found: FolderState) -> None:
        self.folder, self._opened = found, None
        self.panel.say_of_folder(found.words() if self.context.state.recording else "")
        self.show_controls()
        if self.recorder is None:
            self.refresh()

    def show_controls(self) -> None:
        """Enable the buttons that apply, and show advice on the next step."""
        buttons, state, recording = self.panel.buttons, self.context.state, self.recording
        there, complete, many = self.folder.there is not None, self.folder.complete, self.folder.target is not None
        # a session of chosen positions can be continued to a smaller error
        more = not complete or (self.folder.chosen is not None and AcquireSettings.of(state).extent == "error")
        free = self.setup.free and not recording
        held = self.recorder is not None and self.recorder.control.pausing
        buttons["start"].setText("Resume session" if there and more else "Start")
        buttons["start"].setEnabled(free and not self.setup.connecting and more)
        buttons["pause"].setText("Resume" if recording and held else "Pause")
        for key in ("pause", "stop", "abort"):
            buttons[key].setEnabled(recording)
        count = len(state.redo)
        buttons["redo"].setText(f"Record again ({count})" if count else "Record again")
        buttons["redo"].setEnabled(free and bool(count) and complete)
        for key in ("assemble", "fit"):
            buttons[key].setEnabled(there and not recording and not (many and key == "fit"))
        buttons["pack"].setEnabled(complete and not recording)
        panel = self.panel
        panel.show_buttons(startable=more and not recording)
        for widget in (panel.choose_target, *panel.forms, panel.extent, panel.folder):
            widget.setEnabled(not recording)
        station, settings = self.setup.station, AcquireSettings.of(state)
        # what has no effect is not shown
        automatic = station is not None and bool(station.devices.automatic)
        panel.form.set_shown("allow_automatic", automatic or settings.allow_automatic)
        panel.form.set_shown("steady", bool(settings.suspend))
        panel.form.set_shown("cover", settings.cover or station is None or station.rig.light is None)
        panel.form.set_shown("positions", settings.extent == "whole" and not settings.target)
        panel.form.set_shown("unknowns", settings.extent == "error")
        self._show_error()
        backend = settings.backend if station is None else ""
        measured = "stage" in self.setup.measuring.found
        words = model_recorder.advice_words(self.folder, recording=recording, backend=backend, measured=measured)
        if station is not None and not (recording or there):
            words = model_recorder.automatic_words(station.devices, settings.options()) or words
        self.panel.why.setText(words)
        self._report()
        self.shown.emit()

    def _report(self) -> None:
        recorder, job = self.recorder, self._under_way
        facts: dict[str, Any] = {
            "rig": self.setup.station is not None,
            "rig_measured": "stage" in self.setup.measuring.found,
            "free_bytes": self.folder.free_bytes,
            "recording": self.recording,
            "stopped": self._stopped,
        }
        if plan := self.context.state.plan:
            facts |= model_recorder.target_facts(self.target.shown(plan, self.folder), ScanRates.of(self.context.state))
        done, total = self.folder.counts
        if self.recording and recorder is not None:
            facts |= {"paused": recorder.control.pausing, "plane": self._plane}
            if job is not None and job.progress is not None:
                done, total = job.progress.done, job.progress.total
                facts |= {"left_s": (total - done) / recorder.rate if recorder.taken else None}
        self.context.report("acquire", **facts)
        self.context.report("session", done=done, total=total)

    def resume(self) -> None:
        """Resume a paused recording or an incomplete session."""
        (self.pause if self.recording else self.start)()

    # -- recording -------------------------------------------------------------------------------------
    def _pressed(self, key: str) -> None:
        actions: dict[str, Callable[[], None]] = {
            "start": self.start,
            "pause": self.pause,
            "stop": self.stop,
            "abort": lambda: self._ask("abort"),
            "redo": lambda: self.start(redo=True),
            "assemble": self.after.assemble,
            "fit": lambda: self.after.fit(self._fit_of_folder()),
            "pack": self.after.pack,
        }
        actions[key]()

    def start(self, *, redo: bool = False) -> None:
        """Start or continue the session, or record the listed positions again; connect first if necessary."""
        state = self.context.state
        if state.plan is None or self.recording or not self.setup.free:
            return
        self._refused = False
        if not state.recording:
            self.folder_choice.ask(lambda: self.start(redo=redo))
            return
        if self.setup.station is None:
            self.setup.connect_devices(lambda: self.start(redo=redo))
            return
        path = state.recording
        self.context.jobs.load(
            "acquire start", lambda: folder_state(path), lambda now: self._begin(now, redo=redo), self._refuse
        )

    def _begin(self, now: FolderState, *, redo: bool) -> None:
        state, folder, station = self.context.state, Path(self.context.state.recording), self.setup.station
        if state.plan is None or station is None or self.recording or not self.setup.free:
            return
        self.folder = now
        try:
            recorder = self._recorder(now, station, redo=redo)
        except LfcalError as error:
            self._refuse(said_in_window(str(error)))
            return
        self.recorder, self._stopped, self._alarms, self._follows = recorder, "", (), True
        recorded = partial(step, state, str(folder), resume=recorder.resume, redo=state.redo if redo else ())
        self._attend()
        self._set_job(
            self.context.jobs.start(
                f"Record {folder.name}",
                "acquire",
                lambda: recorder.work(station),
                self._recorded,
                self._failed,
                at_once=True,
                taken=self.context.taken("acquire", f"Record {folder.name}", str(folder), recorded),
            )
        )
        self._under_way = next((job for job in self.context.jobs.jobs() if job.number == self._job), None)
        self._show_progress()
        self.poll_timer.start()
        self.frame_timer.start()

    def _recorder(self, now: FolderState, station: Station, *, redo: bool) -> Recorder:
        """Return the recorder for the folder; raise `LfcalError` if recording is refused."""
        state, folder = self.context.state, Path(self.context.state.recording)
        assert state.plan is not None
        if now.problem:  # what is damaged is not recorded over
            raise StorageError(now.problem)
        begun, again = now.there is not None, state.redo if redo else ()
        listed = str(folder / REDO_FILE) if again else ""
        plan_file = str(folder / "session.json")  # the plan of the project has no file
        origin = state.plan.stage.origin_um
        task = AcquireSettings.of(state).task(plan_file, str(folder), begun=begun, redo=listed, origin=origin)
        options = task.options(folder if begun else None)
        plan = self.target.to_record(state.plan, now)
        resume = begun and not redo
        if not resume:
            check_fixed(station.devices, options)
        known = now.known([Position(*p) for p in again])
        made = Recorder(task, plan, options, resume=resume, redo=again, known=known)
        if made.goal is not None:
            model_recorder.check_goal(state.plan, options, now)
        return made

    def _set_job(self, number: int) -> None:
        """Reserve the devices for job ``number``, or release them (0)."""
        self._job, self.setup.reserved = number, bool(number)
        if number:
            held = Hold(HELD, ("camera", "plan", "recording"), ("acquire",), self.context.refused.emit)
            self.context.project.hold(held)
        else:
            self.context.project.release()
        self.setup.show_controls()
        self.show_controls()

    def pause(self) -> None:
        """Pause the recording, or resume it."""
        if self.recorder is not None and self._job:
            control = self.recorder.control
            (control.resume if control.pausing else control.pause)()
            self._show_progress()
            self.show_controls()

    def stop(self) -> None:
        """End the recording when the current position is saved."""
        self._ask("stop")

    def _ask(self, what: str) -> None:
        if self.recorder is not None and self._job:
            getattr(self.recorder.control, what)()
            self.panel.buttons[what].setEnabled(False)
            self._show_progress()

    def _poll(self) -> None:
        """Show the newest frame and the quality data, without delaying the recording."""
        if self.recorder is None:
            return
        self.poll_timer.setInterval(POLL_MS if self.panel.strip.isVisible() else HIDDEN_MS)
        self._poll_frame()
        self._show_error()
        self.refresh()

    def _poll_frame(self) -> None:
        """Show the newest frame, unless an earlier one is still being drawn."""
        if self.recorder is None:
            return
        self._show_asked(self.recorder.cover.asked)
        if self.setup.drawing:
            return
        frame = self.recorder.preview.latest()
        if frame is not None:
            self._plane = self._plane if frame.position is None else frame.position.z
            if frame.position is not None and self._follows:
                self._set_plane(frame.position.z)
            self.setup.show_recorded(frame, self.recorder.recorded)

    def _show_asked(self, words: str) -> None:
        if words != self._asked:
            self._asked = words
            self._attend()
            self.asked.emit(words)
            self._show_progress()

    def _shown(self) -> Recorder | None:
        """Return the current run, or else a recorder that describes the folder; None without a plan."""
        plan = self.folder.plan or self.context.state.plan
        if self.recorder is not None or plan is None:
            return self.recorder
        if self._opened is None or self.folder.there is None:
            settings = AcquireSettings.of(self.context.state)
            options = self.folder.options or settings.options()
            shown = self.target.shown(plan, self.folder)
            task = replace(settings, extent="whole").task("", self.context.state.recording)
            self._opened = Recorder(task, shown, options, known=self.folder.known())
        return self._opened

    def refresh(self) -> None:
        """Show the current state of the session."""
        made, earlier = self._shown(), self.folder.there
        if made is None:
            return
        depths = made.plan.depths_um
        self._show_planes(made.plan)
        z, quantity = self.panel.z, self.panel.quantity.currentData()
        self._read_earlier(made, z)
        self.context.jobs.compute(
            "acquire quality",
            lambda: model_recorder.picture_of(made, z, quantity, earlier),
            lambda picture: self._show_picture(picture, z, depths),
        )

    def _read_earlier(self, made: Recorder, z: int) -> None:
        jobs = self.context.jobs
        if not jobs.loading(EARLIER):
            self.read_timer.stop()
        if not self.panel.strip.isVisible() or not made.earlier.want(z):
            return
        if self._reading is not None and self._reading is not made.earlier:
            self._reading.want(-1)  # it reads another folder
        self._reading = made.earlier
        jobs.drop(EARLIER)
        jobs.load(
            EARLIER,
            lambda: made.earlier.read(z, lambda: jobs.loading(EARLIER)),
            lambda _: self.refresh(),
            self.context.message.emit,
        )
        self.read_timer.start()

    def _show_picture(self, picture: RecordPicture, z: int, depths: tuple[float, ...]) -> None:
        if z >= len(depths):
            return
        self.panel.show_picture(picture, f"{plane_words(z, len(depths))}: z = {format_length(depths[z])}")
        self._show_merits(len(depths))
        if self.recorder is None and not self._refused:
            self.panel.show_status("", "", picture.done / max(1, picture.total))
        if self.recorder is not None and picture.alarms != self._alarms:
            self._alarms = picture.alarms
            self._attend()
        self._lamp = picture.lamp

    def _job_changed(self, job: WindowJob) -> None:
        if job.number == self._job and job.active:
            self._under_way = job
            if job.stopping and self.recorder is not None:
                self.recorder.control.stop()  # also while it waits for the user
            self._show_progress()
            self._report()

    def _show_progress(self) -> None:
        """Show the progress. A request to pause or stop is shown immediately."""
        job, recorder = self._under_way, self.recorder
        if job is None or recorder is None or not self.recording:
            return
        asked = model_recorder.asked_words(recorder.control, stopping=job.stopping) or self._asked
        if job.progress is None or asked == self._asked != "":
            self.panel.show_status(asked or "Starting …", "", None)
            return
        words, detail, fraction = model_recorder.progress_words(recorder, job.progress, self._lamp)
        said = (asked, words) if asked else (words, detail)
        self.panel.show_status(*said, fraction)

    def _show_error(self) -> None:
        """Show the error of H if it determines the end of the recording, else the depth-plane sum."""
        recorder, settings = self.recorder, AcquireSettings.of(self.context.state)
        goal = settings.goal() if recorder is None else recorder.goal
        self.panel.show_error(
            None if goal is None else model_recorder.error_curve(recorder.steps if recorder else (), goal)
        )

    def _fit_of_folder(self) -> Any:
        """Return the last fit of the session in the folder; None if this window made none."""
        recorder = self.recorder
        own = recorder is not None and recorder.folder == Path(self.context.state.recording)
        return recorder.fit if own and recorder is not None else None

    def _recorded(self, outcome: Any) -> None:
        recorder = self.recorder
        counted = "positions" if recorder is None else recorder.counted
        said = f"{outcome.how}: {outcome.acknowledged} of {outcome.total} {counted} are safe"
        self.context.message.emit("; ".join((said, *outcome.notes)))
        own = recorder is not None and recorder.folder == Path(self.context.state.recording)
        if outcome.how == "complete" and recorder is not None and own:
            if recorder.redo:
                self.context.project.update("positions recorded again", redo=())
            if recorder.redo and self.context.state.psf:
                self.after.remake(recorder.redo)
            elif isinstance(recorder.recorded, ScanPlan) and recorder.goal is None:
                self.after.assemble_own()

    def _failed(self, job: WindowJob) -> None:
        self._stopped = job.error.removeprefix("stopped ")  # the line of the next step begins with this word
        self._attend()

    def _attend(self) -> None:
        """Mark the page while the recording needs the attention of the user."""
        self.context.attention.emit("acquire", bool(self._alarms or self._asked or self._stopped))

    def _job_finished(self, job: WindowJob) -> None:
        if job.number != self._job:
            return
        self._set_job(0)
        self._under_way = None
        self._show_asked("")
        self.poll_timer.stop()
        self.frame_timer.stop()
        if self.recorder is not None and self.recorder.folder != Path(self.context.state.recording):
            self._forget()  # another project was begun meanwhile
            self.ended.emit()
            return
        self._poll()
        self.folder_choice.look()
        ended = ("",) if self.recorder is None else (self.recorder.ended, self.recorder.counted)
        words, fraction = model_recorder.end_words(job, *ended)
        curve = self.panel.error_curve()
        known = curve.words if self.recorder is not None and self.recorder.steps and curve is not None else ""
        # shown with the status, which remains when the folder has been read and the advice is updated
        self.panel.show_status(words, job.error or known, fraction)
        self.ended.emit()
