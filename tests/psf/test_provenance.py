"""What H keeps of its frames and its simulation, through everything that is made of it."""

from __future__ import annotations

import json
import shutil
import subprocess
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfcal
from lfcal.base import version
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.frames import ORIENTATIONS, ArraySource, CorrectionChain, Dark, LeftOut, Noise, corrected, oriented
from lfcal.frames.source import Position
from lfcal.psf import Cutout, PSFMatrix, assemble, open_psf, save, save_regions
from lfcal.psf.assembly import AssemblySettings, assemble_plan
from lfcal.psf.provenance import (
    Codec,
    FrameNoise,
    codec_of,
    computed_words,
    light_shares,
    noise_of,
    optics_of,
    simulated_planes,
)
from lfcal.psf.saving import iter_transpose_file
from lfcal.simulate import SimulatedCamera, simulate_psf
from lfcal.simulate.effects import Quantisation
from lfcal.simulate.progressive import iter_refine_psf
from lfcal.simulate.simulate import iter_simulate_psf
from lfcal.work import RunChoice
from tests.simulate.common import BASE, FAST, small_plan

FACTS: dict[str, Any] = {"codec": {"name": "lzw", "lossless": True}, "optics": "pattern"}


def of_frames(out: Path | None = None, facts: Mapping[str, Any] = FACTS) -> PSFMatrix:
    """H of nine frames whose files are stored with a lossless codec."""
    stack = np.random.default_rng(0).integers(1, 4000, (1, 3, 3, 16, 16), np.uint16)
    return assemble(ArraySource(stack, metadata=dict(facts)), (1, 3, 3), Cutout((5, 5), anchor=(7, 8)), out).matrix


def test_the_codec_of_the_frames_is_kept() -> None:
    provenance = of_frames().provenance
    assert provenance["frames"] == {"count": 9, "codec": {"name": "lzw", "lossless": True}}
    assert codec_of(provenance) == Codec("lzw", True)
    assert codec_of(of_frames(facts={}).provenance) is None


def test_facts_of_the_frames_stay_with_what_is_made_of_h(tmp_path: Path) -> None:
    with of_frames(tmp_path / "H.h5") as H:
        noisy = {**H.provenance, "noise": {"floor": 4.0, "slope": 0.5, "from": "darks and repeats"}}
        first = save(PSFMatrix(H[:], provenance=noisy), tmp_path / "first.h5")
    with open_psf(first) as H:
        made = [
            drain(iter_transpose_file(H, tmp_path / "HT.h5")),
            drain(iter_transpose_file(H, tmp_path / "paper.h5", method="paper")),
            save(H, tmp_path / "small.h5", store_tolerance=0.01),
            save(H.T, tmp_path / "view.h5"),
            save_regions({"centre": H}, tmp_path / "field.h5"),
        ]
    for path in made:
        with open_psf(path) as H:
            assert codec_of(H.provenance) == Codec("lzw", True), path
            assert noise_of(H.provenance) == FrameNoise(4.0, 0.5, 0.0, "darks and repeats"), path


def test_what_h_keeps_of_what_frames_say_is_the_same_text_in_every_version(tmp_path: Path) -> None:
    """Names, order and values in the file: programs and later versions of lfcal read them."""
    plan = small()
    facts: dict[str, Any] = {
        "kept_aside": [[0, 0, 1]],
        "suspect": [[0, 0, 0, "drift"]],
        "optics": "pattern",
        "simulated": {"effects": [], "level": "geometric", "seed": 0},
        "devices": {"camera": "c", "stage": "s", "settings": {"Gain": "0"}},
        "session": "0123",
        "origin": (0, 0),
        "codec": {"name": "lzw", "lossless": True},
        "left_out": (LeftOut("b.png", Position(0, 0, 1), "cut short"),),
        "saturation": 4000.0,
        "bit_depth": 12,
        "notes": ("a guess",),
        "a plug-in's own": 7,
    }
    stack = np.random.default_rng(0).integers(1, 4000, (*plan.shape[:3], *plan.camera.sensor.shape), np.uint16)
    dark = np.full(plan.camera.sensor.shape, 3, np.float32)
    view = corrected(ArraySource(stack, metadata=facts), CorrectionChain((Dark(dark, count=4, variance=2.0),)))
    upright = oriented(view, ORIENTATIONS["mirror x"], plan.camera.sensor.shape)
    assemble_plan(upright, plan, tmp_path / "H.h5", AssemblySettings(keep_pedestal=True))
    with open_psf(tmp_path / "H.h5") as H:
        text = json.dumps({key: value for key, value in H.provenance.items() if key not in ("lfcal", "plan")})
    # the checksum by a formula of its own
    crc = f"{zlib.crc32(dark.tobytes()):08x}"
    count = stack.shape[0] * stack.shape[1] * stack.shape[2]
    assert text == (
        f'{{"frames": {{"count": {count}, "codec": {{"name": "lzw", "lossless": true}}, "origin": [0, 0]}}, '
        '"cutout": {"interpolation": "nearest", "outside": "error", "scale": [1.0, 1.0]}, '
        f'"corrections": {{"steps": [{{"kind": "dark", "level": 0.0, "mean": 3.0, "crc32": "{crc}"}}], '
        '"saturation": null}, "session": "0123", '
        '"devices": {"camera": "c", "stage": "s", "settings": {"Gain": "0"}}, '
        '"simulated": {"effects": [], "level": "geometric", "seed": 0}, "optics": "pattern", '
        '"suspect": [[0, 0, 0, "drift"]], "kept_aside": [[0, 0, 1]], '
        '"left_out": [{"label": "b.png", "position": [0, 0, 1], "reason": "cut short"}], '
        '"orientation": {"applied": "mirror x"}}'
    )


def test_provenance_of_anyone_is_read_with_care() -> None:
    for frames in (627, None, [], {"codec": "lzw"}, {"codec": {"name": 3}}, {"codec": {"lossless": True}}):
        assert codec_of({"frames": frames}) is None
        assert noise_of({"noise": frames}) is None
        assert optics_of({"optics": frames}) is None
        assert simulated_planes({"simulated": frames}, 2) == [None, None]
    for floor in (-1.0, float("nan"), float("inf"), "4", True, None):
        assert noise_of({"noise": {"floor": floor, "slope": 0.5}}) is None
    assert noise_of({"noise": {"floor": 0, "slope": 0}}) is None
    assert not light_shares({}) and not light_shares({"simulated": 3})


def test_what_h_keeps_of_a_noise_is_read_as_it_was_written() -> None:
    """The value of no light included; it was dropped."""
    noise = FrameNoise(4.0, 0.25, -1.5, "repeated frames")
    assert noise.record() == {"floor": 4.0, "slope": 0.25, "black": -1.5, "from": "repeated frames"}
    assert noise_of({"noise": noise.record()}) == noise
    for black in (float("nan"), "64", None):
        assert noise_of({"noise": {**noise.record(), "black": black}}) == noise._replace(black=0.0)
    assert noise.of_samples == Noise(4.0, 0.25, -1.5) and noise._replace(stated=True).of_samples is None


def small() -> ScanPlan:
    return replace(small_plan(cutout=31), period=(2, 3))


def assert_says_how(matrix: PSFMatrix) -> None:
    for plane in simulated_planes(matrix.provenance, len(matrix)):
        assert plane is not None and plane["engine"] in ("geometric", "wave", "grid"), plane
        assert plane["sampling"]["nodes_per_px"] >= 1 and plane["seconds"] > 0
        assert plane["processor_seconds"] > 0 and plane["grid_side"] >= 0
    simulated = matrix.provenance["simulated"]
    assert simulated["requested_level"] == "auto" and simulated["level"] in ("geometric", "wave", "grid")


GRID = {"engine": "microscope", "sampling": {"nodes_per_px": 2}, "grid_side": 90, "error": 0.02}
RECORDS: list[tuple[dict[str, Any], str]] = [
    ({"engine": 3}, ""),
    ({"engine": "wave", "seconds": 1.5}, "plane 0: wave"),
    ({"engine": "wave", "sampling": 5, "grid_side": "x", "processor_seconds": True}, "plane 0: wave"),
    ({"engine": "grid", "sampling": {"samples_per_px": float("nan")}, "error": []}, "plane 0: grid"),
    ({"engine": "geometric", "sampling": {"nodes_per_px": 4}}, "plane 0: geometric, rays integrated over the pixels"),
    (GRID, "plane 0: microscope, 2 nodes per pixel, 90 x 90 samples; error at most 2 %"),
]


def test_records_of_older_files_and_of_anyone_are_shown_as_far_as_they_are_valid() -> None:
    for record, words in RECORDS:
        found = computed_words(simulated_planes({"simulated": {"planes": [record]}}, 1))
        assert found == ((words,) if words else ())
        two = words.replace("plane 0", "planes 1 to 2")
        assert computed_words([None, record, record]) == ((two,) if words else ())


def test_each_simulated_plane_says_how_it_was_computed(tmp_path: Path) -> None:
    how = {"tolerance": 0.3, "out": tmp_path / "units.h5"}
    with drain(iter_simulate_psf(small(), run=RunChoice("threads"), **how)) as H:
        assert_says_how(H)
        assert_says_how(open_psf(drain(iter_transpose_file(H, tmp_path / "HT.h5"))))


@pytest.mark.long
def test_each_plane_of_chosen_effects_says_how_it_was_computed(tmp_path: Path) -> None:
    plan = small()
    assert_says_how(simulate_psf(plan, BASE, sampling=FAST))
    with simulate_psf(plan, BASE, sampling=FAST, out=tmp_path / "file.h5") as H:
        assert_says_how(H)
        assert_says_how(open_psf(drain(iter_transpose_file(H, tmp_path / "HT.h5"))))


@pytest.mark.parametrize("run", [None, pytest.param(RunChoice("threads"), marks=pytest.mark.long)])
def test_a_plane_that_a_pass_keeps_says_how_it_was_computed_before(tmp_path: Path, run: RunChoice | None) -> None:
    with drain(iter_refine_psf(small(), tolerance=0.3, out=tmp_path / "H.h5", run=run)) as H:
        assert_says_how(H)


def test_h_names_the_lfcal_that_made_it(tmp_path: Path) -> None:
    root = Path(lfcal.__file__).parents[1]
    git = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=False)
    made = of_frames(tmp_path / "H.h5").provenance["lfcal"]
    assert made == version.full_version() and made.startswith(lfcal.__version__)
    if git.returncode == 0 and (root / ".git").exists():
        assert made == f"{lfcal.__version__}+g{git.stdout.strip()[:10]}"


def test_the_commit_is_read_from_a_checkout_of_any_form(tmp_path: Path) -> None:
    commit = "1234567890abcdef1234567890abcdef12345678"
    git = tmp_path / "main" / ".git"
    (git / "worktrees" / "w").mkdir(parents=True)
    (git / "refs" / "heads").mkdir(parents=True)
    (git / "HEAD").write_text("ref: refs/heads/main\n")
    assert version._checked_out(tmp_path / "main") == "", "no commit yet"
    (git / "packed-refs").write_text(f"# pack-refs\n{commit} refs/heads/main\n")
    assert version._checked_out(tmp_path / "main") == commit
    (git / "refs" / "heads" / "main").write_text(commit[::-1] + "\n")
    assert version._checked_out(tmp_path / "main") == commit[::-1]
    (git / "HEAD").write_text(commit)
    assert version._checked_out(tmp_path / "main") == commit, "a detached head"
    (tmp_path / "tree").mkdir()
    (tmp_path / "tree" / ".git").write_text(f"gitdir: {git / 'worktrees' / 'w'}\n")
    (git / "worktrees" / "w" / "commondir").write_text("../..\n")
    (git / "worktrees" / "w" / "HEAD").write_text("ref: refs/heads/main\n")
    assert version._checked_out(tmp_path / "tree") == commit[::-1]
    assert version._checked_out(tmp_path) == "", "no checkout"


def test_the_commit_is_read_from_an_archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert version._archived(tmp_path) == "", "none is named"
    commit = "1234567890abcdef1234567890abcdef12345678"
    (tmp_path / "_commit").write_text(f"{commit}\n")
    assert version._archived(tmp_path) == commit
    (tmp_path / "_commit").write_bytes(b"\xff" * 40)
    assert version._archived(tmp_path) == "", "not text"


@pytest.mark.long
@pytest.mark.skipif(shutil.which("uv") is None, reason="no uv")
def test_wheels_and_source_archives_name_their_commit(tmp_path: Path) -> None:
    """Also a wheel that is made from an archive inside the repository of something else."""
    root = Path(lfcal.__file__).parents[1]
    commit = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=True).stdout
    build = ["uv", "build", "-q", "-o", tmp_path]
    subprocess.run([*build, "--sdist", root], check=True)
    (archive,) = tmp_path.glob("*.tar.gz")
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    shutil.unpack_archive(archive, tmp_path, filter="data")
    subprocess.run([*build, "--wheel", tmp_path / archive.name.removesuffix(".tar.gz")], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        assert file.read("lfcal/_commit").decode().strip() == commit.strip()


def test_simulated_frames_give_counts_and_a_computed_h_shares_of_the_light() -> None:
    """H of frames of a simulated session was labelled as shares of the light."""
    plan = replace(small_plan(), period=(1, 2))
    assert light_shares(simulate_psf(plan, (), "geometric").provenance)
    frames = SimulatedCamera(plan, (Quantisation(),), level="geometric")
    found = assemble_plan(frames, plan).matrix
    assert "simulated" in found.provenance and found[0, 0, 0].max() > 1 and not light_shares(found.provenance)
