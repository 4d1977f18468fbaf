"""Choice of the dataset in an HDF5 file that contains several stacks of frames."""

from __future__ import annotations

from PySide6.QtCore import QSignalBlocker, Signal
from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel

from lfcal.frames import split_dataset

TIP = (
    "Dataset of the file that contains the frames. The list shows all datasets that may contain frames, with their axes"
)


class DatasetBox(QComboBox):
    """Combo box of the datasets of a file, with its label; both are hidden unless there are several."""

    chosen = Signal(str, arguments=["path"])
    """The user chose a dataset; ``path`` names the file and the dataset, such as ``scan.h5::/entry/data/data``."""

    def __init__(self) -> None:
        super().__init__()
        self.setAccessibleName("Dataset")
        self.setToolTip(TIP)
        self._label = QLabel("Dataset")
        self.activated.connect(lambda index: self.chosen.emit(self.itemData(index)))
        self.offer((), "")

    def add_to(self, grid: QGridLayout, row: int) -> None:
        """Add label and box to a row of a grid."""
        grid.addWidget(self._label, row, 0)
        grid.addWidget(self, row, 1)

    def offer(self, found: tuple[tuple[str, str], ...], frames: str) -> None:
        """Set the datasets to choose from, with their descriptions; the one in ``frames`` is selected."""
        with QSignalBlocker(self):
            self.clear()
            for path, words in found:
                self.addItem(words, path)
            file, name = split_dataset(frames)
            self.setPlaceholderText("choose one")
            self.setCurrentIndex(self.findData(f"{file}::/{name}"))
        for widget in (self._label, self):
            widget.setVisible(bool(found))
