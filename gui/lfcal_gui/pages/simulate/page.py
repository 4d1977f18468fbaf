"""Record > Compute: compute H with the effects that it needs, and show what accuracy costs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtWidgets import QFileDialog, QWidget

from lfcal.accuracy import Curve
from lfcal.base import LfcalError
from lfcal.camera import ScanPlan
from lfcal.tasks import RunSettings, SimulatedH
from lfcal_gui.base_page import BasePage
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState, WindowJob
from lfcal_gui.models import (
    PageSpec,
    ProjectState,
    Shot,
    asked_seconds,
    iter_measure,
    list_beside,
    rough_seconds,
    subject_of,
)
from lfcal_gui.pages.simulate import model
from lfcal_gui.pages.simulate._measure_dialog import MeasureDialog
from lfcal_gui.pages.simulate.model import SimulateSettings
from lfcal_gui.pages.simulate.model_effects import EffectsVerdict, verdict_of
from lfcal_gui.pages.simulate.model_frames import (
    FrameBench,
    InfluencePictures,
    Influences,
    KeptFrames,
    SimulatedFrame,
    frame_question,
    influence_question,
)
from lfcal_gui.pages.simulate.model_measure import BEADS_FILE, BeadPlan, iter_beads
from lfcal_gui.pages.simulate.panel import SimulatePanel
from lfcal_gui.saving import ask_target, write_file
from lfcal_gui.widgets import CostCurve

PART, SECONDS = "simulation", 20.0
"""Measured part, and approximate duration of the measurement (s)."""

KIND = "Plan (*.json)"

LONG = 30.0
"""Duration above which the user is asked before a measurement (s)."""

RESUMED = RunSettings(resume=True)
"""Settings for units in the window: in its own process, resuming an earlier run."""


class Page(BasePage):
    """Page that asks the planner after every change; answers to earlier requests are discarded."""

    def __init__(self, spec: PageSpec, context: Context, panel: SimulatePanel) -> None:
        super().__init__(spec, context)
        self.panel = panel
        self.verdict: EffectsVerdict | None = None
        self.bench = FrameBench()
        self.influences = Influences(self.bench)
        self._stop = threading.Event()
        self._computing = False
        self._measuring = 0
        self._curve: Curve | None = None
        self._warned: ScanPlan | None = None
        self._seconds: float | None = None
        self.dialog: MeasureDialog | None = None
        """Dialog with the measurements of undescribed effects, while it is open."""
        self._asked: tuple[Any, ...] = (None, None)
        """Plan and settings of the frame that is displayed or being made."""
        self.tool_button("Compute H …", "Compute H of all positions of the plan, as a job", self.simulate)
        self._connect()
        self.set_panel(self.panel)
        self.theme_changed.connect(self._apply_theme)
        context.jobs.changed.connect(lambda job: self._show_curve() if job.number == self._measuring else None)
        context.jobs.finished.connect(self._measured)
        self.shortcut("F5", self.measure)
        self.shortcut("Escape", self.stop)
        self._show(context.state)

    @staticmethod
    def parts(context: Context) -> Iterator[QWidget]:
        """Make the curve, and then the panel."""
        curve = CostCurve()
        yield curve
        yield SimulatePanel(context.jobs, curve)

    def _connect(self) -> None:
        panel, effect = self.panel, self.panel.effect
        panel.edited.connect(self._set)
        panel.table.choice_asked.connect(self._set_choice)
        panel.table.chosen.connect(self._choose)
        panel.curve.moved.connect(lambda error: self._set("tolerance", error))
        panel.curve.chosen.connect(self.use)
        panel.curve.measure_asked.connect(self.measure)
        panel.place.changed.connect(self._moved)
        deeds: dict[str, Callable[[], object]] = {
            "measure": self.measure_effects,
            "frame": self.make_frame,
            "frames": self.simulate_frames,
            "import": self.import_magnitudes,
            "export": self.export_magnitudes,
            "reset": self._reset,
            "stop": self._stop_waiting,
        }
        panel.asked.connect(lambda what: deeds[what]())
        panel.tabs.currentChanged.connect(lambda _: self._look())
        effect.form.given.connect(self._give)

    # -- project ---------------------------------------------------------------------------------------
    @property
    def settings(self) -> SimulateSettings:
        """The user's settings."""
        return SimulateSettings.of(self.context.state)

    def state_changed(self, old: ProjectState, new: ProjectState) -> None:
        """Ask the planner again if plan, settings or sources of camera values changed."""
        marks = old.camera.marks != new.camera.marks
        if old.plan != new.plan:
            number, self._measuring = self._measuring, 0
            self.context.jobs.cancel(number)
        if (new.plan, SimulateSettings.of(new)) != self._asked:
            self._forget_frame()
        if old.plan != new.plan or marks or SimulateSettings.of(old) != SimulateSettings.of(new):
            self._close_dialog()
            self._show(new)

    def deeds(self) -> dict[str, Callable[[], object]]:
        """Return the actions that the next step may request, by name."""
        return {"compute": lambda: self.simulate(self.context.own_path("simulated.h5"))}

    def _forget_frame(self) -> None:
        """Remove a frame that was made for another plan or with other settings."""
        if self._asked != (None, None):
            self._asked = (None, None)
            self.panel.frame.show_none()

    def _show(self, state: ProjectState) -> None:
        if state.plan is None:
            self.show_empty(
                "No scan planned yet\nA scan plan states positions, planes and cutout of H.",
                {"Go to Set up": self.lead("setup", "Choose the source positions and depth planes of the scan")},
            )
            return
        self.show_body()
        settings, plan = self.settings, state.plan
        self.panel.show_settings(settings)
        self._seconds = None
        self._show_curve()
        self.context.jobs.compute(
            "simulate plan", lambda: verdict_of(plan, settings), self._planned, self.context.message.emit
        )

    def _set(self, name: str, value: Any) -> None:
        settings = replace(self.settings, **{name: value})
        self.context.project.merge(f"{name} of simulation", settings=settings.into(self.context.state))

    def _set_choice(self, effect: str, choice: str) -> None:
        self._change(f"choice for {effect}", lambda: self.settings.with_override(effect, choice))

    def _give(self, effect: str, field: str, value: Any, mark: str) -> None:
        self._change(f"{field} of {effect}", lambda: self.settings.with_magnitude(effect, field, value, mark))

    def _reset(self) -> None:
        self._change("reset of effects", lambda: replace(self.settings, overrides=(), magnitudes=()))

    def _change(self, label: str, make: Callable[[], SimulateSettings]) -> None:
        """Create and store new settings; if they are invalid, show the reason on the page."""
        try:
            settings = make()
        except LfcalError as error:
            self.refuse(str(error))
            return
        self.notice.clear()
        self.context.project.update(label, settings=settings.into(self.context.state))

    # -- planner and preview ---------------------------------------------------------------------------
    def _planned(self, verdict: EffectsVerdict) -> None:
        self.verdict = verdict
        self.panel.show_verdict(verdict)
        self._forecast(verdict)
        self._look()

    def _forecast(self, verdict: EffectsVerdict) -> None:
        """Show the forecast duration of H; for a requested level, it is predicted from a short run."""
        if verdict.settings.level == "auto":
            self._forecasted(verdict, verdict.found.seconds)
            return
        task = model.matrix_task(verdict.settings, "")
        self.context.jobs.compute(
            "simulate seconds",
            lambda: task.timed(verdict.plan, verdict.found).seconds,
            lambda seconds: self._forecasted(verdict, seconds),
            self.context.message.emit,
        )

    def _forecasted(self, verdict: EffectsVerdict, seconds: float) -> None:
        if verdict is self._answer():
            self._seconds = seconds
            self._show_curve()

    def _look(self) -> None:
        self._preview(fine=True)
        self._influence()

    def _answer(self) -> EffectsVerdict | None:
        """Return the planner's decisions for plan and settings; None until they are known."""
        fits = self.verdict is not None and self.verdict.fits(self.context.state.plan, self.settings)
        return self.verdict if fits else None

    def _moved(self) -> None:
        self._preview(fine=False)
        self._influence()

    def _preview(self, *, fine: bool) -> None:
        """Show rays immediately, then the chosen level with the planner's effects, unless there is a newer request."""
        plan, verdict, settings, place = self.context.state.plan, self._answer(), self.settings, self.panel.place.place
        if plan is None or (fine and verdict is None):  # the planner's answer brings the fine one
            return
        if not self.panel.pattern_shown:  # computed when the tab is shown
            return
        level = settings.level if fine else "geometric"
        # pass the selection, not its effects: the effects left out use their share of the tolerance
        effects = verdict.found if fine and verdict is not None else ()
        self.context.jobs.compute(
            "simulate preview",
            lambda: model.pattern_of(plan, place, effects, level, settings.tolerance),
            lambda shot: self._previewed(shot, plan, settings, fine),
            self.context.message.emit,
        )

    def _previewed(self, shot: Shot, plan: ScanPlan, settings: SimulateSettings, fine: bool) -> None:
        if (plan, settings) != (self.context.state.plan, self.settings):
            return  # outdated; the planner's next answer starts a new preview
        self.panel.view.set_shot(shot)
        if not fine:
            self._preview(fine=True)

    # -- one effect, one frame ---------------------------------------------------------------------------
    def _choose(self, name: str) -> None:
        if self.verdict is None:
            return
        panel = self.panel
        panel.effect.show_row(self.verdict.row(name))
        if panel.tabs.currentWidget() is panel.effect:
            self._influence()
        else:
            panel.tabs.setCurrentWidget(panel.effect)  # starts the computation

    def _stop_influence(self) -> None:
        self._stop.set()
        self._stop = threading.Event()

    def _stop_waiting(self) -> None:
        self._stop.set()
        self.panel.effect.show_influence(None, "Stopped. To continue, choose the effect, plane or position again.")

    def _influence(self) -> None:
        """Show the influence of the selected effect at the position, if it is visible."""
        self._stop_influence()
        verdict, panel = self._answer(), self.panel
        row = None if verdict is None else verdict.row(panel.table.selected)
        if verdict is None or row is None or panel.tabs.currentWidget() is not panel.effect:
            return
        asked = influence_question(verdict, row, panel.place.place)
        known = self.influences.known(asked)
        if known is not None:
            panel.effect.show_influence(known)
            return
        panel.effect.show_waiting("Computing without and with this effect …")
        if self._computing:  # started when the present one ends, so that no job waits
            return
        self._computing, stop = True, self._stop
        self.context.jobs.compute(
            "simulate influence",
            lambda: self.influences.answer(asked, stop.is_set),
            lambda found: self._influenced(stop, found),
            lambda why: self._influenced(stop, None, why),
        )

    def _influenced(self, stop: threading.Event, found: InfluencePictures | None, why: str = "") -> None:
        self._computing = False
        if stop is not self._stop:
            self._influence()
        elif found is not None or why:
            self.panel.effect.show_influence(found, why)

    def make_frame(self) -> None:
        """Make the sensor frame of the chosen position."""
        verdict, panel = self._answer(), self.panel
        if verdict is None:
            return
        asked = frame_question(verdict, panel.place.place)
        panel.show_frame_tab()
        panel.frame.show_waiting()
        self._asked = question = (self.context.state.plan, self.settings)
        self.context.jobs.compute(
            "simulate frame",
            lambda: self.bench.frame(asked),
            lambda frame: self._framed(question, frame),
            lambda why: self._framed(question, None, why),
        )

    def _framed(self, question: tuple[Any, ...], frame: SimulatedFrame | None, why: str = "") -> None:
        if question == self._asked:
            self.panel.frame.show_frame(frame, why)

    # -- undescribed effects -----------------------------------------------------------------------------
    def measure_effects(self) -> None:
        """Show the measurements that determine undescribed effects, and choose the positions of bead frames."""
        verdict = self._answer()
        if verdict is None or self.dialog is not None:
            return
        self.dialog = dialog = MeasureDialog(self, verdict.missing, self._act)
        beads = next((one for one in verdict.missing.measurements if one.depths_um), None)
        number = 0
        if beads is not None:
            number = self.context.jobs.start(
                "Choose positions of bead frames",
                "simulate",
                lambda: iter_beads(verdict.plan, beads),
                lambda found: self._show_beads(dialog, found, found.words()),
                lambda job: self._show_beads(dialog, None, job.error or "No positions were chosen."),
                leave=True,
                at_once=True,
            )
        dialog.finished.connect(lambda _: self._dialog_closed(number))
        dialog.open()

    def _show_beads(self, dialog: MeasureDialog, beads: BeadPlan | None, words: str) -> None:
        if dialog is self.dialog:
            dialog.show_beads(beads, words)

    def _dialog_closed(self, number: int) -> None:
        self.dialog = None
        self.context.jobs.cancel(number)

    def _close_dialog(self) -> None:
        if self.dialog is not None:
            self.dialog.close()

    def _act(self, what: str) -> None:
        """Do what the user chose in the dialog, which stays open after the plan is saved."""
        if what == "save":
            self.save_beads()
            return
        beads = None if self.dialog is None else self.dialog.beads
        self._close_dialog()
        if what == "white":
            self.context.go.emit("setup", what)
        elif what == "values" and self.verdict is not None:
            stated = next(one for one in self.verdict.missing.measurements if not one.frames)
            self.panel.table.select(stated.rows[0].name)
            self.panel.show_effect()
        elif beads is not None:
            self.use_beads(beads)

    def save_beads(self, path: str = "") -> None:
        """Save the plan of the bead frames, and the list of their positions next to it."""
        beads = None if self.dialog is None else self.dialog.beads
        if self.dialog is None or beads is None:
            return
        path = path or ask_target(self.dialog, "Save plan", BEADS_FILE, KIND, lambda to: list(beads.files(to)))
        if path and self._write_beads(beads, path):
            listed = list_beside(path).name
            self.context.message.emit(f"plan saved as {path}, and {listed} for Positions in Record > Rig")

    def _write_beads(self, beads: BeadPlan, path: str) -> bool:
        def writing(text: str) -> Callable[[Path], object]:
            return lambda part: part.write_text(text, encoding="utf-8")

        if not all(write_file(self, str(file), writing(text)) for file, text in beads.files(path).items()):
            return False
        self.context.history.add(
            self.context.taken("simulate", f"Save plan {Path(path).name}", path, lambda: beads.step(path))
        )
        return True

    def use_beads(self, beads: BeadPlan) -> None:
        """Use the plan of the bead frames in the project, with its positions and the unknowns of the fit."""
        path = self.context.own_path(BEADS_FILE) or ask_target(
            self, "Save plan", BEADS_FILE, KIND, lambda to: list(beads.files(to))
        )
        if not path or not self._write_beads(beads, path):
            return
        if self.context.project.update("plan of bead frames", **beads.changes(self.context.state, list_beside(path))):
            self.context.message.emit(f"plan in use: {path}; record its positions, assemble H and fit the optics")
            self.context.go.emit("acquire", None)

    # -- files -------------------------------------------------------------------------------------------
    def import_magnitudes(self, path: str = "") -> None:
        """Import magnitudes and settings from a JSON file."""
        path = path or QFileDialog.getOpenFileName(self, "Import magnitudes", "", "effects (*.json)")[0]
        if path:
            settings = self.settings
            self.load(Path(path).name, lambda: model.read_settings(Path(path), settings), self._imported)

    def _imported(self, found: tuple[SimulateSettings, str]) -> None:
        settings, words = found
        now = replace(self.settings, overrides=settings.overrides, magnitudes=settings.magnitudes)
        self.context.project.update("import of magnitudes", settings=now.into(self.context.state))
        self.context.message.emit(words)

    def export_magnitudes(self, path: str = "") -> None:
        """Export magnitudes and settings to a JSON file for the command line."""
        text = model.settings_text(self.settings)
        path = path or ask_target(self, "Export magnitudes", "effects.json", "effects (*.json)")
        if path and write_file(self, path, lambda part: part.write_text(text, encoding="utf-8")):
            self.context.message.emit(f"written: {path}; lfcal simulate … --effect {Path(path).name} reads it")

    # -- work --------------------------------------------------------------------------------------------
    def _plan(self) -> ScanPlan | None:
        if self.context.state.plan is None:
            self.refuse("there is no scan plan to simulate; make or open one in Set up")
        return self.context.state.plan

    def simulate(self, path: str = "") -> None:
        """Simulate the whole H as a job with the current plan and settings."""
        plan, settings = self._plan(), self.settings
        if plan is None:
            return
        path = path or ask_target(self, "Compute H", "simulated.h5", "H file (*.h5)")
        if not path:
            return
        title, task = f"Simulate {Path(path).name}", model.matrix_task(settings, path)

        def ended(job: WindowJob) -> None:
            if job.state is not JobState.DONE and (whole := model.kept_pass(path)):  # the last whole pass stays
                self._take(path, f"kept {path}, {whole}")

        self.context.start_writing(
            title,
            "simulate",
            path,
            lambda: task.work_on(plan, RESUMED),
            self._simulated,
            kind="compute",
            on_end=ended,
            taken=self.context.taken("simulate", title, path),
        )

    def _simulated(self, made: SimulatedH) -> None:
        made.close()
        self._take(str(made.out), f"simulated {made.out}; {'; '.join(made.reached)}")

    def _take(self, path: str, words: str) -> None:
        self.context.message.emit(words)
        changes = {"reference": path} if self.context.state.psf else {"psf": path, "reference": path}
        self.context.project.update("simulation", **changes)

    def simulate_frames(self, folder: str = "") -> None:
        """Write the frames of a simulated session as a job with the current plan and settings."""
        from lfcal.simulate.sensor import check_session_folder

        plan, settings = self._plan(), self.settings
        if plan is None:
            return
        folder = folder or QFileDialog.getExistingDirectory(self, "Folder for the frames (new or empty)")
        if not folder:
            return
        task = model.frames_task(settings, folder)
        try:
            check_session_folder(folder, resume=True)
        except LfcalError as error:
            self.refuse(str(error))
            return
        self.context.jobs.start(
            f"Simulate frames in {Path(folder).name}",
            "simulate",
            lambda: task.work_on(plan, RESUMED),
            lambda made: self.context.message.emit(f"written: {made.to_dict()['what']} in {folder}"),
            keeping=KeptFrames(folder),
        )

    # -- what accuracy costs -----------------------------------------------------------------------------
    def measure(self) -> None:
        """Measure error and time of every tolerance as a job; ask the user before a long measurement."""
        plan, state, curves = self._plan(), self.context.state, self.context.curves
        if plan is None or self._measuring:
            return
        expected = asked_seconds(plan)
        if expected > LONG and plan != self._warned:
            self._warned = plan
            self.panel.curve.show_status(f"This takes {rough_seconds(expected)}.", "Measure anyway")
            return
        curves.forget(subject_of(state, "plan"), (PART,))
        self._measuring = self.context.jobs.start(
            "What accuracy costs",
            "simulate",
            lambda: iter_measure(state, "plan", max(SECONDS, expected), (PART,), curves),
            leave=True,
        )
        self._show_curve()

    def _measured(self, job: WindowJob) -> None:
        if job.number == self._measuring:
            self._measuring = 0
        if self.context.state.plan is not None:
            self._show_curve()

    def _show_curve(self) -> None:
        """Show the measured curve, the point in use, and the forecast duration of H."""
        key, curves = subject_of(self.context.state, "plan"), self.context.curves
        # points are numbered in the curve that is on screen, not in the one that has grown meanwhile
        self._curve = curves.of(key).get(PART)
        paced = partial(self.context.paces.seconds, "compute")
        self.panel.show_cost(self._curve, self.settings, self._seconds, paced)
        point = model.used_point(self._curve, self.settings)
        # the line of the next step corrects the time in the same way
        facts = {"compute_s": self._seconds} if point is None else {"compute_s": point.cost, "error": point.error}
        self.context.report(self.spec.key, **facts)
        took = curves.took(key, PART)
        button = "" if self._measuring else "Measure again" if took else "Measure"
        self.panel.curve.show_status(took, button)

    def use(self, number: int) -> None:
        """Use the tolerance of a measured point."""
        if self._curve is not None:
            tolerance = float(self._curve.points[number].settings["tolerance"])
            self._change("measured tolerance", lambda: replace(self.settings, tolerance=tolerance, level="auto"))

    def _apply_theme(self) -> None:
        self.panel.apply_theme()
        if self.verdict is not None:
            self.panel.show_verdict(self.verdict)
