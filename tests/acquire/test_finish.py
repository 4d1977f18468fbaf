"""From recording to H, also of planes that are complete while others are recorded; and packing."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from lfcal.acquire.control import Control
from lfcal.acquire.finish import iter_assemble_session, iter_finish, iter_repack
from lfcal.acquire.recording.recording_file import read_layout
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session import iter_record, record
from lfcal.base.errors import FileFormatError, InputError, StorageError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, preset
from lfcal.frames.source import Position
from lfcal.psf import AssemblySettings, open_psf
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from tests.acquire.rigs import (
    CAREFUL,
    assert_same_frames,
    deceived_rig,
    frames_of,
    rig_for,
    scaled,
    small_plan,
    stopped,
)
from tests.acquire.rotting import rot_frame

PLAN = small_plan()
EXACT = AssemblySettings(strict=True, dtype="float32")


def session(folder: Path, plan: ScanPlan = PLAN) -> Path:
    record(folder, plan, rig_for(plan), CAREFUL)
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return session(tmp_path_factory.mktemp("whole") / "s")


def test_h_is_the_recorded_cutouts(whole: Path, tmp_path: Path) -> None:
    report = drain(iter_assemble_session(whole, tmp_path / "H.h5", settings=EXACT))
    assert report.frames == 27 and report.residual_px == (0.0, 0.0)
    with open_psf(tmp_path / "H.h5") as matrix:
        assert matrix.shape == (3, 3, 3, 21, 21) and np.allclose(matrix.depths, PLAN.depths_um)
        for (z, y, x), frame in frames_of(whole).items():
            assert np.array_equal(matrix[z, y, x], frame - np.float32(64)), "less the black level of the plan"


def test_sub_pixel_anchors_are_interpolated_from_the_margin(tmp_path: Path) -> None:
    """A source half a pixel off the grid: with interpolation the pattern is centred again."""
    plan = ScanPlan(PLAN.camera, (3, 3), (21, 21), PLAN.depths_um, (48.5, 47.75))
    folder = session(tmp_path / "s", plan)
    nearest = drain(iter_assemble_session(folder)).matrix
    moved = drain(iter_assemble_session(folder, settings=AssemblySettings(interpolation="cubic"))).matrix
    rows = np.arange(21) - 10.0

    def centroid(pattern: np.ndarray) -> float:
        light = pattern.astype(float)
        return float((light.sum(axis=1) * rows).sum() / light.sum())

    shift = [centroid(moved[0, y, x]) - centroid(nearest[0, y, x]) for y in range(3) for x in range(3)]
    assert np.mean(shift) == pytest.approx(-0.5, abs=0.05)


def test_a_complete_plane_is_assembled_while_the_next_is_recorded(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    opened = []
    for progress in iter_record(folder, PLAN, rig_for(PLAN), CAREFUL):
        if 9 < progress.done < 18 and not opened:
            opened.append(
                drain(iter_assemble_session(folder, planes=[0], settings=AssemblySettings(strict=True))).matrix
            )
    whole = drain(iter_assemble_session(folder)).matrix
    assert opened[0].shape == (1, 3, 3, 21, 21)
    assert np.array_equal(opened[0][0], whole[0])
    assert np.array_equal(opened[0].depth_sum(0), whole.depth_sum(0))
    with RecordingSource(folder, planes=[2, 0]) as source:
        assert {source.info(k).position.z for k in range(len(source))} == {0, 1}
        assert source.info(0).position == Position(1, 0, 0)


def test_packing_keeps_every_frame_and_note(tmp_path: Path) -> None:
    folder = session(tmp_path / "s", small_plan((4, 4), 2, cutout=(41, 41)))
    before = frames_of(folder)
    with h5py.File(folder / "recording.h5", "r", locking=False) as file:
        records = file["records"][...]
    packed = drain(iter_finish(folder))
    assert packed.bytes_gained > 0 and not packed.left
    layout = read_layout(folder / "recording.h5")
    assert not layout.in_place
    assert_same_frames(frames_of(folder), before)
    with h5py.File(folder / "recording.h5", "r") as file:
        assert np.array_equal(file["records"][...], records)
        assert file["frames"].chunks == (1, 41, 41)
        assert np.array_equal(file["frames"][5], before[0, 1, 1])
    assert drain(iter_finish(folder)) == (0, ())
    assert sorted(p.name for p in folder.iterdir()) == ["recording.h5", "session.json", "session.lock"]


def test_packing_names_a_damaged_frame_and_leaves_the_recording(whole: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(whole, tmp_path / "s"))
    path = folder / "recording.h5"
    rot_frame(path, 4)
    raw = path.read_bytes()
    with pytest.raises(FileFormatError, match=r"recording\.h5\[4\]: .*record it again"):
        drain(iter_repack(path))
    packed = drain(iter_finish(folder))
    assert path.read_bytes() == raw and len(list(folder.iterdir())) == 3
    assert packed.bytes_gained == 0 and packed.left[0].startswith("recording.h5 is not packed: recording.h5[4]: ")
    damaged = r"recording\.h5\[4\], \(z, y, x\) = \(0, 1, 1\): .*--skip-damaged"
    with RecordingSource(folder) as source, pytest.raises(FileFormatError, match=damaged):
        source.read(4)


def test_unfinished_recordings_and_those_in_use_are_not_packed(tmp_path: Path) -> None:
    stopped(tmp_path / "s", PLAN, 1)
    assert drain(iter_finish(tmp_path / "s")) == (0, ())
    assert read_layout(tmp_path / "s" / "recording.h5").in_place
    report = drain(iter_assemble_session(tmp_path / "s"))
    assert len(report.missing) == 27 - report.frames
    with pytest.raises(InputError, match="missing"):
        drain(iter_assemble_session(tmp_path / "s", settings=EXACT))

    def pack(*_: object) -> None:
        with pytest.raises(StorageError, match="no other program records"):
            drain(iter_finish(tmp_path / "t"))

    record(tmp_path / "t", PLAN, rig_for(PLAN), CAREFUL, observers=(pack,))


def test_positions_of_a_packed_session_are_recorded_again_into_another_file(whole: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(whole, tmp_path / "s"))
    drain(iter_finish(folder))
    outcome = record(folder, PLAN, rig_for(PLAN), CAREFUL, resume=True)
    assert (outcome.how, outcome.acknowledged) == ("complete", 27), "nothing is left to record"
    record(folder, PLAN, rig_for(PLAN, seed=3), CAREFUL, redo=[Position(1, 1, 1)])
    drain(iter_finish(folder))
    with RecordingSource(folder) as source:
        assert [source.info(k).label for k in range(27) if "002" in source.info(k).label] == ["recording-002.h5[0]"]


def test_an_empty_session_says_so(tmp_path: Path) -> None:
    control = Control()
    control.stop()
    record(tmp_path, PLAN, rig_for(PLAN), CAREFUL, control=control)
    with pytest.raises(InputError, match="record the session first"):
        RecordingSource(tmp_path)


def test_resampled_plans_are_recorded_with_what_resampling_needs(tmp_path: Path) -> None:
    camera = replace(preset("bench"), sensor=replace(preset("bench").sensor, shape=(160, 160)))
    plan = ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=21, resample=True)
    folder = session(tmp_path / "s", plan)
    report = drain(iter_assemble_session(folder, settings=AssemblySettings(strict=True)))
    assert report.matrix.shape == plan.shape
    with RecordingSource(folder) as source:
        assert min(source.shape) >= 21 + 2 * 12


def test_frames_of_the_simulated_camera_pass_through_a_session(tmp_path: Path) -> None:
    """The optics of the simulator, seen by the simulated camera and recorded, are the frames simulated directly."""
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0])
    plan = replace(plan, period=(2, 3))
    simulated = SimulatedCamera(plan, (), level="geometric")
    record(tmp_path, plan, rig_for(plan, optics=simulated), CAREFUL)
    gain, black = plan.camera.sensor.electrons_per_count, plan.camera.sensor.black_level
    with RecordingSource(tmp_path) as source:
        for k in range(len(source)):
            index = next(i for i in range(len(simulated)) if simulated.info(i).position == source.info(k).position)
            row, column = source.info(k).origin
            light = simulated.light(index)[row : row + source.shape[0], column : column + source.shape[1]] / gain
            noise = np.sqrt(light / gain + 4.0)
            error = (source.read(k) - black - light) / noise
            assert abs(float(error.mean())) < 0.2
            assert float(error.std()) < 1.6


def test_a_session_with_a_reversed_axis_makes_no_h(tmp_path: Path) -> None:
    plan = small_plan((7, 9), 1, cutout=(31, 31))
    rig = deceived_rig(plan, scaled(-1.0, 1.0, 1.0))
    record(tmp_path / "s", plan, rig, replace(CAREFUL, origin_tolerance_px=None))
    with pytest.raises(InputError, match="expected an image that moves as planned"):
        drain(iter_assemble_session(tmp_path / "s", tmp_path / "H.h5"))
    assert not (tmp_path / "H.h5").exists()
