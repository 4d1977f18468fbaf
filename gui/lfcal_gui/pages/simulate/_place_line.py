"""Which position is looked at: its plane, and its place in the period."""

from __future__ import annotations

from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QSpinBox, QWidget

from lfcal.base import format_length
from lfcal.camera import ScanPlan
from lfcal_gui.widgets import line


class PlaceLine(QWidget):
    """A list of planes, and y and x.

    Signals
    -------
    changed()
        Another plane or position was chosen.
    """

    changed = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.plane_box = QComboBox()
        self.plane_box.setAccessibleName("plane")
        self.plane_box.setMinimumContentsLength(6)
        self.plane_box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.plane_box.setToolTip("Depth plane of the pictures: many effects grow away from focus")
        self.plane_box.currentIndexChanged.connect(lambda _: self.changed.emit())
        self.row_box, self.column_box = QSpinBox(), QSpinBox()
        for box, axis in ((self.row_box, "y"), (self.column_box, "x")):
            box.setAccessibleName(f"position {axis}")
            box.setToolTip(f"Source position {axis} in the period (px)")
            box.setKeyboardTracking(False)
            box.setMinimumWidth(44)
            box.valueChanged.connect(lambda _: self.changed.emit())
        row: QHBoxLayout = line("Plane", self.plane_box, "y", self.row_box, "x", self.column_box, stretch=1)
        row.setContentsMargins(0, 0, 0, 0)
        self.setLayout(row)

    def show_plan(self, plan: ScanPlan) -> None:
        """Offer planes and positions of a plan; the middle ones where the plan is another."""
        planes = [f"{z}: {format_length(depth)}" for z, depth in enumerate(plan.depths_um)]
        ny, nx = plan.period
        before = [self.plane_box.itemText(k) for k in range(self.plane_box.count())]
        if before == planes and (self.row_box.maximum(), self.column_box.maximum()) == (ny - 1, nx - 1):
            return
        blockers = [QSignalBlocker(w) for w in (self.plane_box, self.row_box, self.column_box)]
        self.plane_box.clear()
        self.plane_box.addItems(planes)
        self.plane_box.setCurrentIndex(len(planes) // 2)
        for box, count in ((self.row_box, ny), (self.column_box, nx)):
            box.setMaximum(count - 1)
            box.setValue(count // 2)
        for blocker in blockers:
            blocker.unblock()

    @property
    def place(self) -> tuple[int, int, int]:
        """The position (z, y, x)."""
        return max(0, self.plane_box.currentIndex()), self.row_box.value(), self.column_box.value()
