"""``lfcal fit`` with unlucky files: one clear line, and nothing written."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lfcal.camera import preset
from lfcal.psf import PSFMatrix, save
from lfcal.psf.facts import Facts
from tests.cli.conftest import Run
from tests.fit.commands import undrawn
from tests.fit.common import few_patterns, small_plan

Lfcal = Callable[..., Run]
Spoil = Callable[[Path], object]


def h_of(values: np.ndarray | None = None, facts: dict[str, Any] | None = None, **more: Any) -> PSFMatrix:
    """Return the few patterns with other values or facts."""
    data = few_patterns()
    known = {"recorded": data.recorded, "noise": data.facts.noise} | (facts or {})
    made = {"depths": data.depths, "camera": data.camera, "anchor": data.anchor} | more
    own = np.asarray(data) if values is None else np.asarray(values, np.float32)
    return PSFMatrix(own, facts=Facts.of(data.shape[:3], data.cutout, **known), **made)


def saved(make: Callable[[], PSFMatrix]) -> Spoil:
    return lambda path: save(make(), path)


def recorded(*places: int) -> np.ndarray:
    found = np.zeros(few_patterns().shape[:3], int)
    found.flat[list(places)] = 1
    return found


def no_noise() -> np.ndarray:
    return np.full((*few_patterns().shape[:3], 2), np.nan)


CASES: dict[str, tuple[Spoil, str]] = {
    "missing": (lambda path: None, "no such file"),
    "empty": (lambda path: path.write_bytes(b""), "expected an intact HDF5 file"),
    "cut short": (
        lambda path: (save(few_patterns(), path), path.write_bytes(path.read_bytes()[:9000])),
        "expected an intact HDF5 file",
    ),
    "all zero": (
        saved(lambda: h_of(np.zeros(few_patterns().shape))),
        "light of the patterns: expected more light than",
    ),
    "below its background": (
        saved(lambda: h_of(-np.asarray(few_patterns()))),
        "brighter than the background, got darker",
    ),
    "scattered": (
        saved(lambda: h_of(4000 * np.random.default_rng(0).random(few_patterns().shape))),
        "expected patterns of a camera like 'bench'",
    ),
    "one position": (
        saved(lambda: h_of(facts={"recorded": recorded(0)})),
        "recorded patterns: expected at least 3, got 1",
    ),
    "no position": (
        saved(lambda: h_of(facts={"recorded": recorded()})),
        "recorded patterns: expected at least 3, got 0",
    ),
    "noise unknown": (saved(lambda: h_of(facts={"noise": no_noise()})), "state the noise (--noise CONSTANT,SLOPE)"),
    "all saturated": (
        saved(lambda: h_of(facts={"valid": np.zeros((1, 2, 4, 29), np.uint8)})),
        "patterns: expected pixels that carry a measurement, got none; reduce the exposure",
    ),
    "resampled": (
        saved(lambda: h_of(provenance={"cutout": {"scale": [1.1, 1.0]}})),
        "assemble them without resampling",
    ),
    "a microscope": (
        saved(lambda: h_of(camera=preset("lfm_20x05"), depths=[-4000.0], anchor=(500.0, 500.0))),
        "size of the patterns of the camera 'lfm_20x05': expected about the 15 px of the cutout, got ",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_unlucky_h_files_end_in_one_line(lfcal: Lfcal, tmp_path: Path, name: str) -> None:
    spoil, what = CASES[name]
    spoil(tmp_path / "H.h5")
    run = lfcal("fit", tmp_path / "H.h5", "--unknowns", "geometry", "--workers", 1, "-o", tmp_path / "fit")
    assert run.code == 2 and run.err.count("\n") == 1 and what in run.err, run.err
    assert not (tmp_path / "fit").exists()


def write_frames(folder: Path, count: int = 8) -> None:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for k in range(count):
        frame = rng.integers(0, 4000, (120, 120)).astype(np.uint16)
        cv2.imwrite(str(folder / f"z0_y{k // 4}_x{k % 4}.png"), frame)


def test_folders_without_frames_plan_or_positions_end_in_one_line(lfcal: Lfcal, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    write_frames(tmp_path / "frames")
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    numbered = tmp_path / "numbered"
    write_frames(numbered)
    for k, path in enumerate(sorted(numbered.iterdir())):
        path.rename(numbered / f"frame{k}.png")
    (numbered / "plan.json").write_text(plan.to_json())
    write_frames(tmp_path / "nested" / "frames")
    (tmp_path / "nested" / "plan.json").write_text(plan.to_json())
    cv2.imwrite(str(tmp_path / "nested" / "dark.png"), np.zeros((120, 120), np.uint16))
    write_frames(tmp_path / "damaged")
    (tmp_path / "damaged" / "plan.json").write_text(plan.to_json())
    (tmp_path / "damaged" / "z0_y1_x1.png").write_bytes(b"")
    for name, what in (
        ("empty", "frames in"),
        ("frames", f"make a plan (lfcal plan CAMERA.json --virtual-depths 3,4 -o {tmp_path / 'frames' / 'plan.json'}"),
        ("nested", f"run lfcal fit {tmp_path / 'nested' / 'frames'}"),
        ("numbered", f"run lfcal assemble {tmp_path / 'numbered'} --order serpentine -o H.h5, then lfcal fit H.h5"),
        ("damaged", "or leave it out (lfcal assemble --skip-damaged)"),
    ):
        run = lfcal(
            "fit", tmp_path / name, "--positions", 0, "--orientation", "as-is", "--no-h", "-o", tmp_path / "fit"
        )
        said = [line for line in run.err.splitlines() if not line.startswith("lfcal: note:")]
        assert run.code == 2 and len(said) == 1 and what in said[0], run.err
        # neither lists nor orders nor patterns are options here
        mine = said[0].partition("run lfcal assemble")[0]
        assert not any(o in mine for o in ("--manifest", "--order", "--pattern")) and not (tmp_path / "fit").exists()


def test_the_command_that_does_what_is_missing_is_named(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    (tmp_path / "plan.json").write_text(plan.to_json())
    assert lfcal("simulate", "plan.json", "--frames", "my scan", "--level", "grid").code == 0
    assert "run lfcal fit 'my scan/frames' --dark 'my scan/dark'" in lfcal("fit", "my scan").err
    # names of which some are like none of the others
    (tmp_path / "my scan" / "frames" / "manifest.csv").unlink()
    cv2.imwrite("my scan/frames/lamp.png", np.zeros((120, 120), np.uint16))
    said = lfcal("fit", "my scan/frames").err
    assert "run lfcal assemble 'my scan/frames' --pattern 'z0_y{y}_x{x}.png' -o H.h5, then lfcal fit H.h5" in said
    typed = said.partition("run lfcal ")[2].partition(", then lfcal ")
    assert lfcal(*shlex.split(typed[0]), "--orientation", "as-is").code == 0


@pytest.mark.long
def test_the_command_that_is_named_does_what_is_missing(
    lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is typed as it is told; the folder's name has a space."""
    monkeypatch.chdir(tmp_path)
    undrawn(monkeypatch)
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    (tmp_path / "plan.json").write_text(plan.to_json())
    assert lfcal("simulate", "plan.json", "--frames", "my scan", "--level", "grid").code == 0
    few = ("--unknowns", "geometry", "--no-h", "--orientation", "as-is", "--workers", 1)
    said = lfcal("fit", "my scan", *few).err
    assert "run lfcal fit 'my scan/frames' --dark 'my scan/dark'" in said, said
    run = lfcal(*shlex.split(said.partition("run lfcal ")[2]), *few, "-o", "first")
    assert run.code == 0, run.err
    # names of which some are like none of the others
    (tmp_path / "my scan" / "frames" / "manifest.csv").unlink(missing_ok=True)
    cv2.imwrite("my scan/frames/lamp.png", np.zeros((120, 120), np.uint16))
    said = lfcal("fit", "my scan/frames", *few).err
    assert "run lfcal assemble 'my scan/frames' --pattern 'z0_y{y}_x{x}.png' -o H.h5, then lfcal fit H.h5" in said
    typed = said.partition("run lfcal ")[2].partition(", then lfcal ")
    assert lfcal(*shlex.split(typed[0]), "--orientation", "as-is").code == 0
    assert lfcal(*shlex.split(typed[2]), *few[:3], "-o", "second").code == 0
    said = lfcal("fit", "my scan/frames/lamp.png", "--plan", "plan.json", *few).err
    assert "run lfcal assemble 'my scan/frames/lamp.png' --plan plan.json --manifest LIST.csv -o H.h5, then" in said


def test_frames_of_fewer_bits_than_described_have_no_known_noise(lfcal: Lfcal, tmp_path: Path) -> None:
    write_frames(tmp_path / "frames")
    for path in (tmp_path / "frames").iterdir():
        cv2.imwrite(str(path), (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) >> 4).astype(np.uint8))
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    (tmp_path / "frames" / "plan.json").write_text(plan.to_json())
    run = lfcal("fit", tmp_path / "frames", "--orientation", "as-is", "--no-h", "-o", tmp_path / "fit")
    assert run.code == 2 and "state the noise (--noise CONSTANT,SLOPE)" in run.err, run.err
