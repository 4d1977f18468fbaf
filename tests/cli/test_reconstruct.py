"""``lfcal reconstruct``: options, regions, sessions, and the period of H."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session import record
from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor, preset
from lfcal.lattice import fit_lattice, save_lattice
from lfcal.psf import PSFMatrix, open_psf, save, save_regions, voxel_um
from lfcal.reconstruct import FieldProjector, LightFieldSettings, Projector, SolverChoice, load_volume, reconstruct
from lfcal.reconstruct._frame_units import device_for, device_hints
from lfcal.reconstruct.projectors import device as devices
from lfcal.reconstruct.resample import resampling_for, resampling_of
from lfcal.reconstruct.volumes import volume_facts
from lfcal.tasks import Reconstruct
from lfcal.work.unit import numbered
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.cli.conftest import Lfcal
from tests.lattice.white_frames import WhiteFrame, draw_white
from tests.reconstruct.oracles import lenslet_psf

# -- Every option of ``lfcal reconstruct`` reaches the solver or the projector: the volume is the library's own --
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
    frame = cv2.imread(str(folder / "frame.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)
    with open_psf(folder / "H.h5") as H:
        P = Projector(H, **{"image_shape": SHAPE, **projector})
        result = reconstruct(P, frame, SolverChoice(**{"name": "rl", "iterations": 3, **choice}))
    return np.asarray(result.volume, np.float32)


def test_command_and_library_have_the_same_default_iterations() -> None:
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
def test_the_volume_is_that_of_the_library(lfcal: Lfcal, folder: Path, tmp_path: Path, case: str) -> None:
    options, projector, choice = CASES[case]
    first = () if "iterations" in choice else ("--iterations", 3)
    first += () if "name" in choice else ("--solver", "rl")
    first += () if "margin" in choice else ("--margin", 0)
    lfcal("reconstruct", folder / "H.h5", folder / "frame.png", "--out", tmp_path / "v.npy", *first, *options).ok()
    volume, plain = np.load(tmp_path / "v.npy"), by_the_library(folder, {}, {})
    np.testing.assert_allclose(volume, by_the_library(folder, projector, choice), rtol=1e-4, atol=1e-4 * volume.max())
    assert np.abs(volume - plain).max() > 1e-3 * plain.max(), "the option has an effect"


@pytest.mark.parametrize("run", [(), pytest.param(("--executor", "threads"), marks=pytest.mark.long)])
def test_chi2_per_pixel_is_stated_where_the_noise_is_known(
    lfcal: Lfcal, folder: Path, tmp_path: Path, run: tuple[str, ...]
) -> None:
    """By ``--gain``, else by the noise that H keeps of the frames it was made from."""
    told = tmp_path / "told.h5"
    noise = {"floor": 0.0, "slope": 1.0, "from": "darks and repeats"}
    H = lenslet_psf(2, 5, 15).astype(np.float32)
    save(PSFMatrix(H, depths=(-5.0, 5.0), provenance={"noise": noise}), told)
    options = ("--solver", "rl", "--iterations", 40, "--margin", 0, "--background", 5, "--force", "--json")
    found = {}
    for name, psf, more in (
        ("none", folder / "H.h5", ()),
        ("gain", folder / "H.h5", ("--gain", 1)),
        ("H", told, ()),
    ):
        out = tmp_path / f"{name}.h5"
        done = lfcal("reconstruct", psf, folder / "frame.png", "--out", out, *options, *more, *run).ok()
        found[name] = done.json["volumes"][0]["chi2"]
        with h5py.File(out) as file:
            assert json.loads(file.attrs["details"]).get("chi2") == found[name]
    assert found["none"] is None and 0.5 < found["H"] < 1.2 and found["gain"] == pytest.approx(found["H"], rel=1e-5)


def test_method_workers_and_precision(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    """They change how the volume is computed, not what it is."""
    volumes = {}
    for name, options in {"single": (), "double": ("--double",), "slow": ("--method", "fft", "--workers", 1)}.items():
        files = (folder / "H.h5", folder / "frame.png", "--out", tmp_path / f"{name}.npy")
        done = lfcal("reconstruct", *files, "--solver", "rl", "--margin", 0, "--iterations", 3, "--json", *options).ok()
        assert (done.json["method"] == "fft") == (name == "slow")
        volumes[name] = np.load(tmp_path / f"{name}.npy")
    exact = by_the_library(folder, {"dtype": np.float64}, {})
    errors = {name: np.abs(volume - exact).max() / exact.max() for name, volume in volumes.items()}
    assert errors["double"] < 1e-7 < errors["single"] < 1e-4 and errors["slow"] < 1e-4


def test_device(lfcal: Lfcal, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a device the same volume is found, the file names the device, and the forecast states the memory there."""
    words = ("reconstruct", folder / "H.h5", folder / "frame.png", "--solver", "rl", "--margin", 0, "--iterations", 3)
    assert "; device" not in lfcal(*words, "--out", tmp_path / "cpu.h5", "--device", "cpu").ok().err
    monkeypatch.setattr(devices, "device_count", lambda library: 0)
    lfcal(*words, "--out", tmp_path / "none.h5", "--device", "cuda").refused("PyTorch or CuPy")
    assert not (tmp_path / "none.h5").exists()
    # the memory of the processor represents that of an accelerator
    found = "lfcal.reconstruct.projectors._device_forecast.find_device"
    monkeypatch.setattr(found, lambda text: devices.ArrayDevice("numpy"))
    lfcal(*words, "--out", tmp_path / "there.h5", "--device", "cuda").ok()
    volumes = [load_volume(tmp_path / name) for name in ("cpu.h5", "there.h5")]
    np.testing.assert_allclose(volumes[1], volumes[0], rtol=1e-4, atol=1e-4 * volumes[0].max())
    with h5py.File(tmp_path / "there.h5") as file:
        assert json.loads(str(file.attrs["details"]))["device"] == "cpu (numpy)"
    assert "cpu (numpy): device " in lfcal(*words, "--forecast", "--device", "cuda").ok().out
    assert lfcal(*words, "--forecast", "--device", "cuda", "--json").json["device"]["kept"] is True


def test_frames_of_a_series_on_the_device_of_their_worker(
    lfcal: Lfcal, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
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
    lfcal(
        *("reconstruct", folder / "H.h5", tmp_path / "frames", "--out", tmp_path / "v", "--format", ".npy"),
        *("--solver", "rl", "--iterations", 2, "--executor", "threads", "--device", "auto"),
    ).ok()
    assert asked == [("auto", 0), ("cuda", 0), ("cuda", 0)]
    with numbered(3):
        assert device_for("cuda", 1000) == devices.ArrayDevice("numpy", room=1000)
    assert asked[-1] == ("cuda", 3)
    two = device_hints(devices.ArrayDevice("numpy", room=900), "cuda:1", 3)
    assert two == {"device": "cuda:1", "device_room": 300} and device_hints(None, "auto", 3) == {}


def test_an_automatic_stop_names_its_reason(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "v.h5"
    words = ("reconstruct", folder / "H.h5", folder / "frame.png", "--iterations")
    assert "held-out pixels" in lfcal(*words, "auto", "--out", out).ok().out
    with h5py.File(out) as file:
        known = json.loads(str(file.attrs["details"]))
        assert file["volume"].shape == (2, *SHAPE)
    assert "held-out pixels" in known["stopped"] and known["solver"]["name"] == "sieve" and known["solver"]["auto"]
    assert known["solver"]["margin"] == 3 and known["anchor"] == [0, 0]
    done = lfcal(*words, "auto", "--forecast")
    assert "stops automatically" in done.out and "margin of 3 pixels" in done.out
    counts = []
    for gain in (10, 1000):
        (one,) = (
            lfcal(*words, "auto:discrepancy", "--gain", gain, "--out", out, "--force", "--json").ok().json["volumes"]
        )
        counts.append(one["iterations"])
    assert "the residual reached the noise level" in one["stopped"] and counts[1] < counts[0]
    with h5py.File(out) as file:
        known = json.loads(str(file.attrs["details"]))
    assert known["solver"]["stop"] == "discrepancy" and known["solver"]["gain"] == 1000


def test_values_that_make_no_sense_are_refused(lfcal: Lfcal, folder: Path, tmp_path: Path) -> None:
    for options, said in (
        ("--gain 0", "--gain: expected a number > 0"),
        ("--iterations auto:luck", "auto or auto:discrepancy"),
        ("--solver rl --subsets 2", "osem"),
        ("--threshold 2", "threshold"),
        ("--method magic", "polyphase"),
        ("--iterations 0", "iterations"),
        ("--iterations many", "a whole number ≥ 1, or auto"),
        ("--margin -1", "--margin"),
        ("--margin wide", "a whole number ≥ 0, or auto"),
        ("--tolerance -1", "tolerance"),
        ("--workers 0", "--workers"),
        ("--device gpu", "auto, cpu, cuda or cuda:NUMBER"),
        ("--anchor nan,1", "--anchor: expected ROW,COLUMN"),
        ("--anchor 1,inf", "--anchor: expected ROW,COLUMN"),
        ("--anchor 1,1e30", "anchor (pixels): expected a number"),
        *((f"--memory {value}", "--memory: expected a number > 0") for value in ("nan", "inf", "-1")),
        ("--background 1e308", "--background: expected a number"),
        ("--read-noise nan", "--read-noise: expected a number"),
        ("--read-noise 1e308", "--read-noise: expected a number"),
        ("--saturation 0", "--saturation: expected a number > 0"),
        ("--saturation nan", "--saturation: expected a number > 0"),
        ("--tolerance inf", "--tolerance: expected a number"),
        ("--solver rl-tv --strength nan", "--strength: expected a number"),
        ("--solver phase-space --subsets -1", "--subsets: expected a whole number ≥ 1"),
        ("--iterations auto:discrepancy --gain 1e308", "--gain: expected a number"),
    ):
        words = (folder / "H.h5", folder / "frame.png", "--out", tmp_path / "v.npy", *options.split())
        lfcal("reconstruct", *words).refused(said)
        assert not (tmp_path / "v.npy").exists(), options


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


@pytest.mark.parametrize(
    "more",
    [
        ("--warm",),
        *(pytest.param(more, marks=pytest.mark.long) for more in ((), ("--warm", "--executor", "threads"))),
        ("--executor", "threads"),
    ],
)
def test_one_bad_frame_does_not_end_the_others(
    lfcal: Lfcal, folder: Path, one_bad: Path, tmp_path: Path, more: tuple[str, ...]
) -> None:
    words = ("reconstruct", folder / "H.h5", one_bad, "--solver", "rl", "-n", 2, *more)
    done = lfcal(*words, "--out", tmp_path / "each")
    assert done.code == 1 and done.out.count("residual") == 2
    assert sorted(path.name for path in (tmp_path / "each").iterdir()) == ["0.tif", "4.tif"]
    assert "1: no volume; image: expected light, got no pixel above 0; check the light" in done.err
    assert "2: no volume; image: expected pixels to fit, got none; 930 non-finite pixels were left out" in done.err
    assert "3: no volume; " in done.err and "expected an intact TIFF file" in done.err
    told = lfcal(*words, "--out", tmp_path / "all.npy", "--json").json
    assert [bool(one["failed"]) for one in told["volumes"]] == [False, True, True, True, False]
    volumes = np.load(tmp_path / "all.npy")
    assert [bool(np.isnan(volume).all()) for volume in volumes] == [False, True, True, True, False]
    np.testing.assert_array_equal(volumes[4], load_volume(tmp_path / "each" / "4.tif"))
    assert (np.abs(volumes[4] - volumes[0]).max() > 0) == ("--warm" in more), "it begins where the last volume ended"


@pytest.mark.parametrize("more", [(), ("--executor", "threads")])
def test_a_frame_of_another_size_has_no_volume(
    lfcal: Lfcal, folder: Path, tmp_path: Path, more: tuple[str, ...]
) -> None:
    """Its volume was written below a header with the size of the first frame, or the run aborted midway."""
    place = tmp_path / "frames"
    place.mkdir()
    shutil.copy(folder / "frame.png", place / "0.png")
    cv2.imwrite(str(place / "1.png"), np.full((24, 40), 9, np.uint16))
    done = lfcal("reconstruct", folder / "H.h5", place, "-o", tmp_path / "v", "--solver", "rl", "-n", 2, *more)
    assert done.code == 1 and [path.name for path in (tmp_path / "v").iterdir()] == ["0.tif"]
    said = "expected 30 x 31 pixels, as in the first frame, got 24 x 40 pixels; reconstruct frames of another size"
    assert "1: no volume; " in done.err and said in done.err
    assert load_volume(tmp_path / "v" / "0.tif").shape == (2, *SHAPE)


def test_frames_without_information_are_refused(lfcal: Lfcal, folder: Path, one_bad: Path, tmp_path: Path) -> None:
    (one_bad / "bad").mkdir()
    for name in ("1.npy", "2.npy"):
        (one_bad / name).rename(one_bad / "bad" / name)
    for more in ((), ("--executor", "threads")):
        words = ("reconstruct", folder / "H.h5", "--out", tmp_path / "v.npy", "--solver", "rl", "-n", 2, *more)
        alone = lfcal(*words, one_bad / "bad" / "1.npy").refused()
        assert alone.err.endswith("expected light, got no pixel above 0; check the light and the background\n")
        none = lfcal(*words, one_bad / "bad")
        assert none.code == 2 and "none of the 2 frames was reconstructed" in none.err and "kept" not in none.err
        assert not list(tmp_path.glob("v.npy*"))


# -- ``lfcal reconstruct --region``: H of several regions of the field, by file and by name --
WIDE = (30, 41)
RL = ("--solver", "rl", "-n", 3, "--margin", 0)


def h_at(column: int) -> PSFMatrix:
    spread = 0.7 + 0.01 * column
    H = lenslet_psf(2, 5, 15, spread=spread).astype(np.float32)
    return PSFMatrix(H, anchor=(1.0, float(column)), depths=(-5.0, 5.0), region=f"c{column}")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder: H of three regions, together in one file, too, and two frames."""
    monkeypatch.chdir(tmp_path)
    for column in (2, 17, 32):
        save(h_at(column), tmp_path / f"H{column}.h5")
    save_regions({f"c{column}": h_at(column) for column in (2, 17, 32)}, tmp_path / "all.h5")
    frames = np.random.default_rng(0).poisson(50.0, (2, *WIDE)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "frames.tif", frames, photometric="minisblack")
    tifffile.imwrite(tmp_path / "frame.tif", frames[0], photometric="minisblack")
    (tmp_path / "words.txt").write_text("no H")
    return tmp_path


def by_regions(columns: tuple[int, ...], anchor: tuple[float, float] | None = None) -> np.ndarray:
    P = FieldProjector([h_at(column) for column in columns], WIDE, anchor)
    frame = tifffile.imread("frame.tif").astype(np.float32)
    return np.asarray(reconstruct(P, frame, SolverChoice("rl", 3)).volume)


def test_by_file(lfcal: Lfcal, place: Path) -> None:
    lfcal("reconstruct", "H2.h5", "frame.tif", *RL, "--region", "H17.h5", "--region", "H32.h5", "-o", "v.h5").ok()
    found = load_volume(place / "v.h5")
    np.testing.assert_allclose(found, by_regions((2, 17, 32)), rtol=1e-4, atol=1e-3)
    one = lfcal("reconstruct", "H2.h5", "frame.tif", *RL, "-o", "one.npy")
    assert one.code == 0 and np.abs(np.load("one.npy") - found).max() > 0.01 * found.max()
    with h5py.File("v.h5") as file:
        assert json.loads(str(file.attrs["details"]))["regions"] == ["c2", "c17", "c32"]


def test_by_name(lfcal: Lfcal, place: Path) -> None:
    for names, columns in ((("c32",), (2, 32)), (("c32", "c17"), (2, 32, 17)), (("all",), (2, 17, 32))):
        more = [word for name in names for word in ("--region", name)]
        lfcal("reconstruct", "all.h5", "frame.tif", *RL, *more, "-o", "v.npy", "--force").ok()
        np.testing.assert_allclose(np.load("v.npy"), by_regions(columns), rtol=1e-4, atol=1e-3)


def test_an_anchor_and_a_margin_move_all_of_them(lfcal: Lfcal, place: Path) -> None:
    words = ("reconstruct", "H2.h5", "frame.tif", *RL, "--region", "H32.h5", "--anchor", "4,5")
    lfcal(*words, "-o", "v.npy").ok()
    np.testing.assert_allclose(np.load("v.npy"), by_regions((2, 32), (4.0, 5.0)), rtol=1e-4, atol=1e-3)
    lfcal(*words, "--margin", 5, "-o", "wide.npy").ok()
    P = FieldProjector([h_at(2), h_at(32)], (40, 51), (9.0, 10.0))
    frame = tifffile.imread("frame.tif").astype(np.float32)
    wide = reconstruct(P, frame, SolverChoice("rl", 3, margin=5)).volume
    np.testing.assert_allclose(np.load("wide.npy"), wide, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("executor", ["threads", pytest.param("processes", marks=pytest.mark.long)])
def test_in_units(lfcal: Lfcal, place: Path, executor: str) -> None:
    words = ("reconstruct", "all.h5", "frames.tif", *RL, "--region", "c17", "--region", "H32.h5", "--workers", 1, "-o")
    lfcal(*words, "one.npy").ok()
    lfcal(*words, "two.npy", "--executor", executor).ok()
    assert (place / "one.npy").read_bytes() == (place / "two.npy").read_bytes()


def test_the_forecast_is_that_of_all(lfcal: Lfcal, place: Path) -> None:
    words = ("reconstruct", "H2.h5", "frame.tif", "--forecast", "--json", "--method", "direct", "--margin", 0)
    one, two = (lfcal(*words, *more).json for more in ((), ("--region", "H32.h5")))
    assert two["forecast"]["operand_bytes"] > 2 * one["forecast"]["operand_bytes"] - 1
    alone = Projector(h_at(2), WIDE, method="direct")
    assert alone.forecast().chosen.operand_bytes == one["forecast"]["operand_bytes"]


def test_what_is_not_another_region_is_refused(lfcal: Lfcal, place: Path) -> None:
    before = (place / "H17.h5").read_bytes()
    for more, said in (
        ("none.h5", "--region: expected a region of H2.h5 (c2) or an H file, got none.h5"),
        ("all", "expected regions other than the first of H2.h5, got none; leave --region out"),
        ("H2.h5", "a different position for each, got regions 1 and 2 at the same position"),
        ("words.txt", "words.txt"),
        ("H17.h5 --resample always", "--resample: expected H of one region"),
    ):
        lfcal("reconstruct", "H2.h5", "frame.tif", "--region", *more.split(), "-o", "v.npy").refused(said)
        assert not (place / "v.npy").exists(), more
    run = lfcal("reconstruct", "H2.h5", "frame.tif", "--region", "H17.h5", "-o", "H17.h5", "--force")
    run.refused("a file other than the input")
    assert (place / "H17.h5").read_bytes() == before


# -- ``lfcal reconstruct`` of a session: recorded frames as a time series, with their place on the sensor --
ONE = ("--solver", "rl", "-n", 2, "--workers", 1)


@pytest.fixture
def recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder: a session of three frames of one place, H, and the frames as a stack."""
    monkeypatch.chdir(tmp_path)
    plan = small_plan(period=(1, 1))
    record(tmp_path / "session", plan, rig_for(plan), CAREFUL)
    rng = np.random.default_rng(0)
    save(PSFMatrix(rng.random((1, 4, 5, 9, 9), np.float32), anchor=(50.0, 45.0)), tmp_path / "H.h5")
    with RecordingSource(tmp_path / "session") as source:
        order = sorted(range(3), key=lambda k: float(source.record(k)["elapsed_s"]))
        tifffile.imwrite("stack.tif", np.stack([source.read(k) for k in order]), photometric="minisblack")
        (tmp_path / "origin").write_text(",".join(map(str, source.info(0).origin)))
    return tmp_path


def test_frames_of_a_session_are_a_series(lfcal: Lfcal, recorded: Path) -> None:
    row, column = map(int, (recorded / "origin").read_text().split(","))
    assert (row, column) != (0, 0)
    lfcal("reconstruct", "H.h5", "stack.tif", *ONE, "--anchor", f"{50 - row},{45 - column}", "-o", "w.npy").ok()
    for by in ((), ("--executor", "threads")):
        lfcal("reconstruct", "H.h5", "session", *ONE, *by, "-o", "v.npy", "--force").ok()
        np.testing.assert_array_equal(np.load("v.npy"), np.load("w.npy"))
    lfcal("reconstruct", "H.h5", "session", *ONE, "-o", "out").ok()
    assert sorted(path.name for path in Path("out").iterdir()) == [f"session_000{k}.tif" for k in range(3)]


def test_times_are_kept(lfcal: Lfcal, recorded: Path) -> None:
    zarr = pytest.importorskip("zarr", reason="zarr is not installed")
    lfcal("reconstruct", "H.h5", "session", *ONE, "-o", "v.ome.zarr").ok()
    said = dict(zarr.open_group("v.ome.zarr", mode="r").attrs)
    times = said["lfcal"]["times_s"]
    with RecordingSource(recorded / "session") as source:
        assert times == sorted(float(source.record(k)["elapsed_s"]) for k in range(3))
    scale = said["multiscales"][0]["datasets"][0]["coordinateTransformations"][0]["scale"]
    assert (
        scale[0] == pytest.approx((times[2] - times[0]) / 2) and said["multiscales"][0]["axes"][0]["unit"] == "second"
    )


def test_frames_that_follow_their_spots_are_not_a_series(lfcal: Lfcal, recorded: Path) -> None:
    plan = small_plan(planes=1)
    record(recorded / "scan", plan, rig_for(plan), CAREFUL)
    lfcal("reconstruct", "H.h5", "scan", *ONE, "-o", "out").refused(
        "expected one position on the sensor, got 9 positions"
    )
    lfcal("reconstruct", "H.h5", "session", *ONE, "--resample", "always", "-o", "out").refused(
        "--resample: expected whole frames, got frames that start at"
    )
    assert not Path("out").exists()


def test_a_session_is_never_replaced(lfcal: Lfcal, recorded: Path) -> None:
    recording = next(path for path in (recorded / "session").iterdir() if path.name.startswith("recording"))
    before = recording.read_bytes()
    out = recording.rename(recording.with_suffix(".h5")) if recording.suffix != ".h5" else recording
    run = lfcal("reconstruct", "H.h5", "session", *ONE, "-o", out, "--force")
    assert run.code == 2 and out.read_bytes() == before


# -- Frames go onto H's period by a lenslet of the type that H counts from, wherever the frame's middle lies --
PITCH = 16.0


def drawn(phase: int) -> tuple[WhiteFrame, PSFMatrix]:
    """Return a white frame whose lenslet of type ``phase`` lies in the middle, and an H of its camera."""
    truth = draw_white((330, 400), pitch=PITCH, edges=(3.9, 2.6, 1.6), fill=0.85, rotation=0.0, phase=phase, dark=0.0)
    middle = (np.array(truth.frame.shape) - 1) / 2
    # the place of a lenslet of type 0, as the description knows it
    row, column = (np.array([phase, 0]) @ truth.basis)[::-1] + np.array(truth.origin) - middle
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    lattice = LensletLattice("hexagonal", 5 * PITCH, 400.0, types, offset_um=(5 * column, 5 * row))
    camera = Camera("c", MainLens(), lattice, Sensor(truth.frame.shape, 5.0))
    return truth, PSFMatrix(np.ones((1, 28, 48, 3, 3)), depths=[-500.0], camera=camera, anchor=(100.0, 120.0))


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize("phase", [0, 1, 2])
def test_the_origin_is_a_lenslet_of_type_0(tmp_path: Path, phase: int) -> None:
    truth, H = drawn(phase)
    white = tmp_path / "white.tif"
    tifffile.imwrite(white, truth.frame)
    save_lattice(fit_lattice(truth.frame), tmp_path)
    for view in (
        resampling_of(H, LightFieldSettings(white=white)),
        resampling_of(H, LightFieldSettings(lattice=tmp_path / "lattice.json")),
    ):
        ((q, r),) = truth.indices(np.array([view.origin]))
        assert truth.distance_to_lattice(view.origin) < 0.05 and (q - r - phase) % 3 == 0


def test_a_white_frame_of_another_sensor_is_refused(tmp_path: Path) -> None:
    truth, H = drawn(0)
    tifffile.imwrite(tmp_path / "white.tif", truth.frame[:-20])
    with pytest.raises(InputError, match="white image"):
        resampling_of(H, LightFieldSettings(white=tmp_path / "white.tif"))


# -- what is resampled where nothing is asked for ------------------------------------------------------------
LARGE = (130, 136)


@pytest.fixture
def drifting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PSFMatrix:
    """Write H of lenslets of 15.385 px, its period 15, and a frame of the whole sensor: 3.46 px of drift."""
    monkeypatch.chdir(tmp_path)
    camera = preset("lfm_60x12")
    camera = replace(camera, sensor=replace(camera.sensor, shape=LARGE))
    rng = np.random.default_rng(0)
    H = PSFMatrix(rng.random((1, 15, 15, 5, 5)).astype(np.float32), depths=[1.0], camera=camera, anchor=(60.0, 63.0))
    save(H, "H.h5")
    for name, shape in (("frame.tif", LARGE), ("part.tif", (100, 90))):
        tifffile.imwrite(name, rng.poisson(80, shape).astype(np.uint16))
    tifffile.imwrite("flat.tif", np.full(LARGE, 1000, np.uint16))
    return H


def solved(lfcal: Lfcal, *words: object) -> tuple[NDArray[Any], str]:
    """Return the volume that the command writes, and what it reports."""
    done = lfcal("reconstruct", "H.h5", *words, "--solver", "rl", "-n", 2, "--margin", 0, "--force", "-o", "v.npy").ok()
    return np.load("v.npy"), done.err


def test_frames_are_resampled_where_the_lattice_drifts(lfcal: Lfcal, drifting: PSFMatrix) -> None:
    """They were reconstructed as they are, without a note; a white image without lenslets changes nothing."""
    view, drift = resampling_for(drifting, LARGE), 135 * (15.384615 / 15 - 1)
    note = f"drifts by {drift:.3g} px over the frame relative to H's period of 15 x 15 px; frames are resampled"
    for run in ((), ("--executor", "threads")):
        asked, _ = solved(lfcal, "frame.tif", "--resample", "always", *run)
        usual, said = solved(lfcal, "frame.tif", *run)
        np.testing.assert_array_equal(usual, asked)
        assert view is not None and usual.shape == (1, *view.shape) != (1, *LARGE) and note in said
        flat, said = solved(lfcal, "frame.tif", "--white", "flat.tif", *run)
        assert flat.shape == usual.shape and "the lattice could not be measured in the white image" in said
        assert "resampled" in said


def test_voxels_of_resampled_frames_are_placed_relative_to_the_axis(lfcal: Lfcal, drifting: PSFMatrix) -> None:
    """The origin was that of another pixel: pixels of the sensor were subtracted from pixels of H."""
    view, camera = resampling_for(drifting, LARGE), drifting.camera
    assert view is not None and camera is not None
    words = ("frame.tif", "--solver", "rl", "-n", 1, "--margin", 2, "--voxel", "auto", "-o", "v.ome.tif")
    lfcal("reconstruct", "H.h5", *words).ok()
    facts = volume_facts("v.ome.tif")
    assert facts.origin_um is not None and facts.voxel_um is not None
    axis = (np.array(facts.voxel_um) / 2 - facts.origin_um) / voxel_um(drifting) - 0.5
    np.testing.assert_allclose(view.places(*axis), camera.pixels((0.0, 0.0)), atol=1e-3)


def test_frames_are_used_as_they_are_on_request(lfcal: Lfcal, drifting: PSFMatrix) -> None:
    found, said = solved(lfcal, "frame.tif", "--resample", "never")
    image = tifffile.imread("frame.tif").astype(np.float32)
    P = Projector(drifting, LARGE)
    result = reconstruct(P, image, SolverChoice("rl", 2))
    np.testing.assert_allclose(found, result.volume, rtol=1e-5)
    assert "warning: the lattice drifts by 3.46 px over the frame" in said and "leave --resample never out" in said
    assert any("drifts by 3.46 px" in note and "resampling_for" in note for note in result.notes)
    # a frame whose place is given, or of another size, is not moved
    placed, said = solved(lfcal, "frame.tif", "--anchor", "60,63")
    np.testing.assert_array_equal(placed, found)
    assert "warning: the lattice drifts by 3.46 px" in said and "--anchor" in said
    part, said = solved(lfcal, "part.tif")
    assert part.shape == (1, 100, 90) and "drift" not in said


def test_frames_without_drift_are_used_as_they_are(lfcal: Lfcal, drifting: PSFMatrix) -> None:
    """Up to half a pixel of drift; a white image that shows more decides against the camera."""
    camera = drifting.camera
    assert camera is not None
    pitch = 15.02 * camera.sensor.pixel_um
    fitting = replace(camera, lattice=replace(camera.lattice, pitch_um=pitch))
    Path("H.h5").unlink()
    save(PSFMatrix(drifting[:], depths=[1.0], camera=fitting, anchor=drifting.anchor), "H.h5")
    found, said = solved(lfcal, "frame.tif")
    assert found.shape == (1, *LARGE) and "drift" not in said
    white = draw_white(LARGE, 15.4, kind="square", rotation=0.0).frame
    tifffile.imwrite("white.tif", white)
    found, said = solved(lfcal, "frame.tif", "--white", "white.tif")
    assert found.shape != (1, *LARGE) and "frames are resampled" in said
