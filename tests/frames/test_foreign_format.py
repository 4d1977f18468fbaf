"""The format shown in the documentation is complete: found by entry point, and read by everything that reads frames."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.registry import Registry
from lfcal.frames.formats import image_file
from tests.distribution import code_of, in_a_new_process, install


def flat(path: Path, frames: np.ndarray) -> Path:
    path.write_bytes(b"FLAT" + struct.pack("<3I", *frames.shape) + frames.astype("<u2").tobytes())
    return path


@pytest.fixture
def frames() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 4095, (3, 20, 30)).astype(np.uint16)


def test_the_documented_format_reads_frames(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, frames: np.ndarray
) -> None:
    (block,) = code_of("extending.md", "A frame format")
    install(monkeypatch, tmp_path, "lab_formats", block, {"lfcal.formats": "flat = lab_formats:FORMAT"})
    fresh: Registry = Registry(
        "image format", "lfcal.frames.formats", "FORMAT", "lfcal.formats", order=lambda f: (f.rank, f.name)
    )
    monkeypatch.setattr(image_file, "FORMATS", fresh)
    assert "camera dump" in fresh and not fresh.failures()
    assert ".flat" in image_file.image_suffixes()
    path = flat(tmp_path / "run.flat", frames)
    image = image_file.open_image(path)
    assert (image.pages, image.shape, image.dtype) == (3, (20, 30), np.dtype(np.uint16))
    np.testing.assert_array_equal(image.read_region(1, slice(3, 9), slice(5, 7)), frames[1, 3:9, 5:7])
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    with pytest.raises(Exception, match=r"run\.flat") as caught:
        image_file.read_image(path, 2)
    assert "\n" not in str(caught.value)


def test_open_frames_finds_it_in_an_installed_package(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, frames: np.ndarray
) -> None:
    (block,) = code_of("extending.md", "A frame format")
    install(monkeypatch, tmp_path, "lab_formats", block, {"lfcal.formats": "flat = lab_formats:FORMAT"})
    path = flat(tmp_path / "run.flat", frames)
    code = (
        "from lfcal.frames import open_frames\n"
        f"with open_frames({str(path)!r}, order='raster', plan_shape=(1, 1, 3)) as source:\n"
        "    print(len(source), source.metadata.bit_depth, source.samples(2).saturated, source.read(2).sum())"
    )
    assert in_a_new_process(tmp_path, code).split() == ["3", "12", "0", str(frames[2].sum())]
