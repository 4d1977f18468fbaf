"""Quality: one H inspected, and two held beside each other."""

from __future__ import annotations

from PySide6.QtWidgets import QTabWidget

from gui.pages.quality.compare_panel import ComparePanel
from gui.pages.quality.inspect_panel import InspectPanel

__all__ = ["QualityPanel"]


class QualityPanel(QTabWidget):
    """The page's tabs."""

    def __init__(self) -> None:
        super().__init__()
        self.setDocumentMode(True)
        self.inspect, self.compare = InspectPanel(), ComparePanel()
        self.addTab(self.inspect, "Inspection")
        self.addTab(self.compare, "Beside another H")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.inspect.apply_theme()
        self.compare.apply_theme()
