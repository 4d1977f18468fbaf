"""``lfcal reconstruct`` of a session: recorded frames as a time series, with their place on the sensor."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session import record
from lfcal.psf import PSFMatrix, save
from tests.acquire.rigs import CAREFUL, rig_for, small_plan
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]
RL = ("--solver", "rl", "-n", 2, "--workers", 1)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
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


@pytest.mark.parametrize("by", [(), ("--executor", "threads")])
def test_frames_of_a_session_are_a_series(lfcal: Lfcal, place: Path, by: tuple[str, ...]) -> None:
    row, column = map(int, (place / "origin").read_text().split(","))
    assert (row, column) != (0, 0)
    run = lfcal("reconstruct", "H.h5", "session", *RL, *by, "-o", "v.npy")
    assert run.code == 0, run.err
    anchor = f"{50 - row},{45 - column}"
    assert lfcal("reconstruct", "H.h5", "stack.tif", *RL, "--anchor", anchor, "-o", "w.npy").code == 0
    np.testing.assert_array_equal(np.load("v.npy"), np.load("w.npy"))
    assert lfcal("reconstruct", "H.h5", "session", *RL, "-o", "out").code == 0
    assert sorted(path.name for path in Path("out").iterdir()) == [f"session_000{k}.tif" for k in range(3)]


def test_times_are_kept(lfcal: Lfcal, place: Path) -> None:
    zarr = pytest.importorskip("zarr", reason="zarr is not installed")
    assert lfcal("reconstruct", "H.h5", "session", *RL, "-o", "v.ome.zarr").code == 0
    said = dict(zarr.open_group("v.ome.zarr", mode="r").attrs)
    times = said["lfcal"]["times_s"]
    with RecordingSource(place / "session") as source:
        assert times == sorted(float(source.record(k)["elapsed_s"]) for k in range(3))
    scale = said["multiscales"][0]["datasets"][0]["coordinateTransformations"][0]["scale"]
    assert (
        scale[0] == pytest.approx((times[2] - times[0]) / 2) and said["multiscales"][0]["axes"][0]["unit"] == "second"
    )


def test_frames_that_follow_their_spots_are_no_series(lfcal: Lfcal, place: Path) -> None:
    plan = small_plan(planes=1)
    record(place / "scan", plan, rig_for(plan), CAREFUL)
    run = lfcal("reconstruct", "H.h5", "scan", *RL, "-o", "out")
    assert (
        run.code == 2 and run.err.count("\n") == 1 and "expected one position on the sensor, got 9 positions" in run.err
    )
    run = lfcal("reconstruct", "H.h5", "session", *RL, "--resample", "always", "-o", "out")
    assert run.code == 2 and "--resample: expected whole frames, got frames that start at" in run.err
    assert not Path("out").exists()


def test_a_session_is_never_replaced(lfcal: Lfcal, place: Path) -> None:
    recording = next(path for path in (place / "session").iterdir() if path.name.startswith("recording"))
    before = recording.read_bytes()
    out = recording.rename(recording.with_suffix(".h5")) if recording.suffix != ".h5" else recording
    run = lfcal("reconstruct", "H.h5", "session", *RL, "-o", out, "--force")
    assert run.code == 2 and out.read_bytes() == before
