"""Where something is written: no existing file is replaced before the user said so."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from PySide6.QtWidgets import QFileDialog, QMessageBox, QWidget

__all__ = ["ask_target", "may_replace"]


def ask_target(parent: QWidget, title: str, name: str, kinds: str) -> str:
    """Ask where to write; return the path, empty if the user thought better of it.

    A name without a suffix takes that of the chosen kind. The dialog asks about replacing the name as it was typed,
    so the name with the suffix is asked about here.
    """
    typed, kind = QFileDialog.getSaveFileName(parent, title, name, kinds)
    if not typed:
        return ""
    path = with_suffix(typed, kind or kinds)
    return path if path == typed or may_replace(parent, [Path(path)]) else ""


def with_suffix(path: str, kind: str) -> str:
    """Return ``path`` with the first suffix of a kind such as ``"TIFF (*.tif *.tiff)"`` unless it has one itself."""
    own = Path(path).suffix
    offered = re.findall(r"\*(\.[\w.]+)", kind)
    # "H_0.5um" ends in no suffix of a file
    if (own and re.fullmatch(r"\.[A-Za-z][A-Za-z0-9]{1,5}", own)) or not offered:
        return path
    return path + str(offered[0])


def may_replace(parent: QWidget, paths: Iterable[Path]) -> bool:
    """Return whether the files may be written: none is there, or the user agrees to lose what they hold."""
    there = [path for path in paths if path.exists()]
    if not there:
        return True
    names = "\n".join(str(path) for path in there[:8]) + ("\n…" if len(there) > 8 else "")
    what = "This file exists" if len(there) == 1 else f"These {len(there)} files exist"
    buttons = QMessageBox.StandardButton
    answer = QMessageBox.question(
        parent, "Replace it?", f"{what}:\n{names}\n\nReplace what is there?", buttons.Yes | buttons.No, buttons.No
    )
    return answer == buttons.Yes
