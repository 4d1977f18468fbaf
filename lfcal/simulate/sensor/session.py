"""A simulated session as files: frames, dark and white frames, camera, plan, manifest and the truth."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal import __version__
from lfcal.base import (
    Clock,
    InputError,
    Position,
    Work,
    drained,
    plain,
    read_text,
    replace_whole,
    require_space,
    storage_errors,
    write_text,
)
from lfcal.simulate.plane_task import describe
from lfcal.simulate.sensor.camera_source import SimulatedCamera

__all__ = [
    "UNFINISHED",
    "check_session_folder",
    "discard_unfinished",
    "encode_png",
    "frame_name",
    "iter_write_session",
    "truth_of",
    "unfinished",
    "write_session",
]


def frame_name(position: Position) -> str:
    """Return the file name of the frame at a scan position, such as ``z0_y03_x17.png``."""
    z, y, x = position
    return f"z{z}_y{y:02d}_x{x:02d}.png"


def truth_of(source: SimulatedCamera) -> dict[str, Any]:
    """Return seed, tolerance and effects of the simulation, and the factors from H to counts, as plain JSON types."""
    return {
        "seed": source.seed,
        "tolerance": source.tolerance,
        "effects": describe(source.effects),
        "counts_per_unit": [float(source.counts_per_unit(z)) for z in range(len(source.plan.depths_um))],
    }


UNFINISHED = "unfinished.json"
"""File that identifies a session while it is being written; it is removed when the session is complete."""

PICTURES = ("frames/z*_y*_x*.png", "dark/dark_*.png", "white/white_*.png")


def iter_write_session(
    source: SimulatedCamera,
    folder: str | os.PathLike[str],
    *,
    darks: int = 8,
    whites: int = 4,
    resume: bool = False,
    provenance: Mapping[str, Any] | None = None,
) -> Work[int]:
    """Write a simulated session to a folder, and return the number of its scan frames.

    The session contains 16-bit PNG frames in ``frames/``, listed in ``manifest.csv`` (file, z, y, x), dark frames in
    ``dark/`` and white frames in ``white/``. It also contains ``camera.json``, ``plan.json`` and ``truth.json``, which
    records what was simulated. Each file is written atomically.

    Parameters
    ----------
    source
        A simulated camera whose frames are uint16.
    folder
        Folder of the session, created if needed.
    darks, whites
        Number of dark frames and of white frames.
    resume
        Whether to keep the frames that an earlier run wrote, and to write only the missing ones.
    provenance
        Additional entries of ``truth.json``, as plain JSON types.

    Yields
    ------
    Progress
        Counted in frames.

    Raises
    ------
    InputError
        If the frames are not integers, or ``resume`` finds the frames of another session.
    StorageError
        If a file cannot be written.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import SimulatedCamera, iter_write_session
    >>> from lfcal.simulate.effects import Quantisation
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (1, 3), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> source = SimulatedCamera(plan, (Quantisation(),), level="geometric")
    >>> [step.count for step in iter_write_session(source, "stepwise", darks=1, whites=0)]
    ['0 of 4', '1 of 4', '2 of 4', '3 of 4', '4 of 4']
    """
    if source.dtype != np.uint16:
        raise InputError.expected("frames", "whole numbers", "float32", "add the effect quantisation")
    out = Path(folder)
    rows, columns = source.shape
    require_space(out, 2 * rows * columns * (len(source) + darks + whites), what="the session")
    clock = Clock("write frames", len(source) + darks + whites)
    manifest = ["file,z,y,x"]
    _begin(source, out, darks + whites, resume)
    yield clock.at(0)
    for index in range(len(source)):
        name = frame_name(source.position(index))
        if not (resume and (out / "frames" / name).exists()):  # each file is complete, or does not exist
            _write_png(out / "frames" / name, source.read(index))
        manifest.append(f"{name},{','.join(map(str, source.position(index)))}")
        yield clock.at(index + 1)
    for k in range(darks):
        _write_png(out / "dark" / f"dark_{k}.png", source.dark_frame(k))
        yield clock.at(len(source) + k + 1)
    for k in range(whites):
        _write_png(out / "white" / f"white_{k}.png", source.white_frame(k))
        yield clock.at(len(source) + darks + k + 1)
    write_text(out / "frames" / "manifest.csv", "\n".join(manifest) + "\n")
    write_text(out / "camera.json", source.camera.to_json() + "\n")
    write_text(out / "plan.json", source.plan.to_json() + "\n")
    write_text(out / "truth.json", json.dumps({**truth_of(source), **(provenance or {})}, indent=2) + "\n")
    (out / UNFINISHED).unlink()
    return len(source)


write_session = drained(
    iter_write_session,
    """
    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import SimulatedCamera, write_session
    >>> from lfcal.simulate.effects import Quantisation
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (1, 3), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> source = SimulatedCamera(plan, (Quantisation(),), level="geometric")
    >>> write_session(source, "simulated", darks=1, whites=1)
    3
    >>> sorted(path.name for path in Path("simulated").iterdir())
    ['camera.json', 'dark', 'frames', 'plan.json', 'truth.json', 'white']
    """,
)


def _begin(source: SimulatedCamera, out: Path, others: int, resume: bool) -> None:
    """Record in the folder which session is being written; raise `InputError` if it contains another unfinished one."""
    identity = {
        "frames": len(source),
        "others": others,
        "lfcal": __version__,
        "tolerance": source.tolerance,
        "peak": source.peak,
        "simulated": source.metadata.simulated,
        "plan": source.plan.to_dict(),
    }
    mark, text = out / UNFINISHED, json.dumps(plain(identity), sort_keys=True)
    if resume and mark.exists() and read_text(mark).strip() != text:
        raise InputError.expected(
            str(out), "frames of the same session", "frames of another, unfinished session", "choose another folder"
        )
    if not (resume and mark.exists()):
        write_text(mark, text + "\n")


def unfinished(folder: str | os.PathLike[str]) -> tuple[int, int] | None:
    """Return how many scan frames of a stopped session have been written, and how many it has in total.

    The result is None if the folder contains no stopped session. Dark and white frames are not counted.
    """
    out = Path(folder)
    if not (out / UNFINISHED).is_file():
        return None
    total = int(json.loads(read_text(out / UNFINISHED))["frames"])
    return sum(1 for _ in out.glob(PICTURES[0])), total


def check_session_folder(folder: str | os.PathLike[str], *, resume: bool = False) -> None:
    """Raise `InputError` unless a folder is new or empty; with ``resume``, it may contain a stopped session.

    Frames of two sessions in one folder would be read as one session.
    """
    out = Path(folder)
    if resume and unfinished(out) is not None:
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        got = "a folder that is not empty" if out.is_dir() else "a file"
        raise InputError.expected(str(out), "a new or empty folder", got, "choose another folder")


def discard_unfinished(folder: str | os.PathLike[str]) -> None:
    """Remove all frames of a stopped session, and the file that marks it as unfinished, if the folder contains one."""
    out = Path(folder)
    if unfinished(out) is None:
        return
    with storage_errors(out):
        for path in (path for pattern in PICTURES for path in out.glob(pattern)):
            path.unlink()
        for name in ("frames", "dark", "white"):
            if (out / name).is_dir() and not any((out / name).iterdir()):
                (out / name).rmdir()
        (out / UNFINISHED).unlink()


def encode_png(frame: NDArray[Any]) -> bytes:
    """Return a frame as the bytes of a PNG file with 16-bit samples; values are converted to uint16."""
    from lfcal.base import cv2

    # the highest level needs 14 times the time, and saves 1 % of the bytes
    ok, encoded = cv2.imencode(".png", np.asarray(frame, np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not ok:
        raise RuntimeError("PNG encoding failed")
    return bytes(encoded.tobytes())


def _write_png(path: Path, frame: NDArray[Any]) -> None:
    with replace_whole(path) as part:
        part.write_bytes(encode_png(frame))
