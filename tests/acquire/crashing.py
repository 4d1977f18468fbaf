"""Programs killed and disks cut off at random times, and what is left."""

from __future__ import annotations

import fcntl
import os
import random
import shutil
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from lfcal.acquire.finish import iter_assemble_session
from lfcal.acquire.recording.source import RecordingSource
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.psf import AssemblySettings

STRICT = AssemblySettings(strict=True)
EXT4_IOC_SHUTDOWN = 0x8004587D
NO_LOG_FLUSH = struct.pack("<I", 2)


@dataclass
class Tally:
    """What the trials found."""

    crashes: int = 0
    acknowledged: int = 0
    lost: int = 0
    unreadable: int = 0
    lives: int = 0
    finished: bool = False
    frames: set[int] = field(default_factory=set)


def start(folder: Path, plan: ScanPlan) -> subprocess.Popen[bytes]:
    """Begin a recording program on ``folder``, or let it resume."""
    Path(f"{folder}.plan.json").write_text(plan.to_json())
    resume = ["resume"] if (folder / "session.json").exists() else []
    command = [sys.executable, "-m", "tests.acquire.crash_child", str(folder), *resume]
    return subprocess.Popen(command, cwd=Path(__file__).parents[2], stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def read_for(child: subprocess.Popen[bytes], seconds: float) -> bytes:
    """Return what the child writes until ``seconds`` after its first output."""
    descriptor = child.stdout.fileno()
    said = os.read(descriptor, 1 << 16)
    end = time.monotonic() + seconds
    os.set_blocking(descriptor, False)
    while time.monotonic() < end and child.poll() is None:
        try:
            said += os.read(descriptor, 1 << 20)
        except BlockingIOError:
            time.sleep(0.0005)
    return said


def rest(child: subprocess.Popen[bytes]) -> tuple[bytes, str]:
    """Return the remaining output of the dead child, and its errors."""
    os.set_blocking(child.stdout.fileno(), True)
    said, complaint = child.stdout.read(), child.stderr.read().decode(errors="replace")
    child.stdout.close()
    child.stderr.close()
    return said, complaint


def heard(said: bytes) -> set[int]:
    """Return the positions acknowledged in full lines."""
    return {int(line) for line in said.split(b"\n")[:-1]}


def check(folder: Path, tally: Tally) -> None:
    """Count acknowledged frames that are missing or damaged."""
    if not tally.frames:
        return
    with h5py.File(folder / "recording.h5", "r", locking=False) as file:  # any reader may open it
        file["frames"][0]
    with RecordingSource(folder) as source:
        places = [source.info(k).position for k in range(len(source))]
        there = {int(np.ravel_multi_index(place, source.plan.shape[:3])): k for k, place in enumerate(places)}
        tally.lost += len(tally.frames - there.keys())
        for flat in tally.frames & there.keys():
            source.read(there[flat])  # its CRC is checked


def kill_and_resume(folder: Path, plan: ScanPlan, kills: int, rng: random.Random, longest_s: float) -> Tally:
    """Record ``plan`` into ``folder``, killed ``kills`` times at random and resumed after each, to its end."""
    tally = Tally()
    while not tally.finished:
        child = start(folder, plan)
        tally.lives += 1
        if tally.crashes < kills:
            said = read_for(child, rng.uniform(0.0, longest_s))
            child.kill()
            child.wait()
        else:
            said = b""
            child.wait()
        more, complaint = rest(child)
        if child.returncode not in (0, -9):
            raise RuntimeError(complaint)
        tally.crashes += child.returncode == -9
        tally.finished = child.returncode == 0
        new = heard(said + more)
        tally.acknowledged += len(new)
        tally.frames |= new
        check(folder, tally)
    return tally


def equal_matrices(one: Path, two: Path) -> bool:
    """Return whether two sessions assemble to the same H, plane by plane."""
    with RecordingSource(one) as source:
        planes = len(source.plan.depths_um)
    for z in range(planes):
        a, b = (drain(iter_assemble_session(folder, planes=[z], settings=STRICT)).matrix for folder in (one, two))
        if not np.array_equal(a[0], b[0]):
            return False
    return True


def undisturbed(folder: Path, plan: ScanPlan) -> None:
    """Record ``plan`` into ``folder`` without any trouble."""
    child = start(folder, plan)
    _, complaint = rest(child)
    if child.wait() != 0:
        raise RuntimeError(complaint)


# -- power cuts ----------------------------------------------------------------------------------------
def why_no_power_cut() -> str:
    """Return why a file system cannot be cut off here, or an empty string."""
    if os.name != "posix" or os.geteuid() != 0:
        return "cutting off a file system needs root"
    if not Path("/dev/loop-control").exists():
        return "no loop devices"
    missing = [name for name in ("mkfs.ext4", "mount", "umount") if shutil.which(name) is None]
    return f"{missing[0]} is not installed" if missing else ""


class Disk:
    """An ext4 file system in a file, which can lose its power."""

    def __init__(self, image: Path, mount: Path, size: int) -> None:
        self.image, self.mount = image, mount
        mount.mkdir(parents=True, exist_ok=True)
        with image.open("wb") as file:
            file.truncate(size)
        subprocess.run(["mkfs.ext4", "-q", "-F", str(image)], check=True, capture_output=True)

    def attach(self) -> bool:
        """Mount it; the journal of the file system is replayed."""
        command = ["mount", "-o", "loop,commit=1", str(self.image), str(self.mount)]
        return subprocess.run(command, capture_output=True).returncode == 0

    def cut(self) -> None:
        """Stop every write at once, as a power cut does: nothing in memory reaches the disk."""
        descriptor = os.open(self.mount, os.O_RDONLY)
        try:
            fcntl.ioctl(descriptor, EXT4_IOC_SHUTDOWN, NO_LOG_FLUSH)
        finally:
            os.close(descriptor)

    def detach(self) -> None:
        """Unmount it, waiting for the last user."""
        for _ in range(100):
            if subprocess.run(["umount", str(self.mount)], capture_output=True).returncode == 0:
                return
            time.sleep(0.1)


def power_cut(work: Path, plan: ScanPlan, seconds: float, size: int) -> Tally:
    """Cut the power while a session is recorded on a new file system, and count what is lost."""
    disk = Disk(work / "disk.img", work / "mnt", size)
    if not disk.attach():
        raise RuntimeError("the file system does not mount")
    try:
        folder = disk.mount / "session"
        child = start(folder, plan)
        trial = Tally(crashes=1, frames=heard(read_for(child, seconds)))  # acknowledged before the cut
        disk.cut()
        child.kill()
        child.wait()
        rest(child)
        disk.detach()
        try:
            if not disk.attach():
                raise RuntimeError("the file system does not mount again")
            check(folder, trial)
        except Exception as error:
            print(f"unreadable: {error}", file=sys.stderr)
            trial.unreadable, trial.lost = 1, len(trial.frames)
    finally:
        disk.detach()
    trial.acknowledged = len(trial.frames)
    return trial


def power_cuts(work: Path, plan: ScanPlan, cuts: int, rng: random.Random, longest_s: float, size: int) -> Tally:
    """Cut the power ``cuts`` times, each in a new session, and count what is lost."""
    total = Tally()
    for _ in range(cuts):
        trial = power_cut(work, plan, rng.uniform(0.0, longest_s), size)
        for name in ("crashes", "acknowledged", "lost", "unreadable"):
            setattr(total, name, getattr(total, name) + getattr(trial, name))
    return total
