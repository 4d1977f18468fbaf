"""Quality: one H inspected, and two held beside each other."""

from __future__ import annotations

from PySide6.QtWidgets import QTabWidget

from gui.pages.quality.inspect_panel import InspectPanel

__all__ = ["QualityPanel"]


class QualityPanel(QTabWidget):
    """The page's tabs."""

    def __init__(self) -> None:
        super().__init__()
        self.setDocumentMode(True)
        self.inspect = InspectPanel()
        self.addTab(self.inspect, "Inspection")

    def apply_theme(self) -> None:
        """Take the colours of the theme in use."""
        self.inspect.apply_theme()
