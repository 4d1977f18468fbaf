"""Choice of files to write; existing files are replaced only with the user's consent."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from PySide6.QtWidgets import QFileDialog, QMessageBox, QWidget

from lfcal.base import LfcalError, StorageError, replace_whole
from lfcal_gui.workers import words_of


def ask_target(
    parent: QWidget, title: str, name: str, kinds: str, outputs: Callable[[Path], Sequence[Path]] | None = None
) -> str:
    """Ask where to write; return the path, empty if the user cancels.

    A name without a suffix takes the suffix of the chosen kind. The dialog asks about replacing the typed name only. If
    other files are written, this function asks about them.

    Parameters
    ----------
    parent, title, name, kinds
        Parent widget and title of the dialog, offered file name, and kinds of files, such as
        ``"TIFF (*.tif);;numpy (*.npy)"``.
    outputs
        Function that returns the files that are written for a path. None: only the path itself.
    """
    typed, kind = QFileDialog.getSaveFileName(parent, title, name, kinds)
    if not typed:
        return ""
    path = Path(with_suffix(typed, kind or kinds))
    try:
        files = [path] if outputs is None else list(outputs(path))
    except LfcalError as error:
        # the suffix of the name, or the settings for it, are not possible
        QMessageBox.warning(parent, "Cannot write", words_of(error))
        return ""
    return str(path) if may_replace(parent, [file for file in files if file != Path(typed)]) else ""


def with_suffix(path: str, kind: str) -> str:
    """Return ``path`` with the first suffix of a kind such as ``"TIFF (*.tif *.tiff)"`` unless it has one itself.

    A name that ends like that suffix takes it whole: ``scan.json`` becomes ``scan.useq.json``.
    """
    own = Path(path).suffix
    offered = re.findall(r"\*(\.[\w.]+)", kind)
    # "H_0.5um" has no file suffix
    if own and offered and own not in offered and offered[0].endswith(own) and not path.endswith(offered[0]):
        return path.removesuffix(own) + offered[0]
    if (own and re.fullmatch(r"\.[A-Za-z][A-Za-z0-9]{1,5}", own)) or not offered:
        return path
    return path + str(offered[0])


def write_file(parent: QWidget, path: str, write: Callable[[Path], object]) -> bool:
    """Write ``path`` with ``write`` via a temporary file that replaces it when complete; report a failure."""
    try:
        with replace_whole(path) as part:
            write(part)
    except (LfcalError, OSError) as error:
        QMessageBox.warning(parent, "Cannot write", words_of(error))
        return False
    return True


def write_picture(widget: QWidget, path: str) -> bool:
    """Save an image of a widget as PNG; report a failure."""

    def write(part: Path) -> None:
        if not widget.grab().save(str(part), "PNG"):
            raise StorageError(
                f"{path}: the image could not be written; check that the folder exists and the disk is not full"
            )

    return write_file(widget, path, write)


def may_replace(parent: QWidget, paths: Iterable[Path]) -> bool:
    """Return whether the files may be written: none exists, or the user agrees to replace them."""
    there = [path for path in paths if path.exists()]
    if not there:
        return True
    names = "\n".join(str(path) for path in there[:8]) + ("\n…" if len(there) > 8 else "")
    what = "This file exists" if len(there) == 1 else f"These {len(there)} files exist"
    buttons = QMessageBox.StandardButton
    answer = QMessageBox.question(
        parent, "Replace it?", f"{what}:\n{names}\n\nReplace it?", buttons.Yes | buttons.No, buttons.No
    )
    return answer == buttons.Yes
