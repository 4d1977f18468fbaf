"""Every option of ``lfcal reconstruct`` reaches the solver or the projector: the volume is the library's own."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import Projector, SolverChoice, reconstruct
from tests.cli.conftest import Run
from tests.reconstruct.oracles import lenslet_psf

SHAPE = (30, 31)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write H and a noisy frame of two points."""
    place = tmp_path_factory.mktemp("light_field")
    H = lenslet_psf(2, 5, 15).astype(np.float32)
    save(PSFMatrix(H, depths=(-5.0, 5.0)), place / "H.h5")
    P = Projector(H, SHAPE)
    truth = np.zeros(P.volume_shape)
    truth[0, 12, 15] = truth[1, 20, 9] = 4000
    frame = np.random.default_rng(0).poisson(np.maximum(P.forward(truth), 0) + 5)
    cv2.imwrite(str(place / "frame.png"), frame.astype(np.uint16))
    return place


def by_the_library(folder: Path, projector: dict[str, Any], choice: dict[str, Any]) -> np.ndarray:
    """Return the volume that the library gives for the same settings."""
    from lfcal.psf import open_psf

    frame = cv2.imread(str(folder / "frame.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)
    with open_psf(folder / "H.h5") as H:
        P = Projector(H, **{"image_shape": SHAPE, **projector})
        return np.asarray(
            reconstruct(P, frame, SolverChoice(**{"name": "rl", "iterations": 3, **choice})).volume, np.float32
        )


CASES: dict[str, tuple[tuple[object, ...], dict[str, Any], dict[str, Any]]] = {
    "iterations": (("--iterations", 6), {}, {"iterations": 6}),
    "background": (("--background", 5), {}, {"background": 5.0}),
    "read noise": (("--read-noise", 9), {}, {"read_noise": 9.0}),
    "saturation": (("--saturation", 60), {}, {"saturation": 60.0}),
    "subsets": (("--solver", "osem", "--subsets", 2), {}, {"name": "osem", "subsets": 2}),
    "strength": (("--solver", "rl-tv", "--strength", 0.05), {}, {"name": "rl-tv", "strength": 0.05}),
    "tolerance": (("--iterations", 50, "--tolerance", 0.2), {}, {"iterations": 50, "tolerance": 0.2}),
    "threshold": (("--threshold", 0.2), {"threshold": 0.2}, {}),
    "within": (("--within", 0.3, "--method", "reduced"), {"tolerance": 0.3, "method": "reduced"}, {}),
    "anchor": (("--anchor", "2,3"), {"anchor": (2, 3)}, {}),
    "margin": (("--margin", 4), {"image_shape": (38, 39), "anchor": (4, 4)}, {"margin": 4}),
    "auto": (("--solver", "sieve", "--iterations", "auto"), {}, {"name": "sieve", "iterations": 100, "auto": True}),
}


@pytest.mark.few(4)
@pytest.mark.parametrize("case", CASES)
def test_the_volume_is_that_of_the_library(lfcal: Callable[..., Run], folder: Path, tmp_path: Path, case: str) -> None:
    options, projector, choice = CASES[case]
    first = () if "iterations" in choice else ("--iterations", 3)
    first += () if "name" in choice else ("--solver", "rl")
    first += () if "margin" in choice else ("--margin", 0)
    done = lfcal("reconstruct", folder / "H.h5", folder / "frame.png", "--out", tmp_path / "v.npy", *first, *options)
    assert done.code == 0, done.err
    volume, plain = np.load(tmp_path / "v.npy"), by_the_library(folder, {}, {})
    np.testing.assert_allclose(volume, by_the_library(folder, projector, choice), rtol=1e-4, atol=1e-4 * volume.max())
    assert np.abs(volume - plain).max() > 1e-3 * plain.max(), "the option has an effect"


def test_method_workers_and_precision(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    """They change how the volume is computed, not what it is."""
    volumes = {}
    for name, options in {"single": (), "double": ("--double",), "slow": ("--method", "fft", "--workers", 1)}.items():
        files = (folder / "H.h5", folder / "frame.png", "--out", tmp_path / f"{name}.npy")
        done = lfcal("reconstruct", *files, "--solver", "rl", "--margin", 0, "--iterations", 3, "--json", *options)
        assert done.code == 0, done.err
        assert (done.json["method"] == "fft") == (name == "slow")  # type: ignore[index, call-overload]
        volumes[name] = np.load(tmp_path / f"{name}.npy")
    exact = by_the_library(folder, {"dtype": np.float64}, {})
    errors = {name: np.abs(volume - exact).max() / exact.max() for name, volume in volumes.items()}
    assert errors["double"] < 1e-7 < errors["single"] < 1e-4 and errors["slow"] < 1e-4


def test_left_alone_it_stops_by_itself_and_says_why(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    words = ("reconstruct", folder / "H.h5", folder / "frame.png", "--iterations", "auto")
    done = lfcal(*words, "--out", tmp_path / "v.h5")
    assert done.code == 0 and "left-out pixels" in done.out
    with h5py.File(tmp_path / "v.h5") as file:
        known = json.loads(str(file.attrs["details"]))
        assert file["volume"].shape == (2, *SHAPE)
    assert "left-out pixels" in known["stopped"] and known["solver"]["name"] == "sieve" and known["solver"]["auto"]
    assert known["solver"]["margin"] == 3 and known["anchor"] == [0, 0]
    done = lfcal(*words, "--forecast")
    assert "stops by itself" in done.out and "margin of 3 pixels" in done.out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--solver", "rl", "--subsets", 2), "osem"),
        (("--threshold", 2), "threshold"),
        (("--method", "magic"), "polyphase"),
        (("--iterations", 0), "iterations"),
        (("--iterations", "many"), "a number, or auto"),
        (("--margin", -1), "--margin"),
        (("--margin", "wide"), "a number of pixels, or auto"),
        (("--tolerance", -1), "tolerance"),
        (("--workers", 0), "--workers"),
    ],
)
def test_values_that_make_no_sense_are_refused(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path, options: tuple[object, ...], words: str
) -> None:
    done = lfcal("reconstruct", folder / "H.h5", folder / "frame.png", "--out", tmp_path / "v.npy", *options)
    assert done.code == 2 and words in done.err
    assert not (tmp_path / "v.npy").exists()
