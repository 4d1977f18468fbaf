"""Quality: one H inspected, and two compared."""

from __future__ import annotations

from PySide6.QtWidgets import QTabWidget

from lfcal_gui.pages.quality.inspect_panel import InspectPanel
from lfcal_gui.widgets import ComparePanel

__all__ = ["QualityPanel"]


TIPS = (
    "Is this H good enough, what is wrong with it, and what to do about it",
    "Did it change, or is it as the simulation foretold? Two H position by position",
)


class QualityPanel(QTabWidget):
    """The page's tabs."""

    def __init__(self) -> None:
        super().__init__()
        self.setDocumentMode(True)
        self.inspect, self.compare = InspectPanel(), ComparePanel()
        tabs = (self.inspect, "Inspection"), (self.compare, "Beside another H")
        for (tab, title), tip in zip(tabs, TIPS, strict=True):
            self.setTabToolTip(self.addTab(tab, title), tip)

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.inspect.apply_theme()
        self.compare.apply_theme()
