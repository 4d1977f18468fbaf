"""FITS files, written here card by card after the standard."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base import FileFormatError, UnsafeFileError
from lfcal.frames import open_frames, open_image

STACK = np.random.default_rng(0).integers(0, 60_000, (4, 5, 7)).astype(np.uint16)


def fits(data: NDArray[Any] | None, first: str = "SIMPLE  =                    T", **cards: Any) -> bytes:
    """Return one header with its data."""
    bits = {"u1": 8, "i2": 16, "i4": 32, "i8": 64, "f4": -32, "f8": -64}
    lengths = () if data is None else data.shape[::-1]
    known = {"BITPIX": 8 if data is None else bits[data.dtype.str[1:]], "NAXIS": len(lengths)}
    known |= {f"NAXIS{k + 1}": n for k, n in enumerate(lengths)} | cards
    lines = [first, *(f"{name:<8}= {value!s:>20} / a comment" for name, value in known.items()), "END"]
    head = "".join(line.ljust(80) for line in lines).encode()
    body = b"" if data is None else data.astype(data.dtype.newbyteorder(">")).tobytes()
    return b"".join(part + bytes(-len(part) % 2880) for part in (head.ljust(-(-len(head) // 2880) * 2880), body))


@pytest.mark.parametrize(
    ("stored", "cards", "expected"),
    [
        ((STACK.astype(int) - 32768).astype("i2"), {"BZERO": 32768, "BSCALE": 1}, STACK),
        (STACK.astype("i4"), {}, STACK.astype(np.int32)),
        ((STACK.astype(np.int64) - (1 << 31)).astype("i4"), {"BZERO": 1 << 31}, STACK.astype(np.uint32)),
        (STACK.astype("f4"), {}, STACK.astype(np.float32)),
        ((STACK // 4).astype("i2"), {"BSCALE": "0.5", "BZERO": "1.5E+1"}, (STACK // 4 * 0.5 + 15).astype(np.float32)),
        ((STACK % 200).astype("u1"), {}, (STACK % 200).astype(np.uint8)),
        (STACK.astype("f8"), {}, STACK.astype(np.float64)),
    ],
)
def test_samples_are_those_that_the_file_states(
    tmp_path: Path, stored: NDArray[Any], cards: dict[str, Any], expected: NDArray[Any]
) -> None:
    (tmp_path / "a.fits").write_bytes(fits(stored, EXPTIME="0.25", OBJECT="'it''s'", **cards))
    image = open_image(tmp_path / "a.fits")
    assert image.dtype == expected.dtype and image.pages == 4 and image.shape == (5, 7)
    np.testing.assert_array_equal([image.read(k) for k in range(4)], expected)
    np.testing.assert_array_equal(image.read_region(2, slice(1, 4), slice(2, 6)), expected[2, 1:4, 2:6])
    with open_frames(tmp_path / "a.fits", order="raster", plan_shape=(1, 2, 2)) as frames:
        assert frames.info(3).exposure_s == 0.25


def test_the_first_image_is_read_whatever_comes_before_it(tmp_path: Path) -> None:
    extension = "XTENSION= 'IMAGE   '"
    table = fits(STACK[0].astype("u1"), "XTENSION= 'BINTABLE'", PCOUNT=3, GCOUNT=1)
    image = fits(STACK[1].astype("i4"), extension, PCOUNT=0, GCOUNT=1)
    (tmp_path / "a.fit").write_bytes(fits(None) + table + image)
    np.testing.assert_array_equal(open_image(tmp_path / "a.fit").read(), STACK[1])


def test_blank_samples_are_nan(tmp_path: Path) -> None:
    values = STACK[0].astype("i2")
    (tmp_path / "a.fits").write_bytes(fits(values, BLANK=int(values[1, 2])))
    found = open_image(tmp_path / "a.fits").read()
    np.testing.assert_array_equal(np.isnan(found), values == values[1, 2])


def test_damaged_files_give_one_line(tmp_path: Path) -> None:
    whole = fits(STACK.astype("i4"))
    bad: dict[bytes, tuple[type[Exception], str]] = {
        whole[:3200]: (FileFormatError, "the file is cut short"),
        whole[:1000]: (FileFormatError, "a header that ends with END"),
        fits(None): (FileFormatError, "got no data; export it uncompressed"),
        fits(None) + fits(STACK[0].astype("u1"), "XTENSION= 'BINTABLE'", ZIMAGE="T", PCOUNT=0): (
            FileFormatError,
            "got no data, a compressed table; export it uncompressed",
        ),
        fits(None, NAXIS=10**9): (FileFormatError, "got 999 axes; export it"),
        fits(None, NAXIS=1, NAXIS1=5, BITPIX="1E300"): (FileFormatError, "an image with 2, 3 or 5 axes"),
        fits(None) + fits(STACK[0].astype("u1"), "XTENSION= 'BINTABLE'", PCOUNT=-(10**9)): (
            FileFormatError,
            "got no data, a table",
        ),
        fits(None, NAXIS=2, NAXIS1=60_000, NAXIS2=60_000, BITPIX=64): (UnsafeFileError, "declared in a file of"),
    }
    for data, (error, words) in bad.items():
        (tmp_path / "a.fits").write_bytes(data)
        with pytest.raises(error, match=words) as caught:
            open_image(tmp_path / "a.fits")
        assert "\n" not in str(caught.value)
