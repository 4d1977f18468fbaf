"""Every option of ``lfcal reconstruct`` reaches the solver or the projector: the volume is the library's own."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import Projector, SolverChoice, load_volume, reconstruct
from lfcal.reconstruct._frame_units import device_for, device_hints
from lfcal.reconstruct.projectors import device as devices
from lfcal.work.unit import numbered
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


def test_the_command_and_the_library_do_as_many_iterations_where_none_are_asked_for() -> None:
    from lfcal.tasks import Reconstruct

    asked = Reconstruct(psf="H.h5", frames="f.tif", out="v.tif").solver
    assert (asked.name, asked.iterations) == (SolverChoice().name, SolverChoice().iterations)


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
    "goal": (
        ("--solver", "sieve", "--iterations", "auto", "--goal", "measure"),
        {},
        {"name": "sieve", "iterations": 100, "auto": True, "goal": "measure"},
    ),
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


@pytest.mark.parametrize("run", [(), ("--executor", "threads")])
def test_chi2_per_pixel_is_stated_where_the_noise_is_known(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path, run: tuple[object, ...]
) -> None:
    """By ``--gain``, else by the noise that H keeps of the frames it was made from."""
    told = tmp_path / "told.h5"
    noise = {"floor": 0.0, "slope": 1.0, "from": "darks and repeats"}
    H = lenslet_psf(2, 5, 15).astype(np.float32)
    save(PSFMatrix(H, depths=(-5.0, 5.0), provenance={"noise": noise}), told)
    options = ("--solver", "rl", "--iterations", 40, "--margin", 0, "--background", 5, "--force", "--json", *run)
    found = {}
    for name, psf, more in (("none", folder / "H.h5", ()), ("gain", folder / "H.h5", ("--gain", 1)), ("H", told, ())):
        out = tmp_path / f"{name}.h5"
        done = lfcal("reconstruct", psf, folder / "frame.png", "--out", out, *options, *more)
        assert done.code == 0, done.err
        found[name] = done.json["volumes"][0]["chi2"]  # type: ignore[index, call-overload]
        with h5py.File(out) as file:
            assert json.loads(file.attrs["details"]).get("chi2") == found[name]
    assert found["none"] is None and 0.5 < found["H"] < 1.2
    assert found["gain"] == pytest.approx(found["H"], rel=1e-5)


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


def test_device(lfcal: Callable[..., Run], folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a device the same volume is found, the file says by what, and the forecast tells the memory there."""
    files = (folder / "H.h5", folder / "frame.png", "--solver", "rl", "--margin", 0, "--iterations", 3)
    words = ("reconstruct", *files)
    done = lfcal(*words, "--out", tmp_path / "cpu.h5", "--device", "cpu")
    assert done.code == 0 and "; device" not in done.err
    monkeypatch.setattr(devices, "device_count", lambda library: 0)
    done = lfcal(*words, "--out", tmp_path / "none.h5", "--device", "cuda")
    assert done.code == 2 and "PyTorch or CuPy" in done.err and len(done.err.strip().splitlines()) == 1
    assert not (tmp_path / "none.h5").exists()
    # the processor's memory stands in for that of an accelerator
    monkeypatch.setattr(
        "lfcal.reconstruct.projectors._device_forecast.find_device", lambda text: devices.ArrayDevice("numpy")
    )
    done = lfcal(*words, "--out", tmp_path / "there.h5", "--device", "cuda")
    assert done.code == 0, done.err
    volumes = [load_volume(tmp_path / name) for name in ("cpu.h5", "there.h5")]
    np.testing.assert_allclose(volumes[1], volumes[0], rtol=1e-4, atol=1e-4 * volumes[0].max())
    with h5py.File(tmp_path / "there.h5") as file:
        assert json.loads(str(file.attrs["details"]))["device"] == "cpu (numpy)"
    done = lfcal(*words, "--forecast", "--device", "cuda")
    assert done.code == 0 and "cpu (numpy): device " in done.out
    done = lfcal(*words, "--forecast", "--device", "cuda", "--json")
    assert done.json["device"]["kept"] is True  # type: ignore[index, call-overload]


def test_frames_of_a_series_on_the_device_of_their_worker(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def find(text: str, *, worker: int = 0) -> devices.ArrayDevice:
        asked.append((text, worker))
        return devices.ArrayDevice("numpy")

    monkeypatch.setattr("lfcal.reconstruct._frame_units.find_device", find)
    monkeypatch.setattr("lfcal.reconstruct.projectors._device_forecast.find_device", find)
    (tmp_path / "frames").mkdir()
    for name in ("a", "b"):
        shutil.copy(folder / "frame.png", tmp_path / "frames" / f"{name}.png")
    done = lfcal(
        "reconstruct", folder / "H.h5", tmp_path / "frames", "--out", tmp_path / "v", "--format", ".npy",
        "--solver", "rl", "--iterations", 2, "--executor", "threads", "--device", "auto",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert asked == [("auto", 0), ("cuda", 0), ("cuda", 0)]
    with numbered(3):
        assert device_for("cuda", 1000) == devices.ArrayDevice("numpy", room=1000)
    assert asked[-1] == ("cuda", 3)
    two = device_hints(devices.ArrayDevice("numpy", room=900), "cuda:1", 3)
    assert two == {"device": "cuda:1", "device_room": 300} and device_hints(None, "auto", 3) == {}


def test_left_alone_it_stops_by_itself_and_says_why(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    words = ("reconstruct", folder / "H.h5", folder / "frame.png", "--iterations", "auto")
    done = lfcal(*words, "--out", tmp_path / "v.h5")
    assert done.code == 0 and "held-out pixels" in done.out
    with h5py.File(tmp_path / "v.h5") as file:
        known = json.loads(str(file.attrs["details"]))
        assert file["volume"].shape == (2, *SHAPE)
    assert "held-out pixels" in known["stopped"] and known["solver"]["name"] == "sieve" and known["solver"]["auto"]
    assert known["solver"]["margin"] == 3 and known["anchor"] == [0, 0]
    done = lfcal(*words, "--forecast")
    assert "stops automatically" in done.out and "margin of 3 pixels" in done.out


def test_it_stops_by_the_noise_that_it_is_told(lfcal: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    words = ("reconstruct", folder / "H.h5", folder / "frame.png", "--iterations", "auto:discrepancy")
    counts = []
    for gain in (10, 1000):
        done = lfcal(*words, "--gain", gain, "--out", tmp_path / "v.h5", "--force", "--json")
        assert done.code == 0, done.err
        (one,) = done.json["volumes"]  # type: ignore[index, call-overload]
        counts.append(one["iterations"])
    assert "the residual reached the noise level" in one["stopped"]
    assert counts[1] < counts[0]
    with h5py.File(tmp_path / "v.h5") as file:
        known = json.loads(str(file.attrs["details"]))
    assert known["solver"]["stop"] == "discrepancy" and known["solver"]["gain"] == 1000


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--gain", 0), "--gain: expected a number > 0"),
        (("--iterations", "auto:luck"), "auto or auto:discrepancy"),
        (("--solver", "rl", "--subsets", 2), "osem"),
        (("--threshold", 2), "threshold"),
        (("--method", "magic"), "polyphase"),
        (("--iterations", 0), "iterations"),
        (("--iterations", "many"), "a whole number ≥ 1, or auto"),
        (("--margin", -1), "--margin"),
        (("--margin", "wide"), "a whole number ≥ 0, or auto"),
        (("--tolerance", -1), "tolerance"),
        (("--workers", 0), "--workers"),
        (("--device", "gpu"), "auto, cpu, cuda or cuda:NUMBER"),
        (("--anchor", "nan,1"), "--anchor: expected ROW,COLUMN"),
        (("--anchor", "1,inf"), "--anchor: expected ROW,COLUMN"),
        (("--anchor", "1,1e30"), "anchor (pixels): expected a number"),
        (("--memory", "nan"), "--memory: expected a number > 0"),
        (("--memory", "inf"), "--memory: expected a number > 0"),
        (("--memory", -1), "--memory: expected a number > 0"),
        (("--background", 1e308), "--background: expected a number"),
        (("--read-noise", "nan"), "--read-noise: expected a number"),
        (("--read-noise", 1e308), "--read-noise: expected a number"),
        (("--saturation", 0), "--saturation: expected a number > 0"),
        (("--saturation", "nan"), "--saturation: expected a number > 0"),
        (("--tolerance", "inf"), "--tolerance: expected a number"),
        (("--solver", "rl-tv", "--strength", "nan"), "--strength: expected a number"),
        (("--solver", "phase-space", "--subsets", -1), "--subsets: expected a whole number ≥ 1"),
        (("--iterations", "auto:discrepancy", "--gain", 1e308), "--gain: expected a number"),
    ],
)
def test_values_that_make_no_sense_are_refused(
    lfcal: Callable[..., Run], folder: Path, tmp_path: Path, options: tuple[object, ...], words: str
) -> None:
    done = lfcal("reconstruct", folder / "H.h5", folder / "frame.png", "--out", tmp_path / "v.npy", *options)
    assert done.code == 2 and words in done.err and len(done.err.splitlines()) == 1
    assert not (tmp_path / "v.npy").exists()


@pytest.fixture
def one_bad(folder: Path, tmp_path: Path) -> Path:
    """Write a good frame, one without light, one of NaN, one that is damaged, and a good one."""
    place = tmp_path / "frames"
    place.mkdir()
    good = cv2.imread(str(folder / "frame.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)
    for name, frame in {"0": good, "1": 0 * good, "2": np.nan * good, "4": good}.items():
        np.save(place / f"{name}.npy", frame)
    tifffile.imwrite(place / "3.tif", good, compression="zlib")
    with tifffile.TiffFile(place / "3.tif") as file:
        at = file.pages[0].dataoffsets[0]
    spoilt = bytearray((place / "3.tif").read_bytes())
    spoilt[at : at + 40] = bytes(40)
    (place / "3.tif").write_bytes(spoilt)
    return place


@pytest.mark.parametrize("more", [(), ("--executor", "threads"), ("--warm",), ("--warm", "--executor", "threads")])
def test_one_bad_frame_does_not_end_the_others(
    lfcal: Callable[..., Run], folder: Path, one_bad: Path, tmp_path: Path, more: tuple[str, ...]
) -> None:
    words = ("reconstruct", folder / "H.h5", one_bad, "--solver", "rl", "-n", 2, *more)
    done = lfcal(*words, "--out", tmp_path / "each")
    assert done.code == 1 and done.out.count("residual") == 2
    assert sorted(path.name for path in (tmp_path / "each").iterdir()) == ["0.tif", "4.tif"]
    assert "1: no volume; image: expected light, got no pixel above 0; check the light" in done.err
    assert "2: no volume; image: expected pixels to fit, got none; 930 non-finite pixels were left out" in done.err
    assert "3: no volume; " in done.err and "expected an intact TIFF file" in done.err
    told: Any = lfcal(*words, "--out", tmp_path / "all.npy", "--json").json
    assert [bool(one["failed"]) for one in told["volumes"]] == [False, True, True, True, False]
    volumes = np.load(tmp_path / "all.npy")
    assert [bool(np.isnan(volume).all()) for volume in volumes] == [False, True, True, True, False]
    np.testing.assert_array_equal(volumes[4], load_volume(tmp_path / "each" / "4.tif"))
    assert (np.abs(volumes[4] - volumes[0]).max() > 0) == ("--warm" in more), "it begins where the last volume ended"


@pytest.mark.parametrize("more", [(), ("--executor", "threads")])
def test_frames_that_tell_nothing_are_refused(
    lfcal: Callable[..., Run], folder: Path, one_bad: Path, tmp_path: Path, more: tuple[str, ...]
) -> None:
    words = ("reconstruct", folder / "H.h5", "--out", tmp_path / "v.npy", "--solver", "rl", "-n", 2, *more)
    alone = lfcal(*words, one_bad / "1.npy")
    assert alone.code == 2 and alone.err.endswith(
        "expected light, got no pixel above 0; check the light and the background\n"
    )
    assert not list(tmp_path.glob("v.npy*"))
    for name in ("0.npy", "3.tif", "4.npy"):
        (one_bad / name).unlink()
    none = lfcal(*words, one_bad)
    assert none.code == 2 and "none of the 2 frames was reconstructed" in none.err and "kept" not in none.err
    assert not list(tmp_path.glob("v.npy*"))
