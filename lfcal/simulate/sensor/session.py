"""A simulated session as files: frames, dark and white frames, camera, plan, manifest and the truth."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import InputError
from lfcal.files import replace_whole, require_space
from lfcal.progress import Clock, Work, drain
from lfcal.simulate.sensor.camera_source import SimulatedCamera

__all__ = ["frame_name", "iter_write_session", "truth_of", "write_session"]


def frame_name(source: SimulatedCamera, index: int) -> str:
    """Return the file name of a frame, ``z0_y03_x17.png``."""
    z, y, x = source.position(index)
    return f"z{z}_y{y:02d}_x{x:02d}.png"


def truth_of(source: SimulatedCamera) -> dict[str, Any]:
    """Return what was simulated, as plain JSON types."""
    return {
        "seed": source.seed,
        "tolerance": source.tolerance,
        "effects": source.metadata["simulated"]["effects"],
        "counts_per_unit": [float(source.counts_per_unit(z)) for z in range(len(source.plan.depths_um))],
    }


def iter_write_session(
    source: SimulatedCamera, folder: str | os.PathLike[str], *, darks: int = 8, whites: int = 4
) -> Work[int]:
    """Write `write_session`; yields progress in frames."""
    if source.dtype != np.uint16:
        raise InputError.expected("frames", "whole numbers", "float32", "add the effect quantisation")
    out = Path(folder)
    rows, columns = source.shape
    require_space(out, 2 * rows * columns * (len(source) + darks + whites), what="the session")
    clock = Clock("write frames", len(source) + darks + whites)
    manifest = ["file,z,y,x"]
    yield clock.at(0)
    for index in range(len(source)):
        name = frame_name(source, index)
        _write_png(out / "frames" / name, source.read(index))
        manifest.append(f"{name},{','.join(map(str, source.position(index)))}")
        yield clock.at(index + 1)
    for k in range(darks):
        _write_png(out / "dark" / f"dark_{k}.png", source.dark_frame(k))
        yield clock.at(len(source) + k + 1)
    for k in range(whites):
        _write_png(out / "white" / f"white_{k}.png", source.white_frame(k))
        yield clock.at(len(source) + darks + k + 1)
    _write_text(out / "frames" / "manifest.csv", "\n".join(manifest))
    _write_text(out / "camera.json", source.camera.to_json())
    _write_text(out / "plan.json", source.plan.to_json())
    _write_text(out / "truth.json", json.dumps(truth_of(source), indent=2))
    return len(source)


def write_session(source: SimulatedCamera, folder: str | os.PathLike[str], *, darks: int = 8, whites: int = 4) -> int:
    """Write a simulated session and return the number of frames.

    16-bit PNG frames in ``frames/`` with ``manifest.csv`` (file, z, y, x), ``dark/``, ``white/``, and
    ``camera.json``, ``plan.json`` and ``truth.json`` (what was simulated). Each file appears whole or not at all.

    Parameters
    ----------
    source
        A simulated camera whose frames are uint16.
    folder
        Made where it is not there.
    darks, whites
        Number of dark and white frames.

    Raises
    ------
    InputError
        If the frames are not whole numbers.
    StorageError
        If they cannot be written.
    """
    return drain(iter_write_session(source, folder, darks=darks, whites=whites))


def _write_png(path: Path, frame: NDArray[Any]) -> None:
    import cv2

    ok, encoded = cv2.imencode(".png", np.asarray(frame, np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not ok:
        raise RuntimeError(f"{path}: PNG encoding failed")
    with replace_whole(path) as part:
        part.write_bytes(encoded.tobytes())


def _write_text(path: Path, text: str) -> None:
    with replace_whole(path) as part:
        part.write_text(text + "\n", encoding="utf-8")
