"""Finished steps of a fit, stored in a folder, from which a stopped fit continues."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, note, read_text, replace_whole, write_text

__all__ = ["Arrays", "Steps"]

Arrays = Mapping[str, NDArray[Any]]
"""Result of a step: arrays by name."""

KEY = "fit.json"


class Steps:
    """Steps of a fit in their order; the result of a finished step is read from its file, unless that is damaged.

    Parameters
    ----------
    folder
        Folder of the results, which is created if needed. None: nothing is stored.
    key
        Text that differs between fits to different frames or with different settings.
    settings
        Settings that the first run chooses, by name, as plain JSON types.

    Attributes
    ----------
    settings
        The settings that the first run has chosen.

    Raises
    ------
    InputError
        If the folder contains the steps of another fit, or if its list of settings is damaged.
    StorageError
        If the folder cannot be read or written.
    """

    def __init__(self, folder: Path | None, key: str, settings: Mapping[str, Any]) -> None:
        self._folder, self._count, self.settings = folder, 0, dict(settings)
        if folder is None:
            return
        file = folder / KEY
        if not file.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            write_text(file, json.dumps({"key": key, "settings": self.settings}))
            return
        try:
            known = json.loads(read_text(file))
            found = "those of another fit" if known["key"] != key else ""
            self.settings = dict(known["settings"])
        except (KeyError, TypeError, ValueError):
            found = f"a damaged file {KEY}"
        if found:
            raise InputError.expected(
                f"{folder}, stored steps",
                "those of a fit with the same frames and settings",
                found,
                "repeat the same command, or start again (--force)",
            )

    def result(self, make: Callable[[], Arrays]) -> Arrays:
        """Return the result of the next step, which ``make`` computes if it is not stored."""
        self._count += 1
        if self._folder is None:
            return make()
        file = self._folder / f"step_{self._count:04d}.npz"
        if file.is_file():
            try:
                with file.open("rb") as data, np.load(data, allow_pickle=False) as stored:
                    return dict(stored)
            except (OSError, EOFError, ValueError, zipfile.BadZipFile, zlib.error) as error:
                note(f"{file}: cannot be read ({error}); this step is computed again")
        found: dict[str, Any] = dict(make())
        with replace_whole(file) as part, part.open("wb") as out:
            np.savez(out, **found)
        return found
