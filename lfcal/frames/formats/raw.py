"""Camera RAW frames: the sensor's mosaic, its visible area, and the facts that the file states."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, format_pixels, storage_errors
from lfcal.frames.formats._decoder_messages import caught_messages
from lfcal.frames.formats._sensor_tags import CFA, LINEAR, check_pattern
from lfcal.frames.formats.codecs import LOSSLESS, check_tiff_codec, codec_fact
from lfcal.frames.formats.image_file import Format, ImageFile, decoding

__all__ = ["RawImage", "codec_of"]

PICTURES = {6, 7, 34892, 50002, 52546}
"""Compression schemes that RAW files share with pictures: JPEG, which has a lossless mode, and JPEG XL."""

SONY = 32767
"""Scheme of Sony's compressed RAW, which rounds differences of 16 pixels to 7 bits."""


class RawImage(ImageFile):
    """A camera RAW file of one frame.

    Nothing is interpolated, scaled or clipped. ``metadata`` contains ``cfa`` (the pattern of the visible area, in
    row-major order) and, if the file states a white level, ``saturation``. For each pattern position it contains
    ``black_level`` (sample value) and, if the file states it, the camera's white balance ``gains`` (1 for the first
    green).
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with storage_errors(path):
            path.open("rb").close()
        with self._opened() as raw:
            self._describe(raw)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Yield the opened file; warnings of LibRaw also count as damage."""
        with decoding(self.path, "camera RAW"):
            import rawpy

            with caught_messages(str(self.path)) as complaint, rawpy.imread(str(self.path)) as raw:
                yield raw
            if complaint():
                raise ValueError(complaint())

    def _describe(self, raw: Any) -> None:
        import rawpy

        if raw.raw_type != rawpy.RawType.Flat:
            raise FileFormatError.expected(
                str(self.path),
                "one sample per pixel",
                "samples of a layered or processed sensor",
                "record the unprocessed mosaic",
            )
        self.shape = (int(raw.sizes.height), int(raw.sizes.width))
        self.dtype = np.dtype(np.uint16)
        top, left = int(raw.sizes.top_margin), int(raw.sizes.left_margin)
        side = 1 if raw.raw_pattern is None else int(raw.raw_pattern.shape[0])
        names = raw.color_desc.decode("ascii")
        mosaic = [(r, c) for r in range(side) for c in range(side)] if side > 1 else []
        index = [int(raw.raw_color(top + r, left + c)) for r, c in mosaic] or [0]
        cfa = "".join(names[k] for k in index) if mosaic else ""
        check_pattern(self.path, cfa)
        black = [float(raw.black_level_per_channel[k]) for k in index]
        metadata: dict[str, Any] = {"cfa": cfa, "black_level": tuple(black)}
        if raw.white_level:
            metadata["saturation"] = float(raw.white_level)
        balance = [float(g) for g in raw.camera_whitebalance]
        gains = [balance[k] or balance[names.index(names[k])] for k in index]
        if cfa and min(gains) > 0:
            one = gains[cfa.index("G")] if "G" in cfa else gains[0]
            metadata["gains"] = tuple(g / one for g in gains)
        self.metadata = metadata | codec_of(self.path)

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return the unprocessed mosaic of the visible area, ``(rows, columns)``."""
        self.check_page(page)
        with self._opened() as raw:
            frame = np.array(raw.raw_image_visible, self.dtype, order="C")
        if frame.shape != self.shape:
            raise FileFormatError.expected(
                str(self.path), format_pixels(self.shape), format_pixels(frame.shape), "the file changed; copy it again"
            )
        return frame


def codec_of(path: Path) -> dict[str, Any]:
    """Return the metadata entry ``codec`` for the mosaic in a RAW file based on TIFF; empty if unknown.

    Raises
    ------
    FileFormatError
        If the samples are compressed with an image codec that is lossy, or cannot be checked.
    """
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            pages = [page for first in file.pages for page in (first, *(first.pages or ()))]
            mosaic = next((p for p in pages if getattr(p, "photometric", None) in (CFA, LINEAR)), None)
            if mosaic is None or not mosaic.dataoffsets:
                return {}
            compression = int(mosaic.compression)
            file.filehandle.seek(mosaic.dataoffsets[0])
            stored = file.filehandle.read(min(1 << 16, mosaic.databytecounts[0]))
    except (FileFormatError, MemoryError):
        raise
    except Exception:  # LibRaw also reads files that are not TIFF, or unusual ones
        return {}
    if compression == SONY:
        return {"codec": codec_fact("Sony ARW", lossless=False)}
    if compression in LOSSLESS or compression in PICTURES:
        return {"codec": codec_fact(check_tiff_codec(path, compression, lambda: stored, whole=True))}
    return {}


_SUFFIXES = frozenset(
    ".3fr .arw .cr2 .cr3 .crw .dcr .dng .erf .iiq .kdc .mef .mos .mrw .nef .nrw .orf .pef .raf .rw2 .rwl .sr2 .srf"
    " .srw .x3f".split()
)
"""Suffixes by which camera RAW is recognised; it is tried before TIFF, because most RAW files look like TIFF."""

FORMAT = Format(
    "camera RAW", _SUFFIXES, lambda _, path: path.suffix.lower() in _SUFFIXES, lambda path, *_: RawImage(path), rank=-1
)
