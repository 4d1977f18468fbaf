"""`open_frames`, which opens frames of any kind."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from lfcal.base import FileFormatError, InputError, Registry, StorageError, any_of
from lfcal.camera import ScanPlan
from lfcal.frames.formats import image_suffixes, split_dataset, stacks_in
from lfcal.frames.manifest import Manifest
from lfcal.frames.orientation import AS_IS
from lfcal.frames.part import check_origin
from lfcal.frames.positions import NamePattern, check_plan_shape
from lfcal.frames.source import FrameMetadata, Frames, FrameSource
from lfcal.frames.sources import FrameOptions, SourceKind
from lfcal.frames.view import SourceView

__all__ = ["COMPONENTS", "RECORDINGS", "SOURCES", "TABLES", "datasets_in", "files_of", "open_component", "open_frames"]

SOURCES: Registry[SourceKind] = Registry(
    "frame source", "lfcal.frames.sources", "SOURCE", "lfcal.sources", order=lambda kind: (kind.rank, kind.name)
)
"""Every kind of source; the first that recognises a path opens it."""


TABLES = frozenset({".csv", ".tsv", ".txt", ".dat", ".json"})
"""Suffixes of manifests and plans, which are read from a folder together with its frames."""

RECORDINGS = ("recording", "darks", "checks")
"""Prefixes of the names of a session's files."""


def open_frames(
    path: str | os.PathLike[str],
    *,
    manifest: str | os.PathLike[str] | Manifest | None = None,
    pattern: str | NamePattern | None = None,
    order: str | None = None,
    plan_shape: Sequence[int] | None = None,
    colour: str | None = None,
    dataset: str | None = None,
    nan: str = "auto",
    blank: str = "reject",
    skip_damaged: bool = False,
    columns: str = "",
    first: int | None = None,
    plan: ScanPlan | None = None,
    orientation: str = AS_IS,
    origin: tuple[int, int] | None = None,
) -> Frames:
    """Open a folder, a file, a recorded session or a scan plan as a source of frames with their metadata.

    The folder of a recorded session needs no further arguments. Neither does the file of a scan plan, whose frames are
    simulated. For other files, positions come from exactly one of: a manifest, the file names, the scan order, or the
    file itself. A file states positions by the axes of a 5-D stack, or by ``positions`` in the same group of an HDF5
    file. The ``notes`` of the metadata list everything that had to be guessed, one line each.

    Parameters
    ----------
    path
        Path of one of these:

        - a folder of images
        - a manifest, or a list written by another program (``.csv``, ``.tsv``, ``.txt``, ``.json``), in the folder of
          its files
        - a file of many frames: multi-page TIFF, ``.npy`` or HDF5; the dataset may be appended to the path of an HDF5
          file, as in ``scan.h5::/entry/data/data``
        - the folder of a recorded session
        - a scan plan (``.json``)
    manifest
        A manifest or its path; ``manifest.json`` or ``manifest.csv`` in a folder is found automatically.
    pattern
        Pattern of file names that contain the position, such as ``"z{z}_y{y}_x{x}.png"``.
    order
        Scan order of the frames, which are sorted by names and pages: ``"serpentine"`` or ``"raster"``, as in
        `scan_positions`. It requires ``plan_shape``.
    plan_shape
        Number of positions of the scan ``(nz, ny, nx)``; with a manifest or pattern, no position may be outside it.
    colour, dataset
        As in `open_image`.
    nan, blank
        As in `lfcal.frames.FolderSource`.
    skip_damaged
        Whether to open sources with damaged frames, which `lfcal.frames.iter_undamaged` then removes. Damaged dark
        frames of a recorded session are left out of the mean dark.
    columns
        Assignment of a list's columns, such as ``"file=Name,y_um=PosY,x_um=PosX"``. The roles of other columns are
        guessed from their names.
    first
        Number of the first position along each axis in names or lists, 0 or 1. None: detected.
    plan
        Scan plan with which the stage coordinates of a list are compared; it also defines ``plan_shape`` if that is
        None.
    orientation
        Orientation of the frames (`lfcal.frames.orientation.ORIENTATIONS`), used where the light in the frames
        determines the axes of stage coordinates. ``"check"`` or ``"auto"``: unknown, see `lfcal.frames.lists.motion`.
        This function does not turn frames; use `lfcal.frames.oriented`.
    origin
        For frames that show a part of the sensor (the camera's region of interest), position (row, column) of their
        first pixel on the sensor as delivered (px). Dark and white frames must show the same part or the complete
        sensor.

    Raises
    ------
    LfcalError
        If the frames cannot be opened; the message states the file and its problem, or the option that does not apply
        to this kind of source.

    Examples
    --------
    >>> from lfcal.frames import open_frames
    >>> with open_frames("session/frames") as source:
    ...     print(len(source), source.shape, source.info(100).position, source.read(100).max())
    1254 (80, 96) Position(z=0, y=3, x=31) 3184
    """
    path, inside = split_dataset(path)
    if not path.exists():
        raise StorageError(f"{path}: no such file or folder; check the path")
    shape = None if plan_shape is None else check_plan_shape(plan_shape)
    if shape is None and plan is not None:
        shape = plan.shape[:3]
    place = None if origin is None else check_origin(origin)
    options = FrameOptions(
        *(
            manifest,
            pattern,
            order,
            shape,
            colour,
            dataset or inside,
            nan,
            blank,
            skip_damaged,
            columns,
            first,
            plan,
            orientation,
        ),
        origin=place,
    )
    source = next(kind for kind in SOURCES if kind.recognises(path)).open(path, options)
    return source if isinstance(source.metadata, FrameMetadata) else _Converted(source)


class _Converted(SourceView):
    """Frames of a plug-in whose metadata, a mapping, are converted to a record."""

    def repeats(self) -> FrameSource | None:
        """Return the repeated frames of the plug-in."""
        return self.source.repeats() if isinstance(self.source, Frames) else None


COMPONENTS = ("R", "G", "B")
"""Components of colour images."""

T = TypeVar("T")


def open_component(opened: Callable[..., T], channel: str) -> T:
    """Return the result of ``opened()``; for colour images, that of ``opened(colour=component)``.

    Parameters
    ----------
    opened
        Function that opens frames.
    channel
        Name of a colour channel, which is used as ``component``; for ``"each"``, green is used.

    Raises
    ------
    FileFormatError
        If the frames are colour images, and ``channel`` is empty.
    InputError
        If the frames are colour images, and ``channel`` is not one of their components.
    """
    try:
        return opened()
    except FileFormatError as error:
        component = "G" if channel == "each" else channel
        if component and component not in COMPONENTS and 'colour="G"' in str(error):
            raise InputError.expected(
                "colour channel", any_of(COMPONENTS), repr(channel), "choose one of these"
            ) from None
        if component not in COMPONENTS:
            raise
    # damaged grey frames fail again, with the same message
    return opened(colour=component)


HDF5 = b"\x89HDF\r\n\x1a\n"


def datasets_in(path: str | os.PathLike[str]) -> dict[str, tuple[int, ...]]:
    """Return the names and shapes of HDF5 datasets that may contain frames; empty for a file of another format."""
    file, _ = split_dataset(path)
    if not file.is_file():
        return {}
    with file.open("rb") as opened:
        if opened.read(len(HDF5)) != HDF5:
            return {}
    return stacks_in(file)


def files_of(source: Path | str | None) -> list[Path]:
    """Return the files that a command may read from ``source``: itself, or the images and data files in a folder.

    The result is empty if ``source`` is None or empty.
    """
    if source is None or not str(source):
        return []
    path, _ = split_dataset(source)
    if not path.is_dir():
        return [path]
    suffixes = image_suffixes() | TABLES
    return [p for p in path.iterdir() if p.suffix.lower() in suffixes or p.name.startswith(RECORDINGS)]
