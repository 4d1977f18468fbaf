"""Gauges that are no device of their own: the last number of a file that another program writes."""

from __future__ import annotations

import re
from pathlib import Path

from lfcal.devices.errors import DeviceError

__all__ = ["FileGauge"]

TAIL_BYTES = 4096
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


class FileGauge:
    """The last number in a text file: what a logger of temperature or of a photodiode appends to.

    Parameters
    ----------
    path
        The file; a line such as ``2026-05-04 12:00:03, 21.37`` counts by its last number.
    """

    unit = ""

    def __init__(self, path: Path) -> None:
        self.path, self.name = path, path.name

    def read(self) -> float:
        """Return the last number; raises `DeviceError` where there is none."""
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, 2)
                file.seek(max(0, size - TAIL_BYTES))
                text = file.read().decode("utf-8", "replace")
        except OSError as error:
            raise DeviceError(f"{self.path}: cannot be read ({error.strerror or error})") from error
        # a line without its end may be half written
        lines = [line for line in text[: text.rfind("\n") + 1].splitlines() if line.strip()]
        found = NUMBER.findall(lines[-1]) if lines else []
        if not found:
            raise DeviceError.expected(str(self.path), "a last line with a number", "none", "check what writes it")
        return float(found[-1])
