"""Record > Rig: devices, live view, and moves of the stage."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QObject, QTimer, Signal

from lfcal.acquire import LiveFrame, optics_of
from lfcal.base import LfcalError
from lfcal.camera import ScanPlan
from lfcal.devices.simulated import DeviceFault
from lfcal.psf import PSFMatrix
from lfcal_gui.context import Context
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.acquire._devices import fault_words
from lfcal_gui.pages.acquire._measuring import SetupMeasuring
from lfcal_gui.pages.acquire._stage import StageMoves
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_live import LivePicture, Pace, live_picture, recorded_picture, stage_arrows
from lfcal_gui.pages.acquire.model_station import Station, open_station
from lfcal_gui.pages.acquire.setup_panel import SetupPanel
from lfcal_gui.workers import start_thread, wait_for

if TYPE_CHECKING:
    from lfcal.targets import TargetPlan

LIVE_MS, HIDDEN_MS, AGAIN_MS = 30, 1000, 1000
"""Intervals between live frames: normally, while another page is shown, and after a failed frame (ms)."""
RELEASE_S = 5.0
"""How long closing the window waits for devices to be released (s)."""
QUICK = "the simulator's quick pattern has no lenslets: set optics=auto under Options"


class SetupTab(QObject):
    """Owner of the connected devices, which shows their live view."""

    changed = Signal()
    """Devices were connected, disconnected, reserved or released."""

    def __init__(self, context: Context, panel: SetupPanel, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.context, self.panel = context, panel
        self.station: Station | None = None
        self.reserved = False
        """Whether a session is being recorded."""
        self.connecting = False
        self._looked_for = False
        self._then: Callable[[], object] | None = None
        self.pace = Pace()
        self.drawing = False
        """Whether a frame of a recording is being drawn; frames that arrive meanwhile are dropped."""
        self._trouble = ""
        self.live_timer = QTimer(self, singleShot=True)
        self.live_timer.timeout.connect(self._look)
        panel.devices.edited.connect(self._devices_edited)
        panel.faults.edited.connect(self._faults_edited)
        panel.faults.injected.connect(self._inject)
        panel.devices.connect_asked.connect(self.connect_devices)
        panel.connect_asked.connect(self._connect_asked)
        panel.devices.disconnect_asked.connect(self.disconnect_devices)
        self.moves = StageMoves(context, panel.stage, lambda: self.station, self)
        panel.plane_asked.connect(self.moves.go_plane)
        self.moves.refused.connect(self._refused)
        self.moves.plane_reached.connect(self._plane_reached)
        self.moves.placed.connect(self._placed)
        self.measuring = SetupMeasuring(context, panel, lambda: self.station if self.free else None, self)
        self.measuring.changed.connect(self._changed)
        context.on_close(self._close_station)

    def entered(self) -> None:
        """Search for devices at the first visit."""
        if not self._looked_for:
            self._looked_for = True
            self.context.jobs.compute("acquire backends", _backends, self._backends_found, self.context.message.emit)

    def show_state(self, state: ProjectState) -> None:
        """Show the plan and the choice of devices."""
        if state.plan is None:
            return
        chosen = AcquireSettings.of(state)
        self.panel.arrows.set_arrows(stage_arrows(state.plan.stage))
        self.panel.devices.set_choice(chosen.backend, dict(chosen.device_options), chosen.stage)
        self.panel.faults.setVisible(chosen.backend == "sim")
        self.panel.faults.set_faults(dict(chosen.device_options).get("faults", ""))
        if self.panel.exposure.value() == self.panel.exposure.minimum():
            self.panel.set_exposure(state.plan.exposures[0])
        self.measuring.follow(state.plan)
        self._check_station()

    def let_go(self) -> None:
        """Discard frames and results of the previous project, and actions that wait for a connection."""
        self._then = None
        self.measuring.forget(*self.panel.results)
        self.panel.show_nothing()

    def _check_station(self) -> None:
        """Release devices that no longer match the project, unless they are in use."""
        plan, chosen = self.context.state.plan, AcquireSettings.of(self.context.state)
        if plan is None or self.station is None or not self.free:
            return
        choice = chosen.backend, chosen.devices(), chosen.stage
        if why := self.station.outdated(plan, *choice):
            self.disconnect_devices()
            self.panel.show_nothing()
            self.panel.devices.set_connected(why, connected=False)
            if self.panel.isVisible():  # other pages show their own messages
                self.context.message.emit(why)

    @property
    def free(self) -> bool:
        """Whether only the live view uses the devices."""
        return not (self.measuring.busy or self.reserved)

    def show_controls(self) -> None:
        """Enable the controls that apply."""
        self._check_station()
        connected = self.station is not None
        self.panel.set_connected(connected, free=self.free)
        for button in self.panel.connect_buttons:
            button.setEnabled(not self.connecting)
        self.moves.follow(connected, free=self.free)
        self.panel.faults.set_connected(connected, busy=self.connecting)
        if connected:
            self.panel.devices.set_free(self.free)
        if self.free and connected:
            self._look()

    # -- devices ---------------------------------------------------------------------------------------
    def _devices_edited(self, backend: str, options: tuple[tuple[str, str], ...], stage: str) -> None:
        state = self.context.state
        settings = replace(AcquireSettings.of(state), backend=backend, device_options=options, stage=stage)
        self.context.project.update("choice of devices", settings=settings.into(state))

    def _faults_edited(self, text: str) -> None:
        state = self.context.state
        chosen = AcquireSettings.of(state)
        others = tuple(pair for pair in chosen.device_options if pair[0] != "faults")
        options = (*others, ("faults", text)) if text else others
        self.context.project.update("faults", settings=replace(chosen, device_options=options).into(state))

    def _inject(self, fault: DeviceFault) -> None:
        """Make the connected simulator fail, also during a recording."""
        if self.station is not None:
            self.station.inject(fault)
            self.context.message.emit(f"fault of the simulator: {fault_words(fault, now=True)}")

    def _backends_found(self, found: tuple[Any, Any, Any]) -> None:
        self.panel.devices.set_backends(*found)
        self.show_state(self.context.state)

    def _connect_asked(self, simulated: bool) -> None:
        if simulated and AcquireSettings.of(self.context.state).backend != "sim":
            self._devices_edited("sim", (), "")
        self.connect_devices()

    def connect_devices(self, then: Callable[[], object] | None = None) -> None:
        """Open the chosen devices in the background, start the live view, and call ``then``."""
        plan, chosen = self.context.state.plan, AcquireSettings.of(self.context.state)
        if plan is None or self.station is not None or self.connecting:
            return
        self.connecting, self._then = True, then or self._then
        self.show_controls()
        self.panel.devices.set_connected("connecting …", connected=False, busy=True)
        self.context.jobs.compute(
            "acquire connect",
            lambda: open_station(plan, chosen.backend, chosen.devices(), chosen.stage),
            self._connected,
            self._not_connected,
        )

    def when_connected(self, then: Callable[[], object] | None) -> None:
        """Call ``then`` as soon as devices are connected. None: cancel this."""
        self._then = then

    def _connected(self, station: Station) -> None:
        self.station, self.connecting = station, False
        self.panel.devices.set_connected(station.title, connected=True)
        self.panel.stage.set_limits(station.limits)
        then, self._then = self._then, None
        self._changed()
        if self.station is None:  # opened for the previous project
            return
        if then is not None:
            then()

    def _not_connected(self, words: str) -> None:
        self.connecting, self._then = False, None
        self.panel.devices.set_connected(words, connected=False)
        self.context.refused.emit(words)
        self._changed()

    def disconnect_devices(self) -> None:
        """Release the devices."""
        station, self.station = self.station, None
        if station is not None:
            # in a separate thread, so that the devices are released even if the window closes next
            group = f"acquire release {id(station)}"
            self.context.jobs.load(group, station.close, lambda _: None, self.context.message.emit)
        self.panel.show_nothing()
        self.panel.devices.set_connected("", connected=False)
        self.panel.stage.set_limits(None)
        self._changed()

    def _close_station(self) -> None:
        """Release the devices when the window closes, without waiting for a device that does not respond."""
        if self.station is not None:
            wait_for([start_thread(self.station.close, "lfcal-release")], RELEASE_S)
            self.station = None

    # -- live view -------------------------------------------------------------------------------------
    def _look(self) -> None:
        """Grab frames while nothing is recorded, fewer while another page is shown."""
        station, plan = self.station, self.context.state.plan
        if station is None or plan is None or not self.free:
            return
        if self.moves.moving:  # a look would wait for the move
            self.live_timer.start(LIVE_MS)
            return
        exposure, reference, pace = self.panel.exposure.value() / 1e3, self._reference(), self.pace
        self.context.jobs.compute(
            "acquire live",
            lambda: live_picture(station.look(exposure, plan), plan, reference, exposure, pace),
            self._looked,
            self._live_failed,
        )

    def show_recorded(self, frame: LiveFrame, recorded: ScanPlan | TargetPlan) -> None:
        """Show a frame of a recording."""
        reference, pace = self._reference(), self.pace
        self.drawing = True

        def made(picture: LivePicture) -> None:
            self.drawing = False
            if self.station is not None and not math.isnan(picture.stage_um[0]):
                self.station.note(picture.stage_um)
            self._show(picture, recorded.scan)

        def failed(words: str) -> None:
            self.drawing = False
            self.context.jobs.trouble.emit(words)

        self.context.jobs.compute(
            "acquire frame", lambda: recorded_picture(frame, recorded, reference, pace), made, failed
        )

    def _reference(self) -> PSFMatrix | None:
        """Return the H with which frames are compared; None until it is open."""
        state = self.context.state
        for path in (state.reference, state.psf):
            self.context.matrices.want(path)
        return self.context.matrix(state.reference) or self.context.matrix(state.psf)

    def _looked(self, picture: LivePicture) -> None:
        plan = self.context.state.plan
        if plan is None or self.station is None or not self.free:
            return
        self._trouble = ""
        self._show(picture, plan)
        self.live_timer.start(LIVE_MS if self.panel.isVisible() else HIDDEN_MS)

    def _show(self, picture: LivePicture, plan: ScanPlan) -> None:
        quick = self.station is not None and optics_of(self.station.rig) == "pattern"
        self.panel.show_live(picture, plan, QUICK if quick else "")
        seen = picture.stage_um if self.station is None else self.station.seen or picture.stage_um
        if self.station is not None or not self.free:  # else the devices were released meanwhile
            self.panel.stage.set_position(seen)
        self._placed(seen)
        if picture.frame is not None:
            self.context.frame_seen.emit(picture.frame, picture.first)

    def _placed(self, stage_um: tuple[float, float, float]) -> None:
        """Show the age of the frame, and whether the stage has moved since."""
        self.panel.show_age(time.monotonic(), stage_um)

    def _refused(self, words: str) -> None:
        self.panel.readout.setText(words)
        self.context.message.emit(words)

    def _plane_reached(self, z: int) -> None:
        if self.context.state.plan is not None:
            self.panel.set_exposure(self.context.state.plan.exposures[z])

    def _live_failed(self, words: str) -> None:
        if self.station is None:  # the devices were released while a frame was under way
            return
        if words != self._trouble:
            self._trouble = words
            self._refused(words)
        self.live_timer.start(AGAIN_MS)

    def _changed(self) -> None:
        self.show_controls()
        self.changed.emit()


def _backends() -> tuple[Any, dict[str, Any], dict[str, bool]]:
    """Return the found backends, the options of each, and whether each provides a stage."""
    from lfcal.devices import find_backends, get_backend

    findings = find_backends()
    options, stages = {}, {}
    for finding in findings:
        try:
            backend = get_backend(finding.name)
        except LfcalError:
            continue
        options[finding.name], stages[finding.name] = backend.options, backend.has_stage
    return findings, options, stages
