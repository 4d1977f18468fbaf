"""Choice of devices and their options, and faults of the simulated devices."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QStandardItemModel
from PySide6.QtWidgets import QComboBox, QLabel, QListWidget, QSpinBox, QWidget

from lfcal.base import LfcalError
from lfcal.devices.simulated import CAMERA_FAULTS, FAULTS, GAUGE_FAULTS, STAGE_FAULTS, DeviceFault, parse_faults
from lfcal_gui.models import Field
from lfcal_gui.widgets import Folded, FoldedForm, button, choice_box, column_of, line, set_role, wrapped

_SAID = {
    "move fails": "a move fails",
    "stops short": "the stage stops short",
    "drifts": "the stage creeps after arrival",
    "never arrives": "the stage never arrives",
    "stage vanishes": "the stage is unplugged",
    "encoder off": "the stage reports a wrong position",
    "loses steps": "the stage loses steps",
    "times out": "no frame comes in time",
    "incomplete": "a frame lacks parts",
    "stale": "an old frame is delivered again",
    "wrong shape": "a frame has another shape",
    "vanishes": "the camera is unplugged",
    "clock jumps": "the camera's clock jumps",
    "bumped": "the table is bumped",
    "blank": "a blank frame",
    "repeats": "earlier content is repeated",
    "frozen": "the image is frozen",
    "torn": "a frame is torn",
    "region slips": "the readout region shifts",
    "dark level": "the dark level rises",
    "clamps exposure": "the exposure is clamped",
    "lamp dims": "the lamp dims",
    "too warm": "the room is too warm (gauge)",
    "lamp low": "the lamp is low (gauge)",
}
COUNTED = {
    **dict.fromkeys(STAGE_FAULTS, "move"),
    **dict.fromkeys(CAMERA_FAULTS, "frame"),
    **dict.fromkeys(GAUGE_FAULTS, "reading"),
}
"""Name of the calls that are counted for each kind of fault."""

KINDS = tuple((kind, _SAID.get(kind, kind)) for kind in FAULTS)
"""Pairs of kind and words, for a list."""


def fault_words(fault: DeviceFault, *, now: bool = False) -> str:
    """Return a one-line description of a fault; with ``now``, its calls are counted from now on."""
    counted = COUNTED[fault.kind]
    last = f" to {fault.at + fault.times - 1}" if fault.times > 1 else ""
    after = " from now" if now else ""
    return f"{counted} {fault.at}{last}{after}: {_SAID.get(fault.kind, fault.kind)}"


CONNECT = "Connect camera and stage, to see live frames and to record; nothing moves yet"
SHORT = re.compile(r"[.;,(\[@]| of the | after | the image| separated ")
"""End of the label of an option within its description; the tooltip contains the whole description."""
OPTIONS = "Settings of this driver; empty: default"
LET_GO = "Release camera and stage, for another program or other settings; the stage does not move"


class DevicePanel(QWidget):
    """Choice of the backend, and button to connect."""

    connect_asked, disconnect_asked = Signal(), Signal()
    """A button was pressed; the choice was already stored in the project."""
    edited = Signal(str, object, str, arguments=["backend", "options", "stage"])
    """The choice changed: name, pairs of name and text, name of the stage's backend or empty."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._options: dict[str, Mapping[str, str]] = {}
        self._has_stage: dict[str, bool] = {}
        self._reasons: dict[str, str] = {}
        self._given: dict[str, str] = {}
        self._connected = False
        self._make_choices()
        self.options = FoldedForm()
        self.reason = wrapped("hint", "searching for devices …")
        self.button = button("Connect", CONNECT, self._pressed)
        self.button.setEnabled(False)
        # the names of backends are long
        parts = (self.backend, line(self.stage_label, self.stage, stretch=1), self.reason, self.options, self.button)
        self._column = column_of(*parts, of=self)

    # -- building --------------------------------------------------------------------------------------
    def _make_choices(self) -> None:
        self.backend, self.stage = QComboBox(), QComboBox()
        for box in (self.backend, self.stage):
            box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.backend.setAccessibleName("Camera")
        self.backend.setToolTip("Driver of the camera. To see why a driver is absent, point at its name in the list")
        self.backend.setMinimumContentsLength(10)
        self.backend.activated.connect(self._backend_chosen)
        self.stage.setToolTip("Driver of the stage, if the camera driver does not include a stage")
        self.stage.activated.connect(lambda _: self._emit())
        self.stage_label = QLabel("Stage")

    # -- showing ---------------------------------------------------------------------------------------
    def set_backends(
        self, findings: Sequence[Any], options: Mapping[str, Mapping[str, str]], has_stage: Mapping[str, bool]
    ) -> None:
        """Set the found backends, as `lfcal.devices.registry.BackendStatus` records, and options and stage of each."""
        self._options, self._has_stage = dict(options), dict(has_stage)
        self._reasons = {f.name: f.reason for f in findings}
        self.backend.clear()
        self.stage.clear()
        self.stage.addItem("from the camera driver", "")
        for finding in findings:
            self.backend.addItem(finding.title or finding.name, finding.name)
            index = self.backend.count() - 1
            tip = finding.reason or f"{finding.name}: {finding.version}"
            self.backend.setItemData(index, tip, Qt.ItemDataRole.ToolTipRole)
            model = self.backend.model()
            if finding.reason and isinstance(model, QStandardItemModel):
                model.item(index).setText(f"{finding.title or finding.name} (absent)")
            if not finding.reason and has_stage.get(finding.name):
                self.stage.addItem(finding.title or finding.name, finding.name)

    def set_choice(self, backend: str, options: Mapping[str, str], stage: str) -> None:
        """Show a choice without reporting it."""
        self.backend.setCurrentIndex(max(0, self.backend.findData(backend)))
        self.stage.setCurrentIndex(max(0, self.stage.findData(stage)))
        self._show_options(backend, options)
        self._show_reason()

    def set_connected(self, words: str, *, connected: bool, busy: bool = False) -> None:
        """Show whether devices are connected, with their names or the error."""
        self._connected = connected
        self.button.setText("Disconnect" if connected else "Connecting …" if busy else "Connect")
        self.button.setToolTip(LET_GO if connected else CONNECT)
        for widget in (self.backend, self.stage, self.options):
            widget.setEnabled(not connected and not busy)
        self._show_reason()
        if words:
            self._say(words, bad=not connected and not busy)
        if busy:
            self.button.setEnabled(False)

    def set_free(self, free: bool) -> None:
        """Allow disconnecting, unless the devices are in use."""
        self.button.setEnabled(free)
        self.button.setToolTip(LET_GO if free else "The devices are in use; stop the running task first")

    # -- inside ----------------------------------------------------------------------------------------
    def _say(self, words: str, *, bad: bool) -> None:
        set_role(self.reason, "error" if bad else "hint")
        self.reason.setText(words)

    def _show_reason(self) -> None:
        name = self.backend.currentData()
        reason = self._reasons.get(name, "")
        alone = not self._has_stage.get(name, True)
        for widget in (self.stage, self.stage_label):
            widget.setVisible(alone)
        self.button.setEnabled(self._connected or (bool(self._reasons) and not reason))
        if reason:
            self._say(reason, bad=True)
        elif alone and not self.stage.currentData() and name != "folder":
            self._say("This camera driver includes no stage. Choose a stage.", bad=False)
        elif not self._connected:
            self._say("The simulator needs no hardware." if name == "sim" else "Ready to connect.", bad=False)

    def _show_options(self, backend: str, given: Mapping[str, str]) -> None:
        options = self._options.get(backend, {})
        if tuple(self.options.fields) != tuple(options):
            old, self.options = self.options, FoldedForm((), _fields(options), "Options", OPTIONS)
            self.options.edited.connect(self._option_edited)
            self._column.replaceWidget(old, self.options)
            old.hide()
            old.deleteLater()
        self._given = {key: given.get(key, "") for key in options}
        self.options.set_values(self._given)

    def _backend_chosen(self, _: int) -> None:
        self._show_options(self.backend.currentData(), {})
        self._show_reason()
        self._emit()

    def _option_edited(self, key: str, value: str) -> None:
        self._given[key] = value
        self._emit()

    def _emit(self) -> None:
        given = tuple((key, value) for key, value in self._given.items() if value)
        self.edited.emit(self.backend.currentData() or "sim", given, self.stage.currentData() or "")

    def _pressed(self) -> None:
        if self._connected:
            self.disconnect_asked.emit()
        else:
            self._emit()
            self.connect_asked.emit()


def _fields(options: Mapping[str, str]) -> tuple[Field, ...]:
    return tuple(
        Field(
            key,
            key,
            tip=meaning,
            kind="text",
            empty=SHORT.split(meaning.replace(" really", ""), maxsplit=1)[0],
            default="",
            late=True,
        )
        for key, meaning in options.items()
    )


MOST = 1_000_000
ADD = "Add this fault to the list"
HINT = "Rehearse faults: they occur the next time the simulator is connected."
NOW = "The simulator is connected: a fault occurs after this number of calls, also during a recording."


class FaultPanel(QWidget):
    """A list of faults, and a line to add one."""

    edited = Signal(str, arguments=["text"])
    """The faults changed; ``text`` is the simulator's option ``faults``."""
    injected = Signal(object, arguments=["fault"])
    """Request to make the connected simulator fail in this way; calls are counted from now on."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._faults: list[DeviceFault] = []
        self._connected = False
        self.kind = choice_box(KINDS, "Fault to simulate, to rehearse how a recording handles it", "kind of fault")
        self.kind.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.kind.currentIndexChanged.connect(lambda _: self._count())
        self.at, self.times = QSpinBox(), QSpinBox()
        self.at.setRange(0, MOST)
        self.times.setRange(1, MOST)
        self.at.setAccessibleName("Call at which the fault begins")
        self.times.setAccessibleName("Number of calls that are affected")
        self.times.setToolTip("Number of consecutive calls that are affected")
        self.counted = QLabel()
        self.add = button("Add", ADD, self._add)
        self.remove = button("Remove", "Remove the selected fault from the list", self._remove)
        self.list = QListWidget()
        self.list.setAccessibleName("Faults of the simulator")
        self.list.setToolTip(
            "Faults that will occur, each with the number of the move, frame or reading at which it begins. To remove "
            "one, select it and press Remove"
        )
        self.list.setMaximumHeight(84)
        self.list.currentRowChanged.connect(lambda _: self._enable())
        self.hint = wrapped("hint", HINT)
        self.fold = Folded("Faults of the simulator", "Rehearse how a recording handles faults", framed=False)
        at, lasts = line("At", self.at, self.counted, stretch=1), line("Lasts", self.times, self.add, stretch=1)
        self.fold.column.addLayout(column_of(self.hint, self.kind, at, lasts, self.list, self.remove))
        column_of(self.fold, of=self)
        self._count()
        self._show()

    def set_faults(self, text: str) -> None:
        """Show the faults of an option; a fault that cannot be parsed is reported when you connect."""
        try:
            faults = parse_faults(text)
        except LfcalError:
            faults = []
        if faults != self._faults:
            self._faults = faults
            self._show()
        if faults:
            self.fold.open()

    def set_connected(self, connected: bool, *, busy: bool = False) -> None:
        """Before connecting, collect faults in the list; when connected, pass a fault directly to the simulator."""
        if connected != self._connected:
            self._connected = connected
            self.hint.setText(NOW if connected else HINT)
            self.add.setText("Inject fault" if connected else "Add")
            self.add.setToolTip("Make the simulator fail in this way" if connected else ADD)
            self._count()
        for widget in (self.kind, self.at, self.times, self.add):
            widget.setEnabled(not busy)
        self.list.setEnabled(not (connected or busy))
        self._enable()

    # -- inside ----------------------------------------------------------------------------------------
    def _count(self) -> None:
        counted = COUNTED[self.kind.currentData()]
        self.counted.setText(f". {counted} from now" if self._connected else f". {counted}")
        since = "from now" if self._connected else "after connecting"
        self.at.setToolTip(
            f"Number of the {counted} at which the fault begins. The first {counted} {since} is number 0"
        )

    def _add(self) -> None:
        fault = DeviceFault(self.kind.currentData(), self.at.value(), self.times.value())
        if self._connected:
            self.hint.setText(f"{NOW}\nLast: {fault_words(fault, now=True)}")
            self.injected.emit(fault)
            return
        self._changed([*self._faults, fault])

    def _remove(self) -> None:
        row = self.list.currentRow()
        if 0 <= row < len(self._faults):
            self._changed([fault for k, fault in enumerate(self._faults) if k != row])

    def _changed(self, faults: list[DeviceFault]) -> None:
        self._faults = faults
        self._show()
        self.edited.emit(";".join(fault.text() for fault in faults))

    def _show(self) -> None:
        row = self.list.currentRow()
        self.list.clear()
        self.list.addItems([fault_words(fault) for fault in self._faults])
        for k in range(self.list.count()):
            self.list.item(k).setToolTip(self.list.item(k).text())
        self.list.setCurrentRow(min(max(row, 0), len(self._faults) - 1))
        self.list.setVisible(bool(self._faults))
        self.remove.setVisible(bool(self._faults))
        self._enable()

    def _enable(self) -> None:
        self.remove.setEnabled(self.list.isEnabled() and self.list.currentRow() >= 0)
