"""TIFF frames with one or many pages; the chain of pages and the positions of their bytes are checked first."""

from __future__ import annotations

import logging
import struct
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, check_region, format_pixels, storage_errors
from lfcal.frames.formats._ome import ome_facts
from lfcal.frames.formats._sensor_tags import CFA, LINEAR, needs_raw_reader, sensor_facts
from lfcal.frames.formats.codecs import check_tiff_codec, codec_fact
from lfcal.frames.formats.image_file import Format, ImageFile, check_declared, check_grey, check_samples, decoding
from lfcal.frames.formats.raw import RawImage
from lfcal.frames.part import parse_roi

__all__ = ["TiffImage", "count_pages"]

# damage that tifffile logs is detected here and raised; without a handler its log would reach the terminal
logging.getLogger("tifffile").addHandler(logging.NullHandler())

_GREY = {1, CFA, LINEAR}
"""Photometric interpretations that are data: black is zero, or samples of a sensor."""

_COLOURS = "RGB"


def count_pages(path: Path) -> int:
    """Return the number of pages in a TIFF file, counted along the chain of page headers.

    Raises
    ------
    FileFormatError
        If there is no page, or the chain points beyond the end of the file or back to an earlier page.
    """
    with storage_errors(path), path.open("rb") as file:
        size = path.stat().st_size
        head = file.read(16)
        order = "<" if head[:2] == b"II" else ">"
        # BigTIFF (version 43) has 64-bit offsets
        big = head[2:4] in (b"+\0", b"\0+")
        where = struct.unpack_from(f"{order}Q" if big else f"{order}I", head.ljust(16, b"\0"), 8 if big else 4)[0]
        seen: set[int] = set()
        while where:
            # a chain that leads back would never end
            if where in seen:
                raise _damaged(path, f"page {len(seen)} leads back to an earlier one")
            seen.add(where)
            where = _next_page(file, where, size, order, big)
            if where < 0 or where > size:
                raise _damaged(path, f"the file ends within page {len(seen) - 1 if where < 0 else len(seen)}")
    if not seen:
        raise _damaged(path, "no page")
    return len(seen)


def _next_page(file: BinaryIO, where: int, size: int, order: str, big: bool) -> int:
    """Return the offset of the page after the one at ``where``; 0 after the last, -1 if the file ends too early."""
    count_form, tag, pointer = ("Q", 20, "Q") if big else ("H", 12, "I")
    if where > size:  # beyond the end of any possible file
        return -1
    file.seek(where)
    raw = file.read(struct.calcsize(order + count_form))
    if len(raw) < struct.calcsize(order + count_form):
        return -1
    after = where + len(raw) + tag * int(struct.unpack(order + count_form, raw)[0])
    if after > size:  # a forged count leads beyond the end of any possible file
        return -1
    file.seek(after)
    raw = file.read(struct.calcsize(order + pointer))
    if len(raw) < struct.calcsize(order + pointer):
        return -1
    return int(struct.unpack(order + pointer, raw)[0])


def _damaged(path: Path, reason: str) -> FileFormatError:
    return FileFormatError.expected(
        str(path), "an intact TIFF file", f"damaged data ({reason})", "record or copy it again"
    )


class TiffImage(ImageFile):
    """A TIFF file of grey pages (integers of at least 8 bits, or floats), or one component of its colour pages.

    ``raw`` is true if the tags of a DNG require processing that only the camera RAW reader performs.
    """

    def __init__(self, path: Path, colour: str | None = None) -> None:
        import tifffile

        self.path = path
        self.pages = count_pages(path)
        self._size = path.stat().st_size
        self._full: list[int] | None = None
        with decoding(path, "TIFF"):
            self._tiff = tifffile.TiffFile(path)
        try:
            with decoding(path, "TIFF"):
                # tifffile's pages share one file handle and seek in it
                self._tiff.filehandle.set_lock(True)
                self._lock = self._tiff.filehandle.lock  # the same lock protects looking up pages and reading samples
                self._first = self._tiff.pages[0]
                self._leave_out_reduced()
                self._describe(colour)
        except BaseException:
            self._tiff.close()
            raise

    def _leave_out_reduced(self) -> None:
        """Restrict the pages to those at full resolution; reduced copies may follow each page, or all of them."""
        if not any(self._tiff.pages[k].is_reduced for k in {min(1, self.pages - 1), self.pages - 1}):
            return
        full = [k for k in range(self.pages) if not self._tiff.pages[k].is_reduced]
        if full and full[0] == 0:
            self._full, self.pages = full, len(full)

    def _describe(self, colour: str | None) -> None:
        page = self._first
        bits = int(page.bitspersample)
        photometric = int(page.photometric)
        codec = self._codec(page)
        check_grey(self.path, int(page.samplesperpixel), colour, bits)
        if photometric not in _GREY and not (photometric == 2 and colour is not None):
            raise FileFormatError.expected(
                str(self.path),
                "samples that increase with light",
                f"photometric interpretation {photometric}",
                "record grey TIFF with black at zero",
            )
        if page.dtype is None or page.dtype.kind not in "iuf" or bits < 8:
            raise FileFormatError.expected(
                str(self.path), "samples of 8 bits or more", f"{bits} bits", "record 16-bit grey TIFF"
            )
        self._samples = int(page.samplesperpixel)
        self.raw = self._samples == 1 and needs_raw_reader(page)
        self._component = _COLOURS.index(colour) if colour is not None and self._samples > 1 else None
        self.shape = (int(page.imagelength), int(page.imagewidth))
        self.dtype = page.dtype.newbyteorder("=")
        check_declared(self.path, (*self.shape, self._samples), self.dtype.itemsize, self._size)
        self._stored = self.dtype
        self._virtual = self._imagej_pages()
        self._line = self._imagej_line()
        self.pages = max(self.pages, self._virtual)
        # TIFF stores 10, 12 or 14 bits packed; when read, they fill 16
        known: dict[str, Any] = {} if bits in (8, 16, 32, 64) else {"bit_depth": bits}
        known["codec"] = codec_fact(codec)
        if self._samples == 1:
            with decoding(self.path, "TIFF"):
                known |= sensor_facts(self.path, page)
        if self._component is not None:
            known["colour"] = colour
        if self._tiff.is_ome:
            text = str(self._tiff.ome_metadata or "")
            known |= ome_facts(text, self.pages, name=self.path.name, samples=self._samples)
        elif axes := self._scan_axes():
            known["scan_axes"] = axes
        if self._line is not None:
            offset, slope = self._line
            whole = slope == 1 and offset == int(offset) and abs(offset) <= 1 << 30 and self._stored.itemsize <= 2
            self.dtype = np.dtype(np.int32 if whole else np.float64 if self._stored.itemsize > 2 else np.float32)
            known["format_notes"] = (f"ImageJ's calibration is applied: {offset:g} + {slope:g} x the stored value",)
        # Micro-Manager stores metadata with every page
        own = page.tags.get(51123)
        if own is not None and isinstance(own.value, dict) and (roi := parse_roi(own.value.get("ROI"))):
            known["roi"] = roi
        self.metadata = known

    def _codec(self, page: Any) -> str:
        """Return the name of a page's compression scheme; raise `FileFormatError` for lossy compression."""

        def stored() -> bytes:
            if not page.dataoffsets or page.dataoffsets[0] <= 0:
                return b""
            with storage_errors(self.path), self.path.open("rb") as file:
                file.seek(page.dataoffsets[0])
                return file.read(min(int(page.databytecounts[0]), self._size))

        whole = page.dtype is not None and page.dtype.kind in "iu"
        return check_tiff_codec(self.path, int(page.compression), stored, whole=whole)

    def _scan_axes(self) -> tuple[str, tuple[int, ...]] | None:
        """Return names and lengths of the axes of the pages, from ImageJ's metadata."""
        import tifffile

        if not self._tiff.is_imagej or self._samples != 1:
            return None
        # open the file again for its series, because they convert its pages to frames without tags
        with tifffile.TiffFile(self.path) as again:
            series = again.series[0]
            names, lengths = str(series.axes), tuple(int(n) for n in series.shape)
        if not names.endswith("YX") or int(np.prod(lengths[:-2])) != self.pages:
            return None
        lead = [(name, n) for name, n in zip(names[:-2], lengths[:-2], strict=True) if n > 1]
        return ("".join(name for name, _ in lead), tuple(n for _, n in lead)) if len(lead) > 1 else None

    def _imagej_pages(self) -> int:
        """Return the number of images that ImageJ stores after a single page in files above 4 GB, else 0."""
        count = int((self._tiff.imagej_metadata or {}).get("images", 0)) if self._tiff.is_imagej else 0
        return count if self.pages == 1 and count > 1 and self._plain(self._first) else 0

    def _imagej_line(self) -> tuple[float, float] | None:
        """Return offset and slope of ImageJ's straight-line calibration ("signed 16-bit" files); None without one."""
        known = (self._tiff.imagej_metadata or {}) if self._tiff.is_imagej else {}
        if known.get("cf") != 0 or self._samples != 1 or self._stored.kind != "u":
            return None
        try:
            offset, slope = float(known.get("c0", 0)), float(known.get("c1", 1))
        except (TypeError, ValueError):
            return None
        usable = np.isfinite([offset, slope]).all() and slope > 0 and (offset, slope) != (0, 1)
        return (offset, slope) if usable else None

    def _calibrated(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return samples as ImageJ shows them, contiguous."""
        if self._line is not None:
            with np.errstate(over="ignore"):  # infinite samples are refused or masked like any other
                image = (self._line[0] + self._line[1] * image.astype(np.float64)).astype(self.dtype)
        return check_samples(self.path, np.ascontiguousarray(image, self.dtype))

    def _plain(self, page: Any) -> bool:
        return bool(page.is_memmappable) and self._samples == 1

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return the page with index ``page``, ``(rows, columns)``."""
        part, where = self._locate(page)
        if where is not None:
            return self._read_rows(where, slice(0, self.shape[0]))
        with decoding(self.path, "TIFF"):
            image = part.asarray(squeeze=True, maxworkers=1)
        if self._component is not None:
            # colours are stored as planes or pixel by pixel (PlanarConfiguration)
            image = image[self._component] if image.shape[0] == self._samples else image[..., self._component]
        if image.shape != self.shape:
            raise _damaged(self.path, f"page {page} has shape {image.shape}")
        return self._calibrated(image)

    def read_region(self, page: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of page ``page``; of an uncompressed page, only these rows are read."""
        rows, columns = check_region((rows, columns), self.shape)
        _, where = self._locate(page)
        if where is None:
            return np.ascontiguousarray(self.read(page)[rows, columns])
        return np.ascontiguousarray(self._read_rows(where, rows)[:, columns])

    def _locate(self, number: int) -> tuple[Any, int | None]:
        """Return the page and, if its samples are contiguous, the offset of the first sample; else None."""
        self.check_page(number)
        with self._lock, decoding(self.path, "TIFF"):
            at = number if self._full is None else self._full[number]
            page = self._first if self._virtual else self._tiff.pages[at]
            shape, dtype = (int(page.imagelength), int(page.imagewidth)), page.dtype
            starts, lengths = [int(n) for n in page.dataoffsets], [int(n) for n in page.databytecounts]
        if len(starts) != len(lengths):
            raise _damaged(self.path, f"page {number} has {len(starts)} strips or tiles and {len(lengths)} lengths")
        if shape != self.shape or dtype != self._first.dtype or page.samplesperpixel != self._samples:
            raise FileFormatError.expected(
                f"{self.path} page {number}",
                f"{self.dtype}, {format_pixels(self.shape)}, as page 0",
                f"{dtype}, {format_pixels(shape)}",
                "store only frames of the same kind in a file",
            )
        if number:  # pages may have different compression
            with decoding(self.path, "TIFF"):
                self._codec(page)
        skip = number * int(np.prod(self.shape)) * self._stored.itemsize if self._virtual else 0
        for start, length in zip(starts, lengths, strict=True):
            if start <= 0 or length <= 0 or skip + start + length > self._size:
                raise _damaged(self.path, f"samples of page {number} are missing")
        return page, (skip + starts[0] if starts and self._plain(page) else None)

    def _read_rows(self, where: int, rows: slice) -> NDArray[Any]:
        stored = self._stored.newbyteorder(self._tiff.byteorder)
        count = (rows.stop - rows.start) * self.shape[1]
        with storage_errors(self.path), self.path.open("rb") as file:
            file.seek(where + rows.start * self.shape[1] * stored.itemsize)
            data = np.fromfile(file, stored, count)
        # fromfile stops silently at the end of a file
        if data.size != count:
            raise _damaged(self.path, "the file was cut short while open")
        return self._calibrated(data.reshape(-1, self.shape[1]))

    def close(self) -> None:
        """Close the file."""
        self._tiff.close()


def _opened(path: Path, colour: str | None) -> ImageFile:
    image = TiffImage(path, colour)
    if not image.raw:
        return image
    image.close()
    return RawImage(path)


FORMAT = Format(
    "TIFF",
    frozenset({".tif", ".tiff"}),
    lambda head, _: head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    lambda path, colour, _: _opened(path, colour),
)
