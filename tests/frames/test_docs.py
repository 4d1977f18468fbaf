"""The examples of the documents on frames and H files run as they stand."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.frames.corrections.recipe import read_average
from lfcal.psf import PSFMatrix, save_regions
from lfcal.simulate import sample_session
from tests.distribution import code_of


def test_frames_as_documented(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = sample_session()
    for name in ("frames", "dark"):
        shutil.copytree(session / name, tmp_path / name)
    for path in (tmp_path / "frames").glob("z*.png"):  # names as the example has them
        z, y, x = (int(part[1:]) for part in path.stem.split("_"))
        path.rename(path.with_name(f"z{z}_y{y}_x{x}.png"))
    shutil.copy(session / "plan.json", tmp_path)
    tifffile.imwrite(tmp_path / "white.tif", np.rint(read_average(session / "white")).astype(np.uint16))
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    (block,) = code_of("files.md", "Open frames")
    exec(block, names)
    report = names["report"]
    with report.matrix as H:  # type: ignore[attr-defined]
        assert H.shape == (2, 19, 33, 55, 55) and report.frames == 1254  # type: ignore[attr-defined]
        assert H.provenance["corrections"]["steps"][1]["kind"] == "white"


def test_h_files_as_documented(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(0).random((1, 19, 33, 5, 5)).astype(np.float32)
    save_regions({"centre": PSFMatrix(values), "corner": PSFMatrix(values)}, tmp_path / "H.h5")
    monkeypatch.chdir(tmp_path)
    (by_h5py,) = code_of("matlab.md", "Read an H file in Python without lfcal")
    (block,) = code_of("files.md", "H in Python")
    read: dict[str, object] = {}
    exec(by_h5py, read)
    np.testing.assert_array_equal(read["H"], values[0, 9, 16])
    names: dict[str, object] = {}
    exec(block.replace("H.facts.spread", "H.facts.spread, open_psf('H.h5', region='corner')"), names)
