from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base.progress import drain
from lfcal.camera import preset
from lfcal.frames.source import Position
from lfcal.simulate import sample_recording
from lfcal_gui.pages.frames.model import (
    FrameSettings,
    Opened,
    iter_assembly,
    load_frame,
    open_imported,
    positions_words,
)
from lfcal_gui.pages.setup.model_scan import default_plan


def opened(shape: tuple[int, int, int]) -> Opened:
    source: Any = None
    return Opened(source, source, source, np.zeros(shape, np.int64), default_plan(preset("bench")))


def test_positions_stay_within_the_frames_there_are() -> None:
    """A project with fewer planes than the one shown before."""
    frames = opened((2, 3, 4))
    assert frames.place(Position(5, 9, -1)) == (1, 2, 0)
    assert frames.place(Position(1, 2, 3)) == (1, 2, 3)


def test_steps_go_line_after_line() -> None:
    frames = opened((2, 3, 4))
    assert frames.step(Position(1, 0, 3), 0, 1) == (1, 1, 0)
    assert frames.step(Position(1, 0, 0), 0, -1) == (1, 2, 3)
    assert frames.step(Position(0, 2, 1), 1, 0) == (0, 0, 1)
    seen = {Position(0, 0, 0)}
    position = Position(0, 0, 0)
    for _ in range(11):
        position = frames.step(position, 0, 1)
        seen.add(position)
    assert len(seen) == 12


def test_a_recorded_session_opens_with_its_own_plan_and_place() -> None:
    """The sample recording: cutouts that know where they lie, darks of their own, a plan of one plane."""
    other = default_plan(preset("bench"))
    opened = open_imported(str(sample_recording()), FrameSettings(), other)
    with opened.source:
        assert opened.plan != other and opened.frames.shape == (1, 19, 33) and opened.frames.min() >= 0
        loaded = load_frame(opened, Position(0, 9, 16))
        rows, columns = opened.source.shape
        top, left, nt, ns = loaded.window
        assert (top, left) == (0, 0) and (nt, ns) == (rows, columns), "the frame is the cutout"
        assert loaded.point == (rows // 2, columns // 2) and loaded.origin != (0, 0)
        assert abs(float(np.median(loaded.fixed))) < 5 < float(np.median(loaded.raw)), "its darks are subtracted"
        assert loaded.numbers.saturated == 0
        raw = open_imported(str(sample_recording()), FrameSettings(use_dark=False), other)
        np.testing.assert_array_equal(load_frame(raw, Position(0, 9, 16)).fixed, loaded.raw)
        raw.source.close()


def test_interpolation_reaches_the_assembly(tmp_path: Path) -> None:
    opened = open_imported(str(sample_recording()), FrameSettings(interpolation="cubic"), default_plan(preset("bench")))
    with opened.source:
        report = drain(iter_assembly(opened, str(tmp_path / "H.h5")))
    with report.matrix as H:
        assert H.provenance["cutout"]["interpolation"] == "cubic"


def test_masks_and_nan_reach_the_frames_of_the_window(tmp_path: Path) -> None:
    plan = default_plan(preset("bench"))
    rows, columns = plan.camera.sensor.shape
    frame = np.random.default_rng(0).normal(100, 2, (rows, columns)).astype(np.float32)
    frame[3, 4] = np.nan
    np.save(tmp_path / "y0_x0.npy", frame)
    np.save(tmp_path / "y0_x1.npy", np.nan_to_num(frame, nan=100.0))
    np.savetxt(tmp_path / "lost.dat", [[5, 6]], "%d", ",")
    options = (("mask", str(tmp_path / "lost.dat")), ("nan", "mask"))
    opened = open_imported(str(tmp_path), FrameSettings(pattern="y{y}_x{x}.npy", options=options), plan)
    with opened.source:
        found = opened.delivered.corrected.samples(0)
        assert np.argwhere(~found.valid).tolist() == [[3, 4], [5, 6]]


def test_what_tells_the_positions_is_said(tmp_path: Path) -> None:
    """After an import by log.csv the page still said "manifest.csv in the folder"."""
    assert positions_words(str(tmp_path), FrameSettings()) == "none: positions from the files"
    (tmp_path / "log.csv").write_text("file;x;y;z\n")
    for frames in (tmp_path, tmp_path / "log.csv"):
        assert positions_words(str(frames), FrameSettings()) == "log.csv, found"
    (tmp_path / "manifest.csv").write_text("file,z,y,x\n")
    assert positions_words(str(tmp_path), FrameSettings()).startswith("manifest.csv")
    assert "file names" in positions_words(str(tmp_path), FrameSettings(pattern="a{y}_{x}.tif"))
    assert "serpentine order" in positions_words(str(tmp_path), FrameSettings(order="serpentine"))
    (tmp_path / "session.json").write_text("{}")
    assert "session" in positions_words(str(tmp_path), FrameSettings())
