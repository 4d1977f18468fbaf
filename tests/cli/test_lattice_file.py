from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError
from lfcal.lattice import LatticeFit, fit_lattice, load_lattice, save_lattice
from lfcal.psf import PSFMatrix, save
from tests.cli.conftest import Run
from tests.lattice.white_frames import barrel, draw_white

SHAPE = (300, 360)


@pytest.fixture(scope="module")
def fit() -> LatticeFit:
    return fit_lattice(draw_white(SHAPE, 12.3, bend=barrel(2.0, math.hypot(*SHAPE) / 2)).frame)


def test_a_lattice_comes_back(fit: LatticeFit, tmp_path: Path) -> None:
    save_lattice(fit, tmp_path)
    again = load_lattice(tmp_path / "lattice.json")
    assert fit.distortion is not None and again.distortion == fit.distortion
    assert (again.kind, again.shape, again.form, again.reason) == (fit.kind, fit.shape, fit.form, fit.reason)
    q, r = fit.index.T
    np.testing.assert_allclose(again.centres_px(q, r), fit.centres_px(q, r), atol=1e-9)
    np.testing.assert_array_equal(again.index, fit.index)
    assert again.dead_lenslets == fit.dead_lenslets != []
    save_lattice(replace(fit, distortion=None), tmp_path)
    assert load_lattice(tmp_path / "lattice.json").distortion is None


@pytest.mark.few(2)
@pytest.mark.parametrize(
    "change",
    [
        {"format": "lfcal-camera"},
        {"version": 2},
        {"kind": "round"},
        {"shape": [300]},
        {"shape": [3e9, 10]},
        {"pitch_px": 0.001},
        {"pitch_px": "12"},
        {"origin_px": None},
        {"dead": [[1, 2, 3]]},
        {"dead": {"a": 1}},
        {"distortion": [1]},
        {"distortion": {"model": "radial"}},
        {"distortion": {"model": "radial", "centre_px": [0, 0], "scale_px": 1.0, "terms_px": [["a"]]}},
    ],
    ids=str,
)
def test_what_is_no_lattice_is_refused_in_one_line(fit: LatticeFit, tmp_path: Path, change: dict[str, Any]) -> None:
    save_lattice(fit, tmp_path)
    path = tmp_path / "lattice.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(FileFormatError) as caught:
        load_lattice(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_other_files_are_refused(tmp_path: Path) -> None:
    for text in ("[]", "{", '{"format": "lfcal-lattice", "version": 1}', "\x00"):
        (tmp_path / "x.json").write_text(text)
        with pytest.raises(FileFormatError):
            load_lattice(tmp_path / "x.json")


@pytest.mark.long
def test_a_light_field_is_resampled_by_a_lattice_measured_before(
    lfcal: Callable[..., Run], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    white = draw_white((150, 160), 12.3, kind="square").frame
    tifffile.imwrite("white.tif", white)
    save_lattice(fit_lattice(white), tmp_path)
    save(PSFMatrix(np.random.default_rng(0).random((1, 12, 12, 9, 9)).astype(np.float32)), "H.h5")
    words = ("reconstruct", "H.h5", "white.tif", "-n", "2", "-o")
    for out, own in (
        ("a.npy", ("--white", "white.tif")),
        ("b.npy", ("--white", "white.tif", "--lattice", "lattice.json")),
    ):
        done = lfcal(*words, out, "--resample", "always", *own)
        assert done.code == 0, done.err
    np.testing.assert_allclose(np.load("b.npy"), np.load("a.npy"), rtol=1e-3)
    # a lattice that is given is there to resample by
    assert lfcal(*words, "c.npy", "--white", "white.tif", "--lattice", "lattice.json").code == 0
    np.testing.assert_array_equal(np.load("c.npy"), np.load("b.npy"))
    done = lfcal(*words, "d.npy", "--lattice", "lattice.json", "--resample", "never")
    assert done.code == 2 and "resample: expected auto or always" in done.err
