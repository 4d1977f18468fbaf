"""Quality: one H inspected, two held beside each other, and many over time."""

from __future__ import annotations

from PySide6.QtWidgets import QTabWidget

from gui.pages.quality.compare_panel import ComparePanel
from gui.pages.quality.inspect_panel import InspectPanel
from gui.pages.quality.trend_panel import TrendPanel

__all__ = ["QualityPanel"]


class QualityPanel(QTabWidget):
    """The page's tabs."""

    def __init__(self) -> None:
        super().__init__()
        self.setDocumentMode(True)
        self.inspect, self.compare, self.trend = InspectPanel(), ComparePanel(), TrendPanel()
        self.addTab(self.inspect, "Inspection")
        self.addTab(self.compare, "Beside another H")
        self.addTab(self.trend, "Over time")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.inspect.apply_theme()
        self.compare.apply_theme()
        self.trend.apply_theme()
