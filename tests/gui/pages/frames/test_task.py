"""Frames without widgets: opened, stepped through, and assembled the same by every route."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from lfcal.base import drain
from lfcal.camera import ScanPlan, preset
from lfcal.frames import Position
from lfcal.records import rows
from lfcal.simulate import sample_recording
from lfcal.tasks import Assemble
from lfcal_gui.context import Context
from lfcal_gui.models import CommandStep, ProjectState, check_of, fields_of, options_in, shown_of
from lfcal_gui.pages.frames.model import (
    HELD,
    FrameSettings,
    Opened,
    iter_assembly,
    load_frame,
    open_imported,
    positions_words,
    task_of,
)
from lfcal_gui.pages.frames.step import step
from lfcal_gui.pages.setup.model_scan import default_plan
from tests.cli import conftest
from tests.cli.conftest import Run
from tests.gui.conftest import OpenPage

lfcal = conftest.lfcal
SAMPLE = Path(__file__).parents[4] / "sample_data" / "session"
CHOSEN = FrameSettings(
    use_white=False,
    use_background=True,
    interpolation="linear",
    options=(("cutout", (41, 31)), ("dtype", "float32"), ("pad", True), ("strict", True)),
)


def values(path: Path) -> np.ndarray:
    with h5py.File(path) as file:
        return np.asarray(file["H"][:])


def test_every_field_is_in_the_form_or_has_a_widget_of_its_own() -> None:
    names = {row.name for row in rows(Assemble)}
    assert {one.key for one in fields_of(Assemble, without=HELD)} | HELD == names
    own = {one.name for one in dataclasses.fields(FrameSettings)}
    assert {"frames", "out", "plan"} == {name for name in HELD - own if f"use_{name}" not in own}
    for field in fields_of(Assemble):
        assert field.label and field.tip.endswith((".", ")")), field.key


def test_the_form_shows_and_refuses_what_the_command_does() -> None:
    shown, check = shown_of(Assemble, CHOSEN.option_values), check_of(Assemble)
    assert (shown["cutout"], shown["dtype"], shown["pad"], shown["lost"]) == ("41, 31", "float32", True, "0.5 %")
    for key, value in shown.items():
        if key not in HELD:
            assert not check(key, value), (key, value)
    assert "expected a number > 0 and ≤ 1" in check("white_floor", 2.0)
    assert "expected rounded or float32" in check("dtype", "float16")
    assert options_in(Assemble, {"cutout": "41x31", "lost": "0.5%"}) == {"cutout": (41, 31)}
    kept, refused = FrameSettings.read({**CHOSEN.to_dict(), "options": [["lost", 0.1]], "pattern": "z{z}.png"})
    assert kept.pattern == "z{z}.png" and kept.options == () and kept.interpolation == "linear"
    assert refused == ("settings of frames: options: lost: expected cutout auto, got as planned; leave lost out",)


@pytest.fixture
def plan() -> ScanPlan:
    return ScanPlan.from_json((SAMPLE / "plan.json").read_text())


def test_the_window_its_command_and_its_python_give_the_same_bits(
    lfcal: Callable[..., Run], plan: ScanPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = dataclasses.replace(CHOSEN, dark=str(SAMPLE / "dark"))
    frames = str(SAMPLE / "frames")
    opened = open_imported(frames, settings, plan)
    report = drain(iter_assembly(opened, "window.h5"))
    report.matrix.close()
    loaded = load_frame(opened, Position(0, 9, 9))
    assert loaded.window[2:] == (41, 31) and loaded.crop is not None and loaded.crop[1].shape == (41, 31)
    opened.close()
    project = ProjectState(frames=frames, plan=plan, settings={"frames": settings.to_dict()})
    steps: list[CommandStep] = [step(project, name) for name in ("command.h5", "python.h5")]
    for name, text in steps[0].files:
        Path(name).write_text(text)
    assert lfcal(*shlex.split(shlex.join(steps[0].arguments))).code == 0
    exec(steps[1].script(), {})
    for name in ("command.h5", "python.h5"):
        np.testing.assert_array_equal(values(tmp_path / name), values(tmp_path / "window.h5"), err_msg=name)
    assert task_of(settings, frames, "H.h5").settings.cutout == (41, 31)


def test_a_file_that_is_chosen_is_kept_with_the_project(open_page: OpenPage, context: Context) -> None:
    page = open_page("frames")
    for key in ("leave_out", "fill"):
        page._edited(key, f"{key}.json")  # type: ignore[attr-defined]
        assert f"{key}.json" in context.state.to_json()
        assert FrameSettings.of(context.state).option_values[key] == Path(f"{key}.json")


def opened(shape: tuple[int, int, int]) -> Opened:
    source: Any = None
    return Opened(source, source, source, np.zeros(shape, np.int64), default_plan(preset("bench")))


def test_a_recorded_session_opens_with_its_own_plan_and_place() -> None:
    """The sample recording: cutouts with positions, its darks, and a plan of one plane."""
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


def test_positions_stay_within_the_frames_and_steps_go_line_after_line() -> None:
    frames = opened((2, 3, 4))
    assert frames.place(Position(5, 9, -1)) == (1, 2, 0) and frames.place(Position(1, 2, 3)) == (1, 2, 3)
    assert frames.step(Position(1, 0, 3), 0, 1) == (1, 1, 0)
    assert frames.step(Position(1, 0, 0), 0, -1) == (1, 2, 3)
    assert frames.step(Position(0, 2, 1), 1, 0) == (0, 0, 1)
    seen = [Position(0, 0, 0)]
    for _ in range(11):
        seen.append(frames.step(seen[-1], 0, 1))
    assert len(set(seen)) == 12
