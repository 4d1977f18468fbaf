"""Location of the sample sessions, in a checkout or in an installed package.

Noise takes most of the space of a frame. An installed package therefore contains the light of the frames without noise
in one compact file. The frames are made from it once, in the cache folder of the user.
"""

from __future__ import annotations

import functools
import hashlib
import json
import lzma
import shutil
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Position, StorageError, read_text, write_text
from lfcal.camera import ScanPlan
from lfcal.simulate.effects import DarkCurrent, FixedPattern, FrameEffect, Quantisation, ReadNoise, ShotNoise
from lfcal.simulate.sensor import FrameKind, encode_png, expose, frame_name

__all__ = ["SENSOR_EFFECTS", "pack_light", "sample_recording", "sample_session", "unpack_light", "write_frames"]

SENSOR_EFFECTS: tuple[FrameEffect, ...] = (ShotNoise(), ReadNoise(), FixedPattern(), DarkCurrent(), Quantisation())
"""Effects of the sensor of the sample session."""

LIGHT = "light.xz"
MADE = "made.txt"
"""File that states the number of bytes of all frames: a power failure may leave frames empty."""

STEP = 0.3
"""Quantisation of stored light, in standard deviations of shot and read noise."""

_KEPT: list[tempfile.TemporaryDirectory[str]] = []
"""Folders that are removed when the process ends."""


def sample_session() -> Path:
    """Return the folder of the sample session: frames in image files, with plan, dark frames and a white image."""
    session = _place("session", "plan.json")
    return session if (session / "frames").is_dir() else _unpacked(session)


def sample_recording() -> Path:
    """Return the folder of the sample session that was recorded by lfcal."""
    return _place("recorded", "session.json")


def _place(name: str, holds: str) -> Path:
    package = Path(__file__).resolve().parents[1]
    for place in (package.parent / "sample_data" / name, package / f"_sample_{name}"):
        if (place / holds).is_file():
            return place
    raise StorageError(
        f"sample data ({name}): not part of this installation; run sample_data/make.py of the source code"
    )


def _unpacked(session: Path) -> Path:
    """Return the session with its frames, in the user's cache folder or, where that cannot be written, elsewhere."""
    from platformdirs import user_cache_path

    digest = hashlib.sha256((session / LIGHT).read_bytes()).hexdigest()[:12]
    folder = user_cache_path("lfcal") / f"sample-{digest}"
    if _complete(folder):
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f"{folder.name}-", dir=folder.parent))
    except OSError:
        return _temporary(session)
    try:
        write_frames(session, part)
        shutil.rmtree(folder, ignore_errors=True)
        part.rename(folder)
    except OSError:
        if not _complete(folder):  # not made by another process meanwhile: the disk is full, say
            return _temporary(session)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


@functools.cache
def _temporary(session: Path) -> Path:
    folder = tempfile.TemporaryDirectory(prefix="lfcal-sample-")
    _KEPT.append(folder)
    write_frames(session, Path(folder.name))
    return Path(folder.name)


def _complete(folder: Path) -> bool:
    try:
        return int((folder / MADE).read_text(encoding="ascii")) == _bytes(folder)
    except (OSError, ValueError):
        return False


def _bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in (folder / "frames").iterdir())


def write_frames(session: Path, out: Path) -> None:
    """Copy the sample session ``session``, as packed in an installed package, to ``out``, and simulate its frames."""
    shutil.copytree(session, out, dirs_exist_ok=True, ignore=shutil.ignore_patterns(LIGHT))
    plan = ScanPlan.from_json(read_text(session / "plan.json"))
    seed = int(json.loads(read_text(session / "truth.json"))["seed"])
    lights = unpack_light((session / LIGHT).read_bytes(), plan)
    (out / "frames").mkdir(exist_ok=True)
    manifest = ["file,z,y,x"]
    for index, (z, y, x) in enumerate(plan.order_indices().tolist()):
        frame = expose(
            lights[z, y, x],
            plan.camera,
            SENSOR_EFFECTS,
            exposure_s=plan.exposures[z],
            seed=seed,
            kind=FrameKind.LIGHT,
            index=index,
        )
        name = frame_name(Position(z, y, x))
        # not flushed one by one: the number of bytes below finds what a power failure left
        (out / "frames" / name).write_bytes(encode_png(frame))
        manifest.append(f"{name},{z},{y},{x}")
    write_text(out / "frames" / "manifest.csv", "\n".join(manifest) + "\n")
    write_text(out / MADE, str(_bytes(out)))


def pack_light(light: NDArray[np.floating], plan: ScanPlan) -> bytes:
    """Return the light of all frames (photoelectrons ``(nz, ny, nx, rows, columns)``) in compact form.

    It is rounded to steps of 0.3 standard deviations of the noise. Corresponding pixels of neighbouring positions are
    adjacent.
    """
    noise = _read_noise(plan)
    codes = np.rint(2 / STEP * (np.sqrt(noise**2 + light) - noise)).astype("<u2")
    ordered = np.ascontiguousarray(codes.transpose(0, 3, 1, 4, 2))
    low_and_high = np.ascontiguousarray(ordered.reshape(-1, 1).view(np.uint8).T)
    return lzma.compress(low_and_high.tobytes(), preset=9 | lzma.PRESET_EXTREME)


def unpack_light(packed: bytes, plan: ScanPlan) -> NDArray[np.float32]:
    """Return the light that `pack_light` packed and rounded, ``(nz, ny, nx, rows, columns)`` in photoelectrons."""
    (nz, ny, nx), (rows, columns) = plan.shape[:3], plan.camera.sensor.shape
    low_and_high = np.frombuffer(lzma.decompress(packed), np.uint8).reshape(2, -1)
    codes = np.ascontiguousarray(low_and_high.T).view("<u2").reshape(nz, rows, ny, columns, nx)
    noise = _read_noise(plan)
    light = (STEP / 2 * codes.astype(np.float64) + noise) ** 2 - noise**2
    return np.ascontiguousarray(light.transpose(0, 2, 4, 1, 3).astype(np.float32))


def _read_noise(plan: ScanPlan) -> float:
    return float(plan.camera.sensor.read_noise_e)
