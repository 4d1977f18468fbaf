"""Frames in files of a session folder, as listed in its manifest."""

from __future__ import annotations

import threading
import weakref
from collections import Counter
from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    FileFormatError,
    InputError,
    Region,
    StorageError,
    check_choice,
    check_region,
    format_count,
    format_pixels,
)
from lfcal.frames.cfa import check_greens
from lfcal.frames.damage import frame_errors
from lfcal.frames.formats import FramesLast, ImageFile, open_image
from lfcal.frames.manifest import FrameEntry, Manifest, resolve_inside
from lfcal.frames.part import stated_origin
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, Samples, check_index, check_mask, masked, observed

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["NAN_MODES", "FolderSource", "check_frame", "without_nan"]

MOST_MASKED = 0.5
"""Fraction of a frame without values above which its pixels are not masked but refused."""

NAN_MODES = ("auto", "mask", "refuse")
"""Treatments of NaN and infinity in frames; see `FolderSource`."""

MAX_OPEN = 128
"""Largest number of multi-page files kept open simultaneously."""

_OF_PAGES = (
    *("positions", "exposure_s", "scan_axes", "page_order", "order_notes"),
    *("stage_um", "stage_pages", "stage_exposure_s"),
)
"""Metadata of an image file that describe single pages; the manifest states them for each frame instead."""


def check_frame(
    frame: NDArray[Any], name: str, *, nan: str = "refuse", blank: str = "reject", bit_depth: int | None = None
) -> NDArray[Any]:
    """Return ``frame`` after checking that a sensor can have produced its values.

    Parameters
    ----------
    frame
        Frame ``(rows, columns)`` as read from its file; changed in place if ``nan`` is ``"mask"``.
    name
        Name for messages.
    nan
        ``"refuse"``: raise an error for NaN and infinity in floating-point frames; ``"mask"``: accept them, and replace
        infinity by NaN.
    blank
        ``"reject"``: raise an error for a frame with the same value in every pixel; ``"accept"``: allow it.
    bit_depth
        Number of bits that a sample may use. None: all bits of its type.

    Raises
    ------
    FileFormatError
        If a value is impossible; the message states ``name`` and the problem.
    """
    if frame.dtype.kind == "f":
        bad = ~np.isfinite(frame)
        count = int(np.count_nonzero(bad))
        if count and nan == "refuse":
            raise FileFormatError.expected(
                name, "finite values", f"{count} NaN or infinite", "record the frame again, or mask them (--nan mask)"
            )
        if count:
            frame[bad] = np.nan
    first = frame[0, 0]
    # check a few thousand samples first: most frames differ in them, and need no check of every pixel
    if blank == "reject" and (frame[::61, ::53] == first).all() and (frame == first).all() and frame.size > 1:
        raise FileFormatError.expected(
            name, "an image", f"the value {first} in every pixel", "check shutter and lamp, and record it again"
        )
    if bit_depth is not None and frame.max() >= 1 << bit_depth:
        raise FileFormatError.expected(
            name,
            f"values below {1 << bit_depth} ({bit_depth} bits)",
            frame.max(),
            "correct the bit depth, or shift left-aligned samples",
        )
    return frame


def without_nan(frame: NDArray[Any], cfa: str = "") -> NDArray[Any]:
    """Return a copy of ``frame`` in which each NaN is replaced by the mean of its nearest same-colour neighbours.

    A NaN without such neighbours is replaced by the median of the frame, or by 0 if all pixels are NaN. ``cfa`` is the
    colour filter pattern in row-major order; empty for a monochrome frame.
    """
    from lfcal.frames.corrections import repair_nan

    values = np.array(frame, np.float32)
    repair_nan(values, (0, 0), np.zeros(3), cfa)
    lost = np.isnan(frame)
    filled = np.array(frame)
    filled[lost] = values[lost]
    filled[np.isnan(filled)] = np.nanmedian(values) if not np.isnan(values).all() else 0.0
    return filled


class FolderSource(Frames):
    """Frame source for the files of a folder, as listed by a manifest.

    Files are opened on demand; multi-page files stay open until `close`. All frames must have the shape, dtype and
    colour filter that the manifest states; if it states none, those of the first frame.

    Parameters
    ----------
    root
        Folder of the files; no file outside it is opened.
    manifest
        List of the frames with their positions.
    colour, dataset
        As in `open_image`.
    nan
        Treatment of NaN and infinity in floating-point frames. ``"mask"``: the pixels are masked. ``"refuse"``: an
        error is raised. ``"auto"``: pixels without a finite value in the first, the middle and the last frame are
        masked; NaN or infinity in other pixels raises an error. Masked pixels are invalid; `read` replaces them by the
        mean of their nearest neighbours.
    blank
        As in `check_frame`.
    skip_damaged
        Whether to take shape and dtype from the first readable frame instead of the first frame, which may be damaged.
    notes, facts
        Notes on guesses, one line each, and further metadata of all frames by name; both are added to `metadata`.
    origin
        As in `lfcal.frames.open_frames`; it is added to `metadata`.
    frames_last
        Whether the last axis of a stack numbers its frames, instead of the first.

    Raises
    ------
    LfcalError
        If a file is missing or outside the folder, or the first frame does not match the manifest.

    Examples
    --------
    >>> from lfcal.frames import FolderSource, read_manifest
    >>> with FolderSource("session/frames", read_manifest("session/frames/manifest.csv")) as source:
    ...     print(len(source), source.info(33).label, source.read(33).shape)
    1254 z0_y01_x32.png (80, 96)
    """

    def __init__(
        self,
        root: Path,
        manifest: Manifest,
        *,
        colour: str | None = None,
        dataset: str | None = None,
        nan: str = "auto",
        blank: str = "reject",
        skip_damaged: bool = False,
        notes: tuple[str, ...] = (),
        facts: Mapping[str, Any] | None = None,
        origin: tuple[int, int] | None = None,
        frames_last: bool = False,
    ) -> None:
        check_choice("NaN in frames", nan, NAN_MODES)
        check_choice("blank frames", blank, ("reject", "accept"))
        self.root = Path(root)
        self.manifest = manifest
        self._options = {"colour": colour, "dataset": dataset}
        self._nan, self._blank, self._frames_last = nan, blank, frames_last
        uses = Counter(entry.file for entry in manifest.entries)
        self._paths = resolve_inside(self.root, uses)
        # single-frame files are opened and closed; only stacks are kept open
        self._many = {name for name, count in uses.items() if count > 1}
        self._open: dict[str, ImageFile] = {}
        self._lock = threading.Lock()
        # closes the files even if a source is discarded without close()
        self._finalizer = weakref.finalize(self, _close_all, self._open)
        self._shape, self._dtype, found = self._inspect_any() if skip_damaged else self._inspect()
        found |= facts or {}
        notes = (*notes, *found.pop("format_notes", ()))
        self._origin = origin or (0, 0)
        stated = stated_origin(found.pop("roi", None), self._shape)
        if origin is not None:
            found["origin"] = origin
            if stated not in (None, origin):
                words = f"the frames' metadata state {stated[0]},{stated[1]}; the given {origin[0]},{origin[1]} is used"
                notes = (*notes, f"first pixel on the sensor: {words}")
        elif stated is not None:
            found["stated_origin"] = stated
        mask = found.pop("mask", None)
        self._mask = None if mask is None else check_mask(mask, self._shape, str(root))
        self._metadata = FrameMetadata.of(found | {"notes": notes})
        if nan == "auto" and self._dtype.kind == "f":
            self._mask_fixed()

    def _mask_fixed(self) -> None:
        """Mask the pixels without a finite value in all of three frames, unless most pixels have none."""
        fixed: NDArray[np.bool_] | None = None
        for number in dict.fromkeys((0, len(self) // 2, len(self) - 1)):
            entry = self.manifest.entries[number]
            try:
                with self._image(entry.file) as image:
                    bad = ~np.isfinite(image.read(entry.page))
            except (FileFormatError, StorageError):  # said when the frame is read
                continue
            if bad.shape != self._shape or not bad.any():
                return
            fixed = bad if fixed is None else fixed & bad
        if fixed is None or not fixed.any() or fixed.mean() > MOST_MASKED:
            return
        self._mask = ~fixed if self._mask is None else self._mask & ~fixed
        count = format_count(int(fixed.sum()), "pixel", "pixels")
        words = f"masked: {count} without a finite value in any frame"
        self._metadata = replace(self._metadata, notes=(*self._metadata.notes, words))

    def _inspect_any(self) -> tuple[tuple[int, int], np.dtype[Any], dict[str, Any]]:
        """Return the properties from the first readable frame and the manifest."""
        for number, entry in enumerate(self.manifest.entries):
            try:
                with self._image(entry.file) as image:
                    image.read(entry.page)
            except (FileFormatError, StorageError):
                continue
            return self._inspect(number)
        return self._inspect()

    def _inspect(self, number: int = 0) -> tuple[tuple[int, int], np.dtype[Any], dict[str, Any]]:
        """Return shape, dtype and metadata from one frame and the manifest."""
        manifest, name = self.manifest, self.manifest.entries[number].file
        with self._image(name) as image:
            shape, dtype = manifest.shape or image.shape, np.dtype(manifest.dtype or image.dtype)
            # positions and exposures are properties of single frames
            found = {key: value for key, value in image.metadata.items() if key not in _OF_PAGES}
            if manifest.cfa and not found.get("cfa"):
                found["cfa"] = manifest.cfa
            self._check_kind(name, image, shape, dtype, manifest.cfa)
            if found.get("cfa"):
                check_greens(image.read(manifest.entries[number].page), found["cfa"], name)
        if manifest.bit_depth is not None:
            found["bit_depth"] = manifest.bit_depth
        if found.get("bit_depth"):
            found.setdefault("saturation", float((1 << found["bit_depth"]) - 1))
        if manifest.plan_shape is not None:
            found["plan_shape"] = manifest.plan_shape
        return shape, dtype, {**found, "path": str(self.root)}

    def _check_kind(self, name: str, image: ImageFile, shape: tuple[int, int], dtype: np.dtype[Any], cfa: str) -> None:
        """Raise `FileFormatError` unless ``image`` has the shape, dtype and colour filter of all frames."""
        sizes = format_pixels(shape), format_pixels(image.shape)
        for what, wanted, got in (("size", *sizes), ("samples", dtype, image.dtype)):
            if wanted != got:
                raise FileFormatError.expected(
                    f"{name}, {what}", wanted, got, "record all frames with the same setting, or leave it out"
                )
        own = image.metadata.get("cfa", cfa)
        if cfa and own != cfa:
            raise FileFormatError.expected(
                f"{name}, colour filter", cfa, own or "none", "correct its Bayer tag or the manifest"
            )

    @contextmanager
    def _image(self, name: str) -> Iterator[ImageFile]:
        """Yield the opened file; multi-page files are kept open."""
        if name not in self._many or (len(self._open) >= MAX_OPEN and name not in self._open):
            image = self._opened(name)
            try:
                yield image
            finally:
                image.close()
            return
        with self._lock:
            if not self._finalizer.alive:
                raise InputError(f"{self.root}: the folder of frames is closed; open it again")
            if name not in self._open:
                self._open[name] = self._opened(name)
            image = self._open[name]
        yield image

    def _opened(self, name: str) -> ImageFile:
        image = open_image(self._paths[name], **self._options)
        return FramesLast(image) if self._frames_last else image

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of every frame (px)."""
        return self._shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type of every frame."""
        return self._dtype

    @property
    def metadata(self) -> FrameMetadata:
        """Metadata common to all frames, from the inspected frame, the manifest, and the arguments."""
        return self._metadata

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.manifest.entries)

    def info(self, index: int) -> FrameInfo:
        """Return what the manifest states about frame ``index``, with the origin and the mask common to all frames."""
        entry = self.manifest.entries[check_index(index, len(self))]
        label = f"{entry.file} page {entry.page}" if entry.file in self._many else entry.file
        return FrameInfo(
            (entry.position,), self._origin, entry.exposure_s, (entry.dy, entry.dx), label=label, mask=self._mask
        )

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or the part of it in ``region``, as a new array, after `check_frame`."""
        return self._values(index, region)[0]

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the result of `read` with validity, noise and the number of saturated pixels.

        Saturated, masked and non-finite samples are invalid.
        """
        values, lost = self._values(index, region)
        found = observed(values, self._metadata.saturation, self._metadata.noise)
        for mask in (self._mask if self._mask is None or region is None else self._mask[region], lost):
            found = found if mask is None else masked(found, mask)
        return found

    def _values(self, index: int, region: Region | None) -> tuple[NDArray[Any], NDArray[np.bool_] | None]:
        """Return a frame without NaN, and a mask, True at pixels that had a value. None: all."""
        entry = self.manifest.entries[check_index(index, len(self))]
        label = self.info(index).label
        with frame_errors(label, entry.position):
            frame = self._read(entry, label, region)
            if self._dtype.kind != "f" or not (lost := np.isnan(frame)).any():
                return frame, None
            known = self._mask if self._mask is None or region is None else self._mask[region]
            if self._nan == "auto" and (stray := int((lost if known is None else lost & known).sum())):
                raise FileFormatError.expected(
                    label,
                    "finite values",
                    f"{stray} NaN or infinite",
                    "record the frame again, or mask them (--nan mask)",
                )
            return without_nan(frame, self._metadata.cfa), ~lost

    def _read(self, entry: FrameEntry, label: str, region: Region | None) -> NDArray[Any]:
        with self._image(entry.file) as image:
            self._check_kind(label, image, self._shape, self._dtype, self._metadata.cfa)
            if region is None:
                frame = image.read(entry.page)
            else:
                part = check_region(region, self._shape)
                frame = image.read_region(entry.page, *part)
                if self._blank == "reject" and frame.size and (frame == frame[0, 0]).all():
                    # a dark corner may have a single value, so the whole frame is checked
                    self._checked(image.read(entry.page), label, self._blank)
                    return self._checked(frame, label, "accept")
        return self._checked(frame, label, self._blank if region is None else "accept")

    def _checked(self, frame: NDArray[Any], label: str, blank: str) -> NDArray[Any]:
        nan = "refuse" if self._nan == "refuse" else "mask"
        return check_frame(frame, label, nan=nan, blank=blank, bit_depth=self._metadata.bit_depth)

    def close(self) -> None:
        """Close the open files."""
        with self._lock:
            self._finalizer()


def _close_all(images: dict[str, ImageFile]) -> None:
    for image in images.values():
        image.close()
    images.clear()
