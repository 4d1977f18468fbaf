"""One way for a frame: the same simulated frames as a folder, a stack and a recorded session give the same H."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import tifffile

from lfcal.acquire.options import Options
from lfcal.acquire.session import record
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.devices import simulated_rig
from lfcal.frames import CorrectionRecipe, Frames, FrameSource, corrected_view, open_frames
from lfcal.frames.corrections.recipe import read_average
from lfcal.psf import AssemblySettings, PSFMatrix, assemble_plan, save_regions
from lfcal.simulate import SimulatedCamera, sample_session
from lfcal.simulate.effects import Quantisation
from tests.distribution import code_of

EXACT = AssemblySettings(strict=True, dtype="float32", keep_pedestal=True)


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> tuple[ScanPlan, dict[str, Path]]:
    """Record a session with the simulator, and write the very frames it took as other files."""
    root = tmp_path_factory.mktemp("ways")
    bench = preset("bench")
    camera = replace(bench, sensor=replace(bench.sensor, shape=(120, 130)))
    plan = ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=21, exposure_s=0.02)
    plan = replace(plan, period=(3, 4))
    simulated = SimulatedCamera(plan, (Quantisation(),), level="geometric")
    options = Options(darks=2, reference_every=0)
    record(root / "session", plan, simulated_rig(plan, optics=simulated), options)
    with open_frames(root / "session") as session:
        dark = session.metadata.darks[0.02]
        full = np.zeros((plan.shape[0] * 12, *camera.sensor.shape), np.uint16)
        rng = np.random.default_rng(0)
        full[:] = rng.integers(60, 70, full.shape)
        positions = []
        for k in range(len(session)):
            info = session.info(k)
            rows, columns = (slice(a, a + n) for a, n in zip(info.origin, session.shape, strict=True))
            full[k, rows, columns] = session.read(k)
            positions.append(tuple(info.position))
    sensor_dark = np.full(camera.sensor.shape, 64, np.float32)
    top, left = dark.origin
    sensor_dark[top : top + dark.frame.shape[0], left : left + dark.frame.shape[1]] = dark.frame
    np.save(root / "dark.npy", sensor_dark)
    (root / "frames").mkdir()
    for frame, (z, y, x) in zip(full, positions, strict=True):
        cv2.imwrite(str(root / "frames" / f"z{z}_y{y}_x{x}.png"), frame)
    tifffile.imwrite(root / "stack.tif", full, photometric="minisblack")
    rows_ = "\n".join(f"stack.tif,{k},{z},{y},{x}" for k, (z, y, x) in enumerate(positions))
    (root / "stack.csv").write_text(f"file,page,z,y,x\n{rows_}\n")
    with h5py.File(root / "stack.h5", "w") as file:
        file["frames"], file["positions"] = full, np.array(positions)
    (root / "plan.json").write_text(plan.to_json())
    ways = {name: root / name for name in ("session", "frames", "stack.csv", "stack.h5", "dark.npy", "plan.json")}
    return plan, ways


def opened(ways: dict[str, Path], name: str) -> Frames:
    return open_frames(ways[name], pattern="z{z}_y{y}_x{x}.png" if name == "frames" else None)


def test_session_folder_and_stack_give_bit_equal_h(places: tuple[ScanPlan, dict[str, Path]]) -> None:
    plan, ways = places
    found = {}
    for name in ("session", "frames", "stack.csv", "stack.h5"):
        recipe = CorrectionRecipe() if name == "session" else CorrectionRecipe(dark=ways["dark.npy"])
        with opened(ways, name) as source:
            assert isinstance(source, FrameSource)
            report = assemble_plan(corrected_view(source, recipe, plan), plan, None, EXACT)
        assert (report.frames, report.saturated, report.unknown_saturation) == (12, 0, 0)
        found[name] = report.matrix
    first = np.asarray(found["session"])
    assert first.any()
    for name, matrix in found.items():
        np.testing.assert_array_equal(np.asarray(matrix), first, err_msg=name)
        assert matrix.facts.noise is not None, "the plan states the sensor's noise"
        # of the session's dark it is known that it is the mean of two, whose noise comes along; of dark.npy it is not
        share = 1 if name == "session" else 1 / 1.5
        expected = np.asarray(found["session"].facts.noise) * np.array([share, 1], np.float32)
        np.testing.assert_allclose(matrix.facts.noise, expected, rtol=1e-6)


def test_every_source_answers_everything(places: tuple[ScanPlan, dict[str, Path]]) -> None:
    plan, ways = places
    for name in ("session", "frames", "stack.csv", "stack.h5", "plan.json"):
        with opened(ways, name) as source:
            info = source.info(1)
            assert len(info.points) == 1 and info.label
            region = (slice(2, 9), slice(3, 20))
            np.testing.assert_array_equal(source.read(1, region), source.read(1)[region], err_msg=name)
            samples = source.samples(1, region)
            np.testing.assert_array_equal(samples.values, source.read(1, region))
            assert (info.origin == (0, 0)) == (name != "session"), "a session's frames know their place"
            if name in ("session", "plan.json"):
                assert info.exposure_s == 0.02 and source.metadata.plan.shape == plan.shape
                assert samples.saturated == 0
            else:
                assert info.exposure_s is None and samples.saturated is None, "unknown, not zero"


def test_a_clipped_session_is_not_called_good(tmp_path: Path) -> None:
    """Frames clipped at the end of 12 bits, stored in 16: the plan says where they end."""
    bench = preset("bench")
    camera = replace(bench, sensor=replace(bench.sensor, shape=(80, 80), bit_depth=12))
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=21), period=(2, 2))
    row, column = round(plan.anchor[0]), round(plan.anchor[1])
    (tmp_path / "frames").mkdir()
    for y in range(2):
        for x in range(2):
            r, c = np.mgrid[:80, :80]
            light = 9000 * np.exp(-((r - row - y) ** 2 + (c - column - x) ** 2) / 8.0)
            frame = np.minimum(light, 4095).astype(np.uint16)
            cv2.imwrite(str(tmp_path / "frames" / f"y{y}_x{x}.png"), frame)
    with open_frames(tmp_path / "frames", pattern="y{y}_x{x}.png") as source:
        assert source.samples(0).saturated is None, "16-bit files of which nobody knows the camera"
        report = assemble_plan(corrected_view(source, CorrectionRecipe(), plan), plan, None, EXACT)
    assert report.saturated == 4
    assert report.matrix.saturated is not None and report.matrix.saturated.min() > 0
    assert not report.matrix.valid(0, 0, 0).all()


def test_a_level_nobody_subtracts_is_refused(places: tuple[ScanPlan, dict[str, Path]]) -> None:
    plan, ways = places
    bare = replace(plan, camera=replace(plan.camera, sensor=replace(plan.camera.sensor, black_level=0.0)))
    with opened(ways, "frames") as source:
        with pytest.raises(
            InputError, match=r"plane 0: expected frames without their black level .* got a constant level"
        ):
            assemble_plan(corrected_view(source, CorrectionRecipe(), bare), bare)
        for recipe in (
            CorrectionRecipe(background="border"),
            CorrectionRecipe(black_level=64.0),
            CorrectionRecipe(dark=ways["dark.npy"]),
        ):
            assert assemble_plan(corrected_view(source, recipe, bare), bare).frames == 12
        kept = assemble_plan(corrected_view(source, CorrectionRecipe(), bare), bare, None, EXACT)
        assert kept.frames == 12, "kept when the user says so"
        said_to_be_none = corrected_view(source, CorrectionRecipe(black_level=0.0), bare)
        with pytest.raises(InputError, match="after subtracting the dark or black level"):
            assemble_plan(said_to_be_none, bare)
        assert assemble_plan(said_to_be_none, bare, None, EXACT).frames == 12
    with opened(ways, "session") as source, pytest.raises(InputError, match="subtract dark frames, the black level"):
        assemble_plan(corrected_view(source, CorrectionRecipe(dark="none"), bare), bare)


def test_what_a_source_brings_itself_is_not_asked_for(places: tuple[ScanPlan, dict[str, Path]]) -> None:
    _, ways = places
    options: dict[str, Any] = {"pattern": "x{x}.png", "order": "raster", "manifest": ways["stack.csv"]}
    for name, what in (("session", "recorded session"), ("plan.json", "simulated camera of a plan")):
        for option, value in options.items():
            words = f"{what}: expected no option '{option}', got .*the source defines this itself"
            with pytest.raises(InputError, match=words):
                open_frames(ways[name], **{option: value})


def test_a_cutout_beyond_the_recorded_window_says_where_it_ends(places: tuple[ScanPlan, dict[str, Path]]) -> None:
    plan, ways = places
    wide = replace(EXACT, cutout=(61, 61))
    with opened(ways, "session") as source:
        view = corrected_view(source, CorrectionRecipe(), plan)
        with pytest.raises(InputError, match=r"cutout of recording\.h5\[0\].*expected rows \d+\.\.\d+, columns"):
            assemble_plan(view, plan, None, wide)
        small = assemble_plan(view, plan, None, replace(EXACT, cutout=(11, 13))).matrix
        whole = assemble_plan(view, plan, None, EXACT).matrix
        np.testing.assert_array_equal(np.asarray(small), np.asarray(whole)[..., 5:16, 4:17])


# -- examples of the documentation -------------------------------------------------------------------------------------


@pytest.mark.long
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
