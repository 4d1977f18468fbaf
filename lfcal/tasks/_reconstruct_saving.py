"""Where volumes go: a file each, or one file for all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.reconstruct import MetricGrid, Projector
    from lfcal.tasks._reconstruct_frames import FrameFile

__all__ = ["Save", "Saved", "saving", "targets_of"]

Save = Callable[[str, "NDArray[Any] | None", Mapping[str, Any]], None]
"""Takes the name of a frame, the volume behind it, and what is known of it; None: there is no volume."""

Saved = Callable[[], AbstractContextManager[Save]]
"""Gives what saves volumes; files that hold several are there when its block has ended."""


def targets_of(frames: Sequence[FrameFile], out: Path, suffix: str | None) -> dict[str, Path]:
    """Return the file of each frame's volume: ``out`` for all, or one each in the folder ``out`` with ``suffix``.

    With a ``suffix``, too, all go to ``out`` where that is the name of a volume file.

    Raises
    ------
    InputError
        If no volume can have such a name, or the library that writes it is not installed.
    """
    from lfcal.reconstruct import SUFFIXES, check_suffix, check_zarr

    whole = suffix is None or out.suffix.lower() in SUFFIXES
    found = {f.name: check_suffix(out if whole else out / f"{f.name}{suffix}") for f in frames}
    if any(path.suffix.lower() == ".zarr" for path in found.values()):
        check_zarr()
    return found


@contextmanager
def saving(
    P: Projector,
    voxel: tuple[float, float] | None,
    targets: Mapping[str, Path],
    details: Mapping[str, Any],
    shape: tuple[int, ...],
    *,
    grid: MetricGrid | None = None,
    times_s: Sequence[float | None] = (),
) -> Iterator[Save]:
    """Give what saves the volume of a frame: into its own file, or into one file that holds them all.

    A frame without volume gets no file; in one that holds all, NaN keeps its place in time.

    Parameters
    ----------
    P
        Projector, which knows the depths.
    voxel
        Sides (y, x) of a voxel (µm), where they are known.
    targets
        File of each frame's volume, by the frame's name.
    details
        What else all files say.
    shape
        ``(nz, Y, X)`` of a volume as it is written.
    grid
        Where volumes are put on a grid of one voxel size.
    times_s
        When each frame was taken (s), where that is known.
    """
    import numpy as np

    from lfcal.reconstruct import VolumeFacts, write_volumes

    depths = P.depths if P.camera is not None else None
    origin = None if grid is None else grid.origin_um
    if grid is not None:
        details = {**details, "voxel_um": grid.voxel_um, "origin_um": grid.origin_um}

    def placed(volume: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(volume if grid is None else grid.apply(volume), np.float32)

    files = list(dict.fromkeys(targets.values()))
    if len(files) == 1 and len(targets) > 1:
        known = [float(t) for t in times_s if t is not None]
        times = known if len(known) == len(targets) else None
        facts = VolumeFacts(depths, voxel, {**details, "frames": list(targets)}, origin, times)
        with write_volumes(files[0], (len(targets), *shape), facts) as add:
            nothing = np.broadcast_to(np.float32(np.nan), shape)
            yield lambda _, volume, known: add(nothing if volume is None else placed(volume))
        return

    def save(name: str, volume: NDArray[Any] | None, known: Mapping[str, Any]) -> None:
        if volume is None:
            return
        facts = VolumeFacts(depths, voxel, {**details, "frame": name, **known}, origin)
        with write_volumes(targets[name], shape, facts) as add:
            add(placed(volume))

    yield save
