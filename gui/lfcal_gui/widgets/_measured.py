"""What every view of a picture offers: measuring, the contrast that was chosen there, copying and saving of values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PySide6.QtWidgets import QApplication

from lfcal_gui.widgets._measuring import Measuring
from lfcal_gui.widgets.picture_menu import save_values

__all__ = ["MeasuredView"]

Levels = tuple[float, float]


class MeasuredView:
    """Part of a view, which says what is shown; see `lfcal_gui.widgets._measuring.Measurable` for the rest that it has.

    Attributes
    ----------
    contrast
        Levels that the user chose in this view; None: those of the page.
    copied
        Whether the values go to the clipboard: a whole frame is too much for a spreadsheet.
    """

    contrast: Levels | None = None
    copied = True

    def measured(self) -> NDArray[Any] | None:
        """Return the picture."""
        raise NotImplementedError

    def quantity(self) -> str:
        """Return what the values are, with the unit."""
        raise NotImplementedError

    def file_name(self) -> str:
        """Return what the picture is called in files."""
        raise NotImplementedError

    def set_contrast(self, levels: Levels | None) -> None:
        """Show these values in this and the next pictures, whatever the page says; None: what the page says."""
        raise NotImplementedError

    def entries(self) -> list[tuple[str, Callable[[], Any]]]:
        """Return what a menu offers for the picture; nothing where there is none."""
        if self.measured() is None:
            return []
        automatic = [] if self.contrast is None else [("Automatic contrast", lambda: self.set_contrast(None))]
        copying = [("Copy values", self.copy_data)] if self.copied else []
        return [
            ("Contrast, profile, region …", self.measure),
            *automatic,
            *copying,
            ("Save data …", lambda: self.save_data()),
        ]

    def measure(self) -> Measuring:
        """Open the window that measures in this picture."""
        self.measuring = Measuring(self, self.quantity())
        self.measuring.show()
        return self.measuring

    def copy_data(self) -> None:
        """Put the values on the clipboard, for a spreadsheet."""
        image = self.measured()
        if image is not None:
            rows = ("\t".join(f"{value:.7g}" for value in row) for row in image)
            QApplication.clipboard().setText("\n".join(rows))

    def save_data(self, path: str = "") -> None:
        """Write the values as ``.npy``, or as text with ``.csv``."""
        image, parent = self.measured(), self
        if image is not None:
            save_values(parent, np.asarray(image), self.file_name(), path)  # type: ignore[arg-type]
