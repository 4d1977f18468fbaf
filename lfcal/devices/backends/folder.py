"""Use files that another program records as frames of a camera, once each file is complete.

For each frame, lfcal writes a request file with the number, the exposure, and the requested position of the source. The
other program (or a person) moves the source if lfcal does not, records a frame, and saves one image.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, LfcalError, format_pixels, write_text
from lfcal.camera import ScanPlan
from lfcal.devices.backends._common import CameraFacts, ExternalStage
from lfcal.devices.errors import DeviceLost, FrameTimeout, IncompleteFrame
from lfcal.devices.protocols import Frame, Roi, Setting
from lfcal.devices.registry import number_option
from lfcal.devices.rig import Rig
from lfcal.frames import read_image
from lfcal.frames.formats import image_suffixes

__all__ = ["BACKEND", "FolderBackend"]

REQUEST = "lfcal-request.json"
Signature = tuple[int, int]


class FolderBackend:
    """Backend that uses a folder as a camera."""

    name = "folder"
    title = "files of another program, as they appear"
    has_stage = True
    options: Mapping[str, str] = {
        "path": "folder in which the other program saves its files",
        "pattern": "file name, with {number} for the number of the request, or * for any text (default *)",
        "quiet": "time for which a file must not grow before it is read (s, default 0.2)",
        "wait": "longest wait for a file (s, default 60)",
        "bits": "bits per sample; the plan's by default",
    }

    def probe(self) -> str:
        """Return the supported file formats."""
        return "TIFF, PNG, PGM, NPY, camera RAW"

    def open(self, plan: ScanPlan, options: Mapping[str, str]) -> Rig:
        """Return a rig with a camera that reads frames from a folder, and a stage that another program moves."""
        path = Path(options.get("path", ""))
        if not options.get("path") or not path.is_dir():
            raise InputError.expected("option path", "a folder", repr(options.get("path", "")), "create it first")
        pattern = options.get("pattern", "*")
        if "/" in pattern or os.sep in pattern:
            raise InputError.expected(
                "option pattern",
                "a name without folders",
                repr(pattern),
                "leave the folders out, and give the folder with the option path",
            )
        stage = ExternalStage()
        bits = int(number_option(options, "bits", plan.camera.sensor.bit_depth, low=1, high=16))
        quiet = number_option(options, "quiet", 0.2, low=0)
        wait = number_option(options, "wait", 60.0, low=0.01)
        return Rig(_Camera(path, pattern, plan.camera.sensor.shape, bits, stage, quiet_s=quiet, wait_s=wait), stage)


BACKEND = FolderBackend()


class _Camera(CameraFacts):
    """The files of one folder."""

    def __init__(
        self,
        folder: Path,
        pattern: str,
        shape: tuple[int, int],
        bits: int,
        stage: ExternalStage,
        *,
        quiet_s: float,
        wait_s: float,
    ) -> None:
        self._folder, self._pattern, self._quiet, self._wait, self._stage = folder, pattern, quiet_s, wait_s, stage
        self._shape, self._bits = shape, bits
        self._dtype = np.dtype(np.uint8 if bits <= 8 else np.uint16)
        self._exposure = 0.0
        self._number = 0
        self.name = f"files {pattern} in {folder.resolve()}"

    def set_exposure(self, seconds: float) -> Setting[float]:
        """Request this exposure (s) from now on; the other program must set it."""
        self._exposure = seconds
        return Setting(seconds, seconds)

    def set_roi(self, roi: Roi) -> Setting[Roi]:
        """Return the whole sensor, because files contain whole frames."""
        return Setting(roi, Roi(0, 0, *self._shape))

    def grab(self, timeout_s: float) -> Frame:
        """Write the request, wait for the file, and return its frame."""
        # list files before the request; any new file afterwards belongs to it
        known = self._listing()
        self._number += 1
        started = time.monotonic()
        self._request()
        deadline = started + max(timeout_s, self._wait)
        trouble = ""
        while time.monotonic() < deadline:
            for path in self._new(known):
                try:
                    data = self._read(path)
                except LfcalError as error:
                    trouble = str(error)  # it may still be growing; the deadline decides
                    continue
                if data is not None:
                    return Frame(data, self._number, self._exposure, started)
            time.sleep(min(0.02, max(self._quiet, 0.001)))
        if trouble:
            raise IncompleteFrame(
                f"{self._folder}: a file remained unreadable ({trouble}); check the program that writes the files"
            )
        message = (
            f"{self._folder}: no complete image file matching {self._pattern!r} appeared for request {self._number} "
            f"within {deadline - started:.4g} s; check the program that writes the files and its file format"
        )
        if "{number" in self._pattern:
            raise FrameTimeout(message)
        raise DeviceLost(
            f"{message}, and use {{number}} in the pattern, so that a late file cannot be mistaken for the next one"
        )

    def close(self) -> None:
        """Remove the request file."""
        (self._folder / REQUEST).unlink(missing_ok=True)

    def _request(self) -> None:
        if not self._folder.is_dir():
            raise DeviceLost(f"{self._folder}: the folder is missing; create it and start the other program")
        asked = {"number": self._number, "exposure_s": self._exposure, "stage_um": self._stage.position()}
        write_text(self._folder / REQUEST, json.dumps(asked))

    def _listing(self) -> dict[str, Signature]:
        """Return name, size and time of every image in the folder that may answer."""
        found: dict[str, Signature] = {}
        pattern = self._pattern if "{number" not in self._pattern else "*"
        try:
            for path in self._folder.glob(pattern):
                if path.suffix.lower() in image_suffixes() and not path.name.startswith("."):
                    info = path.stat()
                    found[path.name] = (info.st_size, info.st_mtime_ns)
        except FileNotFoundError:  # the file was removed meanwhile
            pass
        return found

    def _new(self, known: dict[str, Signature]) -> list[Path]:
        """Return files that are new, or were written again, since ``known``."""
        if "{number" in self._pattern:
            name = self._pattern.format(number=self._number)
            path = self._folder / name
            return [path] if path.exists() and self._listing().get(name) != known.get(name) else []
        return [self._folder / name for name, signature in self._listing().items() if known.get(name) != signature]

    def _read(self, path: Path) -> NDArray[Any] | None:
        """Return the frame if the file is complete, None while it grows; raise an error if it is not a frame."""
        try:
            before = path.stat()
            # size or time of a growing file change
            time.sleep(self._quiet)
            after = path.stat()
        except FileNotFoundError:  # the file was renamed or removed meanwhile
            return None
        if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns) or not after.st_size:
            return None
        frame = np.asarray(read_image(path))
        if frame.shape != self._shape:
            raise InputError.expected(
                path.name,
                format_pixels(self._shape),
                format_pixels(frame.shape),
                "correct the sensor of the plan, or the region of the camera",
            )
        if frame.dtype != self._dtype and not (frame.dtype == np.uint8 and self._dtype == np.uint16):
            raise InputError.expected(path.name, f"{self._dtype}", frame.dtype, "save raw samples")
        return frame.astype(self._dtype)
