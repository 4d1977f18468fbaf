"""Every kind of bad input: one clear line, exit code 2, and no file left behind."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from tests.cli.conftest import Run

Lfcal = Callable[..., Run]
Spoil = Callable[[Path], list[object]]

FRAME = "z1_y1_x2.png"


def _frames(*options: object) -> Spoil:
    return lambda session: [session / "frames", *options]


def _cut_png(session: Path) -> list[object]:
    path = session / "frames" / FRAME
    path.write_bytes(path.read_bytes()[:200])
    return [session / "frames"]


def _empty_png(session: Path) -> list[object]:
    (session / "frames" / FRAME).write_bytes(b"")
    return [session / "frames"]


def _text_as_png(session: Path) -> list[object]:
    (session / "frames" / FRAME).write_text("not a picture")
    return [session / "frames"]


def _cut_tiff(session: Path) -> list[object]:
    path = session / "stack.tif"
    tifffile.imwrite(path, np.zeros((24, 40, 48), np.uint16) + np.arange(24, dtype=np.uint16)[:, None, None])
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return [path, "--order", "raster"]


def _wrong_page_count(session: Path) -> list[object]:
    path = session / "stack.tif"
    tifffile.imwrite(path, np.ones((25, 40, 48), np.uint16))
    return [path, "--order", "raster"]


def _cut_h5(session: Path) -> list[object]:
    path = session / "stack.h5"
    with h5py.File(path, "w") as file:
        file["frames"] = np.ones((24, 40, 48), np.uint16)
    path.write_bytes(path.read_bytes()[:5000])
    return [path, "--order", "raster"]


def _linked_h5(session: Path) -> list[object]:
    path = session / "stack.h5"
    with h5py.File(path, "w") as file:
        file["frames"] = h5py.ExternalLink("/etc/hostname", "/x")
    return [path, "--order", "raster"]


def _huge_h5(session: Path) -> list[object]:
    path = session / "stack.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("frames", (24, 10**6, 10**6), "u2", chunks=(1, 1000, 1000))
    return [path, "--order", "raster"]


def _broken_raw(session: Path) -> list[object]:
    path = session / "shot.dng"
    path.write_bytes(b"II*\x00" + bytes(100))
    return [path, "--order", "raster"]


def _wrong_shape(session: Path) -> list[object]:
    cv2.imwrite(str(session / "frames" / FRAME), np.ones((30, 48), np.uint16))
    return [session / "frames"]


def _wrong_dtype(session: Path) -> list[object]:
    cv2.imwrite(str(session / "frames" / FRAME), np.ones((40, 48), np.uint8))
    return [session / "frames"]


def _colour(session: Path) -> list[object]:
    cv2.imwrite(str(session / "frames" / FRAME), np.ones((40, 48, 3), np.uint16))
    return [session / "frames"]


def _stack(values: np.ndarray, name: str = "stack.npy") -> Spoil:
    def spoil(session: Path) -> list[object]:
        np.save(session / name, values, allow_pickle=values.dtype == object)
        return [session / name, "--order", "raster"]

    return spoil


def _nan() -> np.ndarray:
    values = np.random.default_rng(0).random((24, 40, 48)).astype(np.float32)
    values[7, 16, 20] = np.nan
    return values


def _saturated(session: Path) -> list[object]:
    cv2.imwrite(str(session / "frames" / FRAME), np.full((40, 48), 65535, np.uint16))
    return [session / "frames"]


def _manifest(change: Callable[[list[str]], list[str]], *options: object) -> Spoil:
    def spoil(session: Path) -> list[object]:
        path = session / "frames" / "manifest.csv"
        path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
        return [session / "frames", *options]

    return spoil


def _duplicate(session: Path) -> list[object]:
    frames = session / "frames"
    (frames / "again.png").write_bytes((frames / FRAME).read_bytes())
    return _manifest(lambda lines: [*lines, "again.png,1,1,2"], "--strict")(session)


def _outside(target: str) -> Spoil:
    return _manifest(lambda lines: [*lines[:-1], f"{target},1,2,3"])


def _symlink(session: Path) -> list[object]:
    (session / "frames" / FRAME).unlink()
    os.symlink("/etc/hostname", session / "frames" / FRAME)
    return [session / "frames"]


def _plan(change: Callable[[str], str]) -> Spoil:
    def spoil(session: Path) -> list[object]:
        path = session / "plan.json"
        path.write_text(change(path.read_text()))
        return [session / "frames"]

    return spoil


def _no_plan(session: Path) -> list[object]:
    (session / "plan.json").unlink()
    return [session / "frames"]


def _dark_shape(session: Path) -> list[object]:
    cv2.imwrite(str(session / "dark" / "0.png"), np.ones((40, 40), np.uint16))
    (session / "dark" / "1.png").unlink()
    return [session / "frames", "--dark", session / "dark"]


def _blank_white(session: Path) -> list[object]:
    return [session / "frames", "--dark", session / "dark", "--white", session / "dark", "--white-mode", "pixels"]


def _frames_with_white(session: Path) -> list[object]:
    return [session / "frames", "--dark", session / "dark", "--white", session / "white"]


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


CASES: dict[str, tuple[Spoil, str]] = {
    "no such folder": (lambda s: [s / "nowhere"], "no such file"),
    "empty folder": (lambda s: [(s / "void").mkdir() or s / "void", "--plan", s / "plan.json"], "expected images"),
    "truncated PNG": (_cut_png, FRAME),
    "empty PNG": (_empty_png, FRAME),
    "text as PNG": (_text_as_png, FRAME),
    "truncated TIFF": (_cut_tiff, "stack.tif"),
    "pages too many in a TIFF": (_wrong_page_count, "25"),
    "truncated HDF5": (_cut_h5, "stack.h5"),
    "external link": (_linked_h5, "ExternalLink"),
    "huge declared shape": (_huge_h5, "stack.h5"),
    "broken RAW": (_broken_raw, "shot.dng"),
    "wrong shape": (_wrong_shape, FRAME),
    "wrong dtype": (_wrong_dtype, FRAME),
    "colour picture": (_colour, FRAME),
    "NaN": (_stack(_nan()), "NaN"),
    "all zero": (_stack(np.zeros((24, 40, 48), np.uint16)), "value 0"),
    "pickled npy": (_stack(np.array([{}], dtype=object)), "pickle"),
    "text array": (_stack(np.full((24, 4, 4), "a")), "stack.npy"),
    "complex array": (_stack(np.ones((24, 40, 48), complex)), "stack.npy"),
    "saturated": (_saturated, "65535"),
    "duplicate position": (_duplicate, "several frames"),
    "file listed twice": (_manifest(lambda lines: [*lines, lines[-1]]), "once"),
    "missing position": (_manifest(lambda lines: lines[:-1], "--strict"), "missing"),
    "position outside the plan": (_manifest(lambda lines: [*lines[:-1], "z1_y2_x3.png,9,0,0"]), "got 9"),
    "negative position": (_manifest(lambda lines: [*lines[:-1], "z1_y2_x3.png,-1,0,0"]), "-1"),
    "manifest without columns": (_manifest(lambda lines: ["a,b"]), "manifest"),
    "manifest with words": (_manifest(lambda lines: [lines[0], f"{FRAME},one,0,0"]), "one"),
    "file of the manifest missing": (_outside("nothing.png"), "nothing.png"),
    "manifest that leaves the session": (_outside("../../secret.png"), "secret.png"),
    "manifest with an absolute path": (_outside("/etc/hostname"), "hostname"),
    "link that leaves the session": (_symlink, FRAME),
    "manifest with NaN": (_exposure("nan"), "exposure_s"),
    "manifest with infinity": (_exposure("inf"), "exposure_s"),
    "manifest with an exposure of zero": (_exposure("0"), "exposure_s"),
    "manifest with a negative exposure": (_exposure("-1"), "exposure_s"),
    "dark of NaN": (_frame("--dark", np.nan), "NaN"),
    "dark of infinity": (_frame("--dark", np.inf), "infinity"),
    "dark beyond any light": (_frame("--dark", 1e300), "1e+300"),
    "white of NaN": (_frame("--white", np.nan), "NaN"),
    "white of infinity": (_frame("--white", -np.inf), "infinity"),
    "white beyond any light": (_frame("--white", 1e300), "1e+300"),
    "white of zeros": (_frame("--white", 0.0), "light"),
    "no plan": (_no_plan, "plan"),
    "plan is not JSON": (_plan(lambda text: text[:40]), "JSON"),
    "plan of another format": (_plan(lambda text: text.replace("lfcal-plan", "other")), "lfcal-plan"),
    "even cutout": (_frames("--cutout", "10"), "odd"),
    "cutout off the sensor": (_frames("--cutout", "45"), "columns"),
    "cutout of words": (_frames("--cutout", "big"), "--cutout"),
    "dark of another sensor": (_dark_shape, "40 x 48 px"),
    "white without light": (_blank_white, "light"),
    "white without lenslets": (_frames_with_white, "white"),
    "unknown white mode": (_frames("--white", "white.png", "--white-mode", "soft"), "white"),
    "unknown interpolation": (_frames("--interpolation", "sharp"), "nearest"),
    "unknown background": (_frames("--background", "blue"), "plane"),
    "pattern that fits nothing": (_frames("--pattern", "img_{z}_{y}_{x}.tif"), "img_"),
    "unknown stored type": (_frames("--dtype", "int4"), "float32"),
}


@pytest.mark.parametrize("name", CASES)
def test_one_line_code_two_nothing_left(name: str, lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    spoil, word = CASES[name]
    arguments = spoil(session)
    out = tmp_path / "out"
    run = lfcal("assemble", *arguments, "-o", out / "H.h5")
    assert run.code == 2, (run.out, run.err)
    lines = run.err.strip().splitlines()
    assert len(lines) == 1, run.err
    assert word.lower() in lines[0].lower()
    assert "Traceback" not in run.err
    assert not out.exists() or list(out.iterdir()) == []


def test_there_are_enough_kinds() -> None:
    assert len(CASES) >= 25


def test_read_only_folder(lfcal: Lfcal, session: Path, tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir()
    locked.chmod(0o500)
    try:
        if os.access(locked, os.W_OK):  # root may write anywhere: use a path that is a file instead
            (tmp_path / "file").write_text("")
            target = tmp_path / "file" / "H.h5"
        else:
            target = locked / "H.h5"
        run = lfcal("assemble", session / "frames", "-o", target)
    finally:
        locked.chmod(0o700)
    assert run.code == 2 and len(run.err.strip().splitlines()) == 1


def test_full_disk(lfcal: Lfcal, session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from lfcal.base import files

    usage = type("Usage", (), {"free": 10})
    monkeypatch.setattr(files.shutil, "disk_usage", lambda _: usage)
    for arguments in (("assemble", session / "frames", "-o", tmp_path / "out" / "H.h5"),):
        run = lfcal(*arguments)
        assert run.code == 2 and "free" in run.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("transpose", "none.h5", "-o", "HT.h5"),
        ("export", "none.h5", "-o", "H.mat"),
        ("plan", "no_such_camera", "--depths", "0"),
        ("plan", "bench", "--depths", "a,b"),
        ("plan", "bench", "--virtual-depths", "2", "--cutout", "8"),
        ("plan", "bench", "--virtual-depths", "3", "--exposure", "1e308"),
        ("plan", "bench", "--virtual-depths", "3", "--settle", "1e300"),
    ],
)
def test_other_commands(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str]) -> None:
    monkeypatch.chdir(tmp_path)
    run = lfcal(*arguments)
    assert run.code == 2, run.err
    assert len(run.err.strip().splitlines()) == 1 and "Traceback" not in run.err
    assert list(tmp_path.iterdir()) == []


def test_bad_matrices_on_the_command_line(lfcal: Lfcal, tmp_path: Path) -> None:
    np.save(tmp_path / "flat.npy", np.zeros((3, 3)))
    (tmp_path / "old.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    (tmp_path / "text.h5").write_text("no")
    for name in ("flat.npy", "old.mat", "text.h5"):
        run = lfcal("transpose", tmp_path / name, "-o", tmp_path / "out" / "HT.h5")
        assert run.code == 2 and len(run.err.strip().splitlines()) == 1, (name, run.err)
    np.save(tmp_path / "good.npy", np.ones((1, 2, 2, 5, 5), np.float32))
    for options in (("-o", "x.xyz"), ("-o", "x.tif", "--position", "9,9"), ("-o", "x.tif", "--position", "a")):
        run = lfcal("export", tmp_path / "good.npy", *options)
        assert run.code == 2 and len(run.err.strip().splitlines()) == 1, run.err
    run = lfcal("transpose", tmp_path / "good.npy", "-o", tmp_path / "out" / "p.h5", "--method", "paper")
    assert run.code == 2 and "odd" in run.err
