"""What goes wrong in simulation: faults of the simulated devices, chosen on screen."""

from __future__ import annotations

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QLabel, QListWidget, QPushButton, QSpinBox, QVBoxLayout, QWidget

from lfcal.base import LfcalError
from lfcal.devices.simulated import DeviceFault, parse_faults
from lfcal_gui.pages.acquire.model_faults import COUNTED, KINDS, fault_words
from lfcal_gui.widgets import Folded, choice_box, line

__all__ = ["FaultPanel"]

MOST = 1_000_000
HINT = "Try what a fault does before it happens: they strike the next time the simulator is connected."
NOW = "The simulator is connected: a fault strikes so many calls from now, also while it records."


class FaultPanel(QWidget):
    """A list of faults, and a line to add one.

    Signals
    -------
    edited(text)
        The faults changed; ``text`` is the simulator's option ``faults``.
    injected(fault)
        A fault is to strike the simulator that is connected, counted from now.
    """

    edited = Signal(str)
    injected = Signal(object)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._faults: list[DeviceFault] = []
        self._connected = False
        self.kind = choice_box(KINDS, "What shall go wrong, to rehearse what the recording does about it")
        self.kind.setAccessibleName("kind of fault")
        self.kind.currentIndexChanged.connect(lambda _: self._count())
        self.at, self.times = QSpinBox(), QSpinBox()
        self.at.setRange(0, MOST)
        self.times.setRange(1, MOST)
        self.at.setAccessibleName("call at which the fault begins")
        self.times.setAccessibleName("calls that the fault lasts")
        self.times.setToolTip("How many calls in a row are affected")
        self.counted = QLabel()
        self.add, self.remove = QPushButton("Add"), QPushButton("Remove")
        self.add.setToolTip("Add this fault to the list")
        self.remove.setToolTip("Take the marked fault from the list")
        self.add.clicked.connect(self._add)
        self.remove.clicked.connect(self._remove)
        self.list = QListWidget()
        self.list.setAccessibleName("faults of the simulator")
        self.list.setToolTip("What will go wrong, and when; mark one to take it away")
        self.list.setMaximumHeight(84)
        self.list.currentRowChanged.connect(lambda _: self._enable())
        self.hint = QLabel(HINT)
        self.hint.setProperty("role", "hint")
        self.hint.setWordWrap(True)
        self.fold = Folded("Faults of the simulator", "Rehearse what a recording does about faults, before it is real")
        column = self.fold.column
        column.addWidget(self.hint)
        column.addWidget(self.kind)
        column.addLayout(line("At", self.at, self.counted, stretch=1))
        column.addLayout(line("Lasts", self.times, self.add, stretch=1))
        column.addWidget(self.list)
        column.addLayout(line(self.remove, stretch=0))
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(self.fold)
        self._count()
        self._show()

    def set_faults(self, text: str) -> None:
        """Show the faults of an option; one that cannot be read is told at connecting."""
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
        """Faults of the list are of devices that are not connected yet; of those that are, one strikes from now on."""
        if connected != self._connected:
            self._connected = connected
            self.hint.setText(NOW if connected else HINT)
            self.add.setText("Strike" if connected else "Add")
            self.add.setToolTip("Let this fault happen now" if connected else "Add this fault to the list")
            self._count()
        for widget in (self.kind, self.at, self.times, self.add):
            widget.setEnabled(not busy)
        self.list.setEnabled(not (connected or busy))
        self._enable()

    # -- inside ----------------------------------------------------------------------------------------
    def _count(self) -> None:
        counted = COUNTED[self.kind.currentData()]
        self.counted.setText(f". {counted} from now" if self._connected else f". {counted}")
        since = "now on" if self._connected else "connecting on"
        self.at.setToolTip(f"The {counted} at which it begins, counted from 0, from {since}")

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
        self.list.setCurrentRow(min(max(row, 0), len(self._faults) - 1))
        self.list.setVisible(bool(self._faults))
        self.remove.setVisible(bool(self._faults))
        self._enable()

    def _enable(self) -> None:
        self.remove.setEnabled(self.list.isEnabled() and self.list.currentRow() >= 0)
