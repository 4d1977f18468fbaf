"""``lfcal assemble``: its options, and every kind of bad input."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.acquire.options import Options
from lfcal.acquire.redo import RedoList
from lfcal.acquire.session import record
from lfcal.camera import ScanPlan
from lfcal.devices import simulated_rig
from lfcal.frames import open_frames
from lfcal.psf import open_psf
from lfcal.psf.half_cell import copied_positions
from tests.acquire.rigs import small_plan
from tests.camera.test_plan import camera_of
from tests.cli.conftest import ANCHOR, CUTOUT, DARK, SHAPE, Lfcal, true_frame


# -- assemble --
def test_the_main_job(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    corrected = ("--dark", session / "dark", "--white", session / "white", "--white-mode", "pixels", "--strict")
    words = ("assemble", session / "frames", *corrected, "--force", "-o", tmp_path / "H.h5", "--json")
    assert lfcal(*words).ok().json["shape"] == [*SHAPE, *CUTOUT]
    with open_psf(tmp_path / "H.h5") as H:
        for z, y, x in np.ndindex(SHAPE):
            row, column = ANCHOR[0] + y, ANCHOR[1] + x
            truth = true_frame(z, y, x).astype(float)[row - 4 : row + 5, column - 5 : column + 6]
            np.testing.assert_allclose(H[z, y, x], truth, atol=0.5)
        assert H.camera is not None and H.camera.sensor.shape == (40, 48)
        assert [step["kind"] for step in H.provenance["corrections"]["steps"]] == ["dark", "white"]
    nt, ns = lfcal(*words, "--cutout", "auto").ok().json["shape"][3:]
    assert 9 <= nt <= 17 and 9 <= ns <= 17 and nt % 2 == ns % 2 == 1, "by energy"


def test_names_give_positions_and_missing_ones_are_noted(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    (session / "frames" / "manifest.csv").unlink()
    words = ("assemble", session / "frames", "--pattern", "z{z}_y{y}_x{x}.png", "-o")
    assert "from 24 frames" in lfcal(*words, tmp_path / "H.h5").ok().out
    (session / "frames" / "z1_y2_x3.png").unlink()
    run = lfcal(*words, tmp_path / "M.h5").ok()
    assert "Positions without a frame: 1 position; (z, y, x) = (1, 2, 3)" in run.out
    lfcal(*words, tmp_path / "S.h5", "--strict").refused("missing")
    assert not (tmp_path / "S.h5").exists()


def test_nan_is_masked_or_refused(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    with open_frames(session / "frames") as frames:
        values = np.stack([frames.read(k) for k in range(len(frames))]).astype(np.float32)
    values[:, 3, 4] = np.nan
    np.save(session / "stack.npy", values)
    given = ("assemble", session / "stack.npy", "--order", "raster", "--dark", session / "dark")
    assert "1 pixel without a finite value" in lfcal(*given, "-o", tmp_path / "H.h5").ok().err
    assert "--nan mask" in lfcal(*given, "-o", tmp_path / "R.h5", "--nan", "refuse").err


# -- Every option of ``lfcal assemble`` does something for every kind of source, or is refused with the reason --
PLAN = small_plan((3, 4), 2)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a session with darks, and what options may name."""
    root = tmp_path_factory.mktemp("recorded")
    record(root / "s", PLAN, simulated_rig(PLAN), Options(darks=2, reference_every=0))
    sensor = PLAN.camera.sensor.shape
    rng = np.random.default_rng(0)
    np.save(root / "dark.npy", rng.integers(60, 70, sensor).astype(np.uint16))
    slope = np.linspace(500, 4000, sensor[1])
    np.save(root / "white.npy", np.broadcast_to(slope, sensor).astype(np.uint16))
    hot = rng.integers(0, sensor[0], (40, 2)) * [1, sensor[1] / sensor[0]]
    np.savetxt(root / "hot.txt", hot, "%d", ",")
    lost = np.zeros(sensor, np.uint8)
    lost[::9, ::9] = 255
    cv2.imwrite(str(root / "lost.png"), lost)
    moved = replace(PLAN, anchor=(PLAN.anchor[0] + 1, PLAN.anchor[1]), cutout=(15, 15))
    (root / "moved.json").write_text(moved.to_json())
    np.save(root / "small.npy", np.zeros((3, 4)))
    (root / "other.json").write_text(small_plan((5, 5), 2).to_json())
    return root


def h_of(path: Path) -> np.ndarray:
    with open_psf(path) as matrix:
        return np.asarray(matrix)


CHANGES = (
    "--white white.npy --white-mode pixels --white-floor 0.9 --dark dark.npy",
    "--background 0.5",
    "--exposure 0.01",
    "--defect-list hot.txt",
    "--plan moved.json",
)
MORE_CHANGES = (
    "--dark dark.npy",
    "--dark none --black-level 0",
    "--black-level 30",
    "--white white.npy --white-mode pixels --dark dark.npy",
    "--mask lost.png",
    "--cutout 11",
    "--cutout auto --lost 0.2",
    "--cutout 31 --pad",
    "--store-tolerance 0.05",
)


@pytest.mark.parametrize("cases", [CHANGES, pytest.param(MORE_CHANGES, marks=pytest.mark.long)], ids=["some", "more"])
def test_options_change_the_h_of_a_recorded_session(
    lfcal: Lfcal, recorded: Path, tmp_path: Path, cases: tuple[str, ...]
) -> None:
    plain, changed = tmp_path / "plain.h5", tmp_path / "changed.h5"
    lfcal("assemble", recorded / "s", "-o", plain).ok()
    a = h_of(plain)
    for case in cases:
        arguments = [str(recorded / one) if (recorded / one).exists() else one for one in case.split()]
        lfcal("assemble", recorded / "s", "-o", changed, "--force", *arguments).ok()
        b = h_of(changed)
        assert a.shape != b.shape or not np.array_equal(a, b), case


def test_masked_pixels_are_not_valid_in_h(lfcal: Lfcal, recorded: Path, tmp_path: Path) -> None:
    lfcal("assemble", recorded / "s", "-o", tmp_path / "H.h5", "--mask", recorded / "lost.png").ok()
    lost = cv2.imread(str(recorded / "lost.png"), cv2.IMREAD_UNCHANGED) > 0
    (nt, ns), (row, column) = PLAN.cutout, (int(np.floor(n)) for n in PLAN.anchor)
    with open_psf(tmp_path / "H.h5") as matrix:
        assert matrix.provenance["corrections"]["steps"][0]["kind"] == "mask"
        for y, x in np.ndindex(3, 4):
            top, left = row + y - nt // 2, column + x - ns // 2
            np.testing.assert_array_equal(matrix.valid(0, y, x), ~lost[top : top + nt, left : left + ns])
            assert np.isfinite(np.asarray(matrix[0, y, x])).all()


REFUSED = (
    ("--dark /nonexistent.tif", "no such file or folder"),
    ("--plan /nonexistent.json", "No such file"),
    ("--plan other.json", "expected the plan of these frames"),
    ("--manifest moved.json", "the source defines this itself"),
    ("--pattern z{z}_y{y}_x{x}.png", "the source defines this itself"),
    ("--order raster", "the source defines this itself"),
    ("--channel G1", "colour"),
    ("--defects", "expected whole sensor frames, got cutouts"),
    ("--mask small.npy", "as the frames come from the camera, got 3 x 4"),
    ("--background border", "expected a constant for cutouts"),
    ("--white white.npy --dark dark.npy", "--white-mode pixels"),
    ("--white white.npy --white-mode smooth", "expected field or pixels"),
    ("--cutout 61", "move the anchor, choose a smaller cutout, or allow padding"),
    ("--cutout wide", "--cutout: expected one number or two (rows,columns)"),
    ("--shift 4", "samples with 4 unused low bits"),
    ("--dark none --plan level.json", "subtract dark frames, the black level"),
    ("--interpolation quintic", "nearest, linear, cubic or fourier"),
    ("--dtype int3", "--dtype: expected rounded or float32"),
    ("--compression rar", "gzip, zstd or none"),
)


def test_what_cannot_be_done_for_a_session_is_refused(lfcal: Lfcal, recorded: Path, tmp_path: Path) -> None:
    level = replace(PLAN, camera=replace(PLAN.camera, sensor=replace(PLAN.camera.sensor, black_level=0.0)))
    (recorded / "level.json").write_text(level.to_json())
    for options, said in REFUSED:
        words = [recorded / one if (recorded / one).exists() else one for one in options.split()]
        lfcal("assemble", recorded / "s", "-o", tmp_path / "H.h5", *words).refused(said)
        assert not (tmp_path / "H.h5").exists(), options


def test_saturation_interpolation_compression_and_workers(lfcal: Lfcal, recorded: Path, tmp_path: Path) -> None:
    words = ("assemble", recorded / "s", "--force", "-o", tmp_path / "H.h5")
    assert lfcal(*words, "--saturation", "200", "--json").ok().json["saturated_positions"] == 24
    for options in (("--interpolation", "cubic"), ("--workers", "1"), ("--strict",), ("--compression", "zstd")):
        lfcal(*words, *options).ok()
    with h5py.File(tmp_path / "H.h5") as file:
        assert file["H"].id.get_create_plist().get_filter(1)[0] == 32015


def test_pedestal_shift_order_and_manifest_of_a_folder(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    frames, listed = session / "frames", tmp_path / "list.csv"
    lfcal("assemble", frames, "-o", tmp_path / "a.h5").ok()
    (frames / "manifest.csv").rename(listed)
    run = lfcal("assemble", frames, "-o", tmp_path / "b.h5").ok()
    assert "names: read as --pattern 'z{z}_y{y}_x{x}.png'" in run.err
    lfcal("assemble", frames, "-o", tmp_path / "b.h5", "--manifest", listed, "--force").ok()
    lfcal("assemble", frames, "-o", tmp_path / "c.h5", "--order", "raster").ok()
    for name in ("b.h5", "c.h5"):
        np.testing.assert_array_equal(h_of(tmp_path / name), h_of(tmp_path / "a.h5"))
    for path in frames.glob("*.png"):
        frame = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), (frame // 16 + 60).astype(np.uint16) << 4)
    words = ("assemble", frames, "-o", tmp_path / "H.h5", "--shift", "4")
    lfcal(*words).refused("a constant level of 6")
    lfcal(*words, "--keep-pedestal").ok()
    assert 60 < h_of(tmp_path / "H.h5").max() < 2000, "the low bits are gone"


def test_a_plan_alone_is_recorded_by_the_simulated_camera(lfcal: Lfcal, tmp_path: Path) -> None:
    plan = ScanPlan.for_camera(PLAN.camera, virtual_depths=[4.0], cutout=21)
    (tmp_path / "plan.json").write_text(replace(plan, period=(2, 3)).to_json())
    done = lfcal("assemble", tmp_path / "plan.json", "-o", tmp_path / "H.h5", "--json").ok()
    found: Any = done.json
    assert (found["frames"], found["unknown_saturation"], found["saturated_positions"]) == (6, 0, 0)
    assert DARK and h_of(tmp_path / "H.h5").shape == (1, 2, 3, 21, 21)


# -- Every kind of bad input: one clear line, exit code 2, and no file left behind --
Spoil = Callable[[Path], list[object]]

FRAME = "z1_y1_x2.png"


def _frames(*options: object) -> Spoil:
    return lambda session: [session / "frames", *options]


def _file(change: Callable[[bytes], bytes], name: str = f"frames/{FRAME}") -> Spoil:
    """Change the bytes of a file of the session."""

    def spoil(session: Path) -> list[object]:
        (session / name).write_bytes(change((session / name).read_bytes()))
        return [session / "frames"]

    return spoil


def _image(values: np.ndarray) -> Spoil:
    """Replace a frame by another image."""

    def spoil(session: Path) -> list[object]:
        cv2.imwrite(str(session / "frames" / FRAME), values)
        return [session / "frames"]

    return spoil


def _stack(name: str, write: Callable[[Path], object]) -> Spoil:
    """Write a stack of frames in place of the folder."""

    def spoil(session: Path) -> list[object]:
        write(session / name)
        return [session / name, "--order", "raster"]

    return spoil


def _npy(values: np.ndarray) -> Spoil:
    return _stack("stack.npy", lambda path: np.save(path, values, allow_pickle=values.dtype == object))


def _tiff(values: np.ndarray, share: float = 1.0) -> Spoil:
    """Write a TIFF, of which ``share`` of the bytes are kept."""

    def write(path: Path) -> None:
        tifffile.imwrite(path, values)
        path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])

    return _stack("stack.tif", write)


def _h5(add: Callable[[h5py.File], object], keep: int = 10**9) -> Spoil:
    """Write an HDF5 file, of which ``keep`` bytes are kept."""

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            add(file)
        path.write_bytes(path.read_bytes()[:keep])

    return _stack("stack.h5", write)


def _nan() -> np.ndarray:
    values = np.random.default_rng(0).random((24, 40, 48)).astype(np.float32)
    values[7, 16, 20] = np.nan
    return values


def _manifest(change: Callable[[list[str]], list[str]], *options: object) -> Spoil:
    def spoil(session: Path) -> list[object]:
        path = session / "frames" / "manifest.csv"
        path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
        (session / "frames" / "again.png").write_bytes((session / "frames" / FRAME).read_bytes())
        return [session / "frames", *options]

    return spoil


def _last(row: str) -> Spoil:
    """Replace the last row of the manifest."""
    return _manifest(lambda lines: [*lines[:-1], row])


def _symlink(session: Path) -> list[object]:
    (session / "frames" / FRAME).unlink()
    os.symlink("/etc/hostname", session / "frames" / FRAME)
    return [session / "frames"]


def _no_plan(session: Path) -> list[object]:
    (session / "plan.json").unlink()
    return [session / "frames"]


def _dark_shape(session: Path) -> list[object]:
    cv2.imwrite(str(session / "dark" / "0.png"), np.ones((40, 40), np.uint16))
    (session / "dark" / "1.png").unlink()
    return [session / "frames", "--dark", session / "dark"]


def _white(name: str, *more: str) -> Spoil:
    return lambda session: [session / "frames", "--dark", session / "dark", "--white", session / name, *more]


def _exposure(text: str) -> Spoil:
    return _manifest(lambda lines: [f"{lines[0]},exposure_s", *(f"{line},{text}" for line in lines[1:])])


def _frame(role: str, value: float) -> Spoil:
    """Return the options with a dark or white frame of which one pixel (0: every pixel) is ``value``."""

    def spoil(session: Path) -> list[object]:
        frame = np.full((40, 48), 30000.0 if value else 0.0)
        frame[20, 24] = value
        np.save(session / "own.npy", frame)
        dark = session / "dark" if role == "--white" else session / "own.npy"
        return [session / "frames", "--dark", dark, *(["--white", session / "own.npy"] if role == "--white" else [])]

    return spoil


NUMBERED = np.zeros((24, 40, 48), np.uint16) + np.arange(24, dtype=np.uint16)[:, None, None]
CASES: dict[str, tuple[Spoil, str]] = {
    "no such folder": (lambda s: [s / "nowhere"], "no such file"),
    "empty folder": (lambda s: [(s / "void").mkdir() or s / "void", "--plan", s / "plan.json"], "expected images"),
    "truncated PNG": (_file(lambda data: data[:200]), FRAME),
    "empty PNG": (_file(lambda data: b""), FRAME),
    "text as PNG": (_file(lambda data: b"not a picture"), FRAME),
    "truncated TIFF": (_tiff(NUMBERED, 0.5), "stack.tif"),
    "pages too many in a TIFF": (_tiff(np.ones((25, 40, 48), np.uint16)), "25"),
    "truncated HDF5": (_h5(lambda file: file.create_dataset("frames", data=NUMBERED), 5000), "stack.h5"),
    "external link": (_h5(lambda file: file.update(frames=h5py.ExternalLink("/etc/hostname", "/x"))), "ExternalLink"),
    "huge declared shape": (
        _h5(lambda file: file.create_dataset("frames", (24, 10**6, 10**6), "u2", chunks=(1, 1000, 1000))),
        "stack.h5",
    ),
    "broken RAW": (_stack("shot.dng", lambda path: path.write_bytes(b"II*\x00" + bytes(100))), "shot.dng"),
    "wrong shape": (_image(np.ones((30, 48), np.uint16)), FRAME),
    "wrong dtype": (_image(np.ones((40, 48), np.uint8)), FRAME),
    "colour picture": (_image(np.ones((40, 48, 3), np.uint16)), FRAME),
    "NaN": (_npy(_nan()), "NaN"),
    "all zero": (_npy(np.zeros((24, 40, 48), np.uint16)), "value 0"),
    "pickled npy": (_npy(np.array([{}], dtype=object)), "pickle"),
    "text array": (_npy(np.full((24, 4, 4), "a")), "stack.npy"),
    "complex array": (_npy(np.ones((24, 40, 48), complex)), "stack.npy"),
    "saturated": (_image(np.full((40, 48), 65535, np.uint16)), "65535"),
    "duplicate position": (_manifest(lambda lines: [*lines, "again.png,1,1,2"], "--strict"), "several frames"),
    "file listed twice": (_manifest(lambda lines: [*lines, lines[-1]]), "once"),
    "missing position": (_manifest(lambda lines: lines[:-1], "--strict"), "missing"),
    "position outside the plan": (_last("z1_y2_x3.png,9,0,0"), "got 9"),
    "negative position": (_last("z1_y2_x3.png,-1,0,0"), "-1"),
    "manifest without columns": (_manifest(lambda lines: ["a,b"]), "manifest"),
    "manifest with words": (_manifest(lambda lines: [lines[0], f"{FRAME},one,0,0"]), "one"),
    "file of the manifest missing": (_last("nothing.png,1,2,3"), "nothing.png"),
    "manifest that leaves the session": (_last("../../secret.png,1,2,3"), "secret.png"),
    "manifest with an absolute path": (_last("/etc/hostname,1,2,3"), "hostname"),
    "link that leaves the session": (_symlink, FRAME),
    **{f"manifest with an exposure of {text}": (_exposure(text), "exposure_s") for text in ("nan", "inf", "0", "-1")},
    "dark of NaN": (_frame("--dark", np.nan), "NaN"),
    "dark of infinity": (_frame("--dark", np.inf), "infinity"),
    "dark beyond any light": (_frame("--dark", 1e300), "1e+300"),
    "white of NaN": (_frame("--white", np.nan), "NaN"),
    "white of infinity": (_frame("--white", -np.inf), "infinity"),
    "white beyond any light": (_frame("--white", 1e300), "1e+300"),
    "white of zeros": (_frame("--white", 0.0), "light"),
    "no plan": (_no_plan, "plan"),
    "plan is not JSON": (_file(lambda data: data[:40], "plan.json"), "JSON"),
    "plan of another format": (_file(lambda data: data.replace(b"lfcal-plan", b"other"), "plan.json"), "lfcal-plan"),
    "even cutout": (_frames("--cutout", "10"), "odd"),
    "cutout off the sensor": (_frames("--cutout", "45"), "columns"),
    "cutout of words": (_frames("--cutout", "big"), "--cutout"),
    "dark of another sensor": (_dark_shape, "40 x 48 px"),
    "white without light": (_white("dark", "--white-mode", "pixels"), "light"),
    "white without lenslets": (_white("white"), "white"),
    "unknown white mode": (_frames("--white", "white.png", "--white-mode", "soft"), "white"),
    "unknown interpolation": (_frames("--interpolation", "sharp"), "nearest"),
    "unknown background": (_frames("--background", "blue"), "plane"),
    "pattern that fits nothing": (_frames("--pattern", "img_{z}_{y}_{x}.tif"), "img_"),
    "unknown stored type": (_frames("--dtype", "int4"), "float32"),
}


@pytest.mark.parametrize("name", CASES)
def test_bad_input_ends_in_one_line_and_leaves_nothing(name: str, lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    spoil, word = CASES[name]
    arguments = spoil(session)
    out = tmp_path / "out"
    run = lfcal("assemble", *arguments, "-o", out / "H.h5")
    assert run.code == 2 and len(run.err.strip().splitlines()) == 1 and word.lower() in run.err.lower(), run.err
    assert "Traceback" not in run.err and (not out.exists() or list(out.iterdir()) == [])


def test_a_full_disk_or_a_folder_that_cannot_be_written_to_is_refused(
    lfcal: Lfcal, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (locked := tmp_path / "locked").mkdir(0o500)
    (tmp_path / "file").write_text("")
    # the administrator may write anywhere: use a path below a file instead
    folder = tmp_path / "file" if os.access(locked, os.W_OK) else locked
    lfcal("assemble", session / "frames", "-o", folder / "H.h5").refused()
    monkeypatch.setattr("lfcal.base.files.shutil.disk_usage", lambda _: type("Usage", (), {"free": 10}))
    lfcal("assemble", session / "frames", "-o", tmp_path / "out" / "H.h5").refused("free")
    assert not (tmp_path / "out").exists()


def test_bad_input_of_other_commands_is_one_line(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("flat.npy", np.zeros((3, 3)))
    Path("old.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    Path("text.h5").write_text("no")
    np.save("good.npy", np.ones((1, 2, 2, 5, 5), np.float32))
    before = sorted(tmp_path.iterdir())
    for words in (
        *(f"transpose {name} -o out/HT.h5" for name in ("none.h5", "flat.npy", "old.mat", "text.h5")),
        "transpose good.npy -o p.h5 --method paper",
        "export none.h5 -o H.mat",
        *(f"export good.npy -o {out}" for out in ("x.xyz", "x.tif --position 9,9", "x.tif --position a")),
        *(f"plan bench --virtual-depths 3 {option}" for option in ("--cutout 8", "--exposure 1e308", "--settle 1e300")),
    ):
        lfcal(*words.split()).refused()
        assert sorted(tmp_path.iterdir()) == before, words


# -- Commands on frames as other programs write them, after public reports --


def test_frames_whose_dark_is_subtracted_already(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    """Noise is then negative in half of the dark pixels (flatironinstitute/CaImAn#652)."""
    lfcal("assemble", session / "frames", "--dark", session / "dark", "-o", tmp_path / "plain.h5").ok()
    wanted = h_of(tmp_path / "plain.h5").astype(float)
    for dtype in (np.float32, np.int16):
        rng, folder = np.random.default_rng(0), tmp_path / dtype.__name__
        shutil.copytree(session / "frames", folder)
        for path in folder.glob("*.png"):
            values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float64) - DARK
            tifffile.imwrite(path.with_suffix(".tif"), (values + rng.normal(0, 3, values.shape)).astype(dtype))
            path.unlink()
        (folder / "manifest.csv").write_text((folder / "manifest.csv").read_text().replace(".png", ".tif"))
        lfcal("assemble", folder, "--plan", session / "plan.json", "-o", tmp_path / f"{folder.name}.h5").ok()
        assert np.abs(h_of(tmp_path / f"{folder.name}.h5") - wanted).max() < 20 and wanted.max() > 15000


def test_a_frame_with_nan_and_negative_values_is_reconstructed(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    """A subtracted background leaves negative values, a bad pixel NaN (roman-corgi/corgidrp#988)."""
    lfcal("assemble", session / "frames", "--dark", session / "dark", "-o", tmp_path / "H.h5").ok()
    light = cv2.imread(str(session / "frames/z0_y0_x1.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) - DARK
    light += np.random.default_rng(1).normal(0, 5, light.shape).astype(np.float32)
    tifffile.imwrite(tmp_path / "whole.tif", light)
    spoiled, lost = light.copy(), np.zeros(light.shape, np.uint8)
    spoiled[3, 4], spoiled[2, 20], lost[3, 4], lost[2, 20] = np.nan, -4000, 1, 1
    tifffile.imwrite(tmp_path / "spoiled.tif", spoiled)
    tifffile.imwrite(tmp_path / "lost.tif", lost)

    def volume(name: str, *more: object) -> tuple[np.ndarray, str]:
        words = (
            "reconstruct",
            tmp_path / "H.h5",
            tmp_path / f"{name}.tif",
            "-n",
            4,
            "--force",
            "-o",
            tmp_path / "v.npy",
        )
        said = lfcal(*words, *more).ok().err
        return np.load(tmp_path / "v.npy"), said

    (whole, _), (found, _) = (volume(name, "--resample", "never") for name in ("whole", "spoiled"))
    assert np.isfinite(found).all() and found.min() >= 0 and abs(found.sum() / whole.sum() - 1) < 0.02
    _, said = volume("whole", "--resample", "never", "--mask", tmp_path / "lost.tif")
    assert said.count("2 non-finite pixels were left out") == 1 and np.isfinite(volume("spoiled")[0]).all()


def test_frames_that_the_camera_delivered_twice_are_named(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    """A buffer is read before the next frame is there (pymmcore-plus/pymmcore-plus#445)."""
    frames = session / "frames"
    for x in (2, 3):
        shutil.copy(frames / "z0_y0_x1.png", frames / f"z0_y0_x{x}.png")
    lfcal("assemble", frames, "--dark", session / "dark", "-o", tmp_path / "H.h5").ok()
    done = lfcal("inspect", tmp_path / "H.h5", "--seconds", 0)
    assert "duplicate" in done.out, done.out


# -- Half-cell scans from plan to H --
HALF_CELL_PLAN = ("plan", "camera.json", "--virtual-depths", "3", "--cutout", "31", "--half-cell")
QUIET = ("--no-check-stage", "--darks", "0", "--reference-every", "0", "--option", "optics=geometric")


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "camera.json").write_text(camera_of((6.0, 12.0), 1).to_json())
    (tmp_path / "odd.json").write_text(camera_of((7.0, 12.0), 1).to_json())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_half_a_scan_makes_a_whole_h(lfcal: Lfcal, place: Path) -> None:
    run = lfcal(*HALF_CELL_PLAN, "-o", "plan.json", "--list", "half.json").ok()
    assert "rows 0 to 2; the other positions have the same patterns, 3, 6 px away" in run.out and "half.json" in run.out
    assert len(RedoList.read(place / "half.json").positions) == 36
    said = lfcal(*HALF_CELL_PLAN, "--json").json
    assert len(said["half_cell"]) == 36 and said["forecast"]["frames"] == 36
    lfcal("acquire", "plan.json", "--positions", "half.json", "-o", "half", *QUIET).ok()
    lfcal("acquire", "plan.json", "-o", "whole", *QUIET).ok()
    run = lfcal("assemble", "half", "--half-cell", "--black-level", "0", "-o", "half.h5").ok()
    assert "from 36 frames" in run.out and "36 positions have the patterns recorded half a period away" in run.err
    lfcal("assemble", "whole", "--black-level", "0", "-o", "whole.h5").ok()
    with open_psf(place / "half.h5") as half, open_psf(place / "whole.h5") as whole:
        copied = copied_positions(half)
        assert copied.sum() == 36 and (half.recorded > 0).all()
        # as far off as two recordings are from each other: by their noise
        mine, other = half.plane(0), whole.plane(0)
        off = np.sqrt(np.square(mine - other).sum((2, 3)) / np.square(other).sum((2, 3)))
        unlike = np.linalg.norm(other[0, 0] - other[0, 6]) / np.linalg.norm(other[0, 0])
        assert 0.02 < np.median(off[copied[0]]) < 0.04 and unlike > 1
    again = lfcal("assemble", "whole", "--half-cell", "--black-level", "0", "-o", "more.h5")
    again.refused("frames at all positions")


def test_half_a_cell_that_cannot_be_planned_is_refused(lfcal: Lfcal, place: Path) -> None:
    small = "--virtual-depths 3 --cutout 31"
    for words, said in (
        (f"odd.json {small} --half-cell --list a.json", "half of which is not a whole number of pixels"),
        ("bench --virtual-depths 3 --half-cell -o a.json", "got 19 x 33"),
        (f"camera.json {small} --list a.json", "--list: expected --half-cell"),
        (
            "camera.json --virtual-depths 3 --half-cell --positions a.csv",
            "got a recorded scan (--positions); leave --half-cell out",
        ),
        (f"camera.json {small} --half-cell --list a.json --speed -1", "--speed: expected a number > 0"),
    ):
        lfcal("plan", *words.split()).refused(said)
        assert not list(place.glob("a.*")), words
