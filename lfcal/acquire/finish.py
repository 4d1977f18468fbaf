"""Finish a session: assemble H from its frames, and compress the recording."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

from lfcal.acquire.recording import FolderLock, Kind, RecordingFile, RecordingSource, file_name
from lfcal.acquire.session_file import SessionFile
from lfcal.base import Clock, FileFormatError, Work, replace_whole, require_space, worker_count
from lfcal.base.h5 import encode_chunk, new_h5
from lfcal.frames import CorrectionRecipe, FrameSource, corrected_view, iter_undamaged, oriented
from lfcal.psf import AssemblyReport, AssemblySettings, iter_assemble_plan, iter_upright

__all__ = ["Packed", "iter_assemble_session", "iter_finish", "iter_repack"]

BLOCK = 64


def iter_assemble_session(
    folder: Path,
    out: str | os.PathLike[str] | None = None,
    *,
    planes: Sequence[int] | None = None,
    recipe: CorrectionRecipe | None = None,
    settings: AssemblySettings | None = None,
    skip_damaged: bool = False,
    make: Callable[..., Work[AssemblyReport]] = iter_assemble_plan,
) -> Work[AssemblyReport]:
    """Assemble H from a session, or from its complete planes while others are still being recorded.

    Parameters
    ----------
    folder
        Folder of the session.
    out
        Path of the H file to write. None: keep H in memory.
    planes
        Indices of the depth planes to use. None: all; positions without a frame are marked as missing in H.
    recipe
        Corrections of the frames. None: only the session's dark frames.
    settings
        As in `lfcal.psf.iter_assemble_plan`.
    skip_damaged
        Whether to exclude damaged frames and list them in the report and the file, instead of raising an error.
    make
        Function that assembles H from upright frames, with the parameters of `lfcal.psf.iter_assemble_plan`. Pass
        another function to assemble plane by plane while the session is in progress.

    Raises
    ------
    InputError
        If no frame was recorded, or the frames are certainly not oriented as planned (`lfcal.psf.upright`).
    StorageError, FileFormatError
        If the folder contains no session, or a file is damaged (see ``skip_damaged``).

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.acquire import iter_assemble_session
    >>> from lfcal.base import drain
    >>> report = drain(iter_assemble_session(Path("recorded"), "new.h5"))
    >>> with report.matrix as H:
    ...     print(report.frames, "frames:", H.shape)
    627 frames: (1, 19, 33, 55, 55)
    """
    with RecordingSource(folder, planes=planes, skip_damaged=skip_damaged) as source:
        frames: FrameSource = source
        if skip_damaged:
            frames = yield from iter_undamaged(source)
        view = corrected_view(frames, recipe or CorrectionRecipe(), source.plan)
        turn, lie = yield from iter_upright(view, source.plan)
        upright = oriented(view, turn, source.plan.camera.sensor.shape)
        return (yield from make(upright, source.plan, out, settings, provenance=lie))


class Packed(NamedTuple):
    """Result of compressing a session: the bytes saved, and a message for each damaged file, which is not changed."""

    bytes_gained: int
    left: tuple[str, ...]


def iter_finish(folder: Path, *, workers: int | None = None) -> Work[Packed]:
    """Compress all finished recordings of a session; return the bytes saved, and messages on damaged files.

    A recording with missing or damaged frames is not changed, so that it can be resumed. ``folder`` is the folder of
    the session, and ``workers`` the number of threads (None: all processors).

    Examples
    --------
    >>> from dataclasses import replace
    >>> from pathlib import Path
    >>> from lfcal.acquire import iter_finish, record
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.base import drain
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=61), period=(3, 4))
    >>> _ = record(Path("wide"), plan, simulated_rig(plan))
    >>> packed = drain(iter_finish(Path("wide")))
    >>> print(packed.bytes_gained > 80e3, packed.left)
    True ()
    """
    session = SessionFile.read(folder)
    lock = FolderLock(folder)
    gained, left = 0, []
    try:
        for run in range(len(session.recordings)):
            for kind in (Kind.POSITION, Kind.REFERENCE, Kind.DARK):
                path = folder / file_name(kind, run)
                if not path.exists():
                    continue
                try:
                    gained += yield from iter_repack(path, workers=workers)
                except FileFormatError as error:
                    left.append(f"{path.name} is not packed: {error}")
    finally:
        lock.release()
    return Packed(gained, tuple(left))


def iter_repack(path: Path, *, workers: int | None = None) -> Work[int]:
    """Replace a recording by a chunked, compressed HDF5 file; return the number of bytes saved.

    Every frame is checked against its CRC-32. Recordings that are already packed or lack frames are not changed, and 0
    is returned. Each chunk contains one frame, compressed with gzip at level 1 and the shuffle and fletcher32 filters.
    ``workers`` is the number of threads (None: all processors).

    Raises
    ------
    FileFormatError
        If a frame is damaged; the message names it, and the recording is not changed.
    StorageError
        If the disk is too small for a second copy, or cannot be written.
    """
    before = path.stat().st_size
    with RecordingFile(path) as source:
        if not source.layout.in_place or not source.taken.all():
            return 0
        require_space(path.parent, before, what="the packed recording")
        with replace_whole(path) as part:
            yield from _write_packed(source, part, worker_count(workers))
            with RecordingFile(part) as packed:
                if packed.taken.sum() != source.taken.sum():
                    raise FileFormatError.expected(
                        str(path), "all records after packing", "fewer", "keep the file, and report this error"
                    )
            source.close()  # Windows cannot replace an open file
    return before - path.stat().st_size


def _write_packed(source: RecordingFile, part: Path, workers: int) -> Work[None]:
    layout = source.layout
    clock = Clock(f"pack {source.path.name}", layout.count)
    with new_h5(part) as file, ThreadPoolExecutor(workers) as pool:
        file.attrs.update(layout.attributes)
        file.create_dataset("records", data=source.records)
        frames = file.create_dataset(
            "frames",
            (layout.count, *layout.shape),
            layout.dtype,
            chunks=(1, *layout.shape),
            compression="gzip",
            compression_opts=1,
            shuffle=True,
            fletcher32=True,
        )

        def packed(slot: int) -> tuple[int, Any]:
            return slot, encode_chunk(source.read(slot))

        for start in range(0, layout.count, BLOCK):  # a block at a time, to limit memory
            yield clock.at(start)
            for slot, data in pool.map(packed, range(start, min(start + BLOCK, layout.count))):
                frames.id.write_direct_chunk((slot, 0, 0), data)
    yield clock.at(layout.count)
