"""Frames that lie otherwise than the plan says: told on the page, turned on request, kept with H."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal.base import InputError, drain
from lfcal.cli._app import build_app
from lfcal.frames import ORIENTATIONS, Position, open_frames
from lfcal.psf import FoundOrientation, open_psf
from lfcal_gui.context import Context
from lfcal_gui.pages.frames.model import FrameSettings, iter_assembly, load_frame, open_imported
from lfcal_gui.pages.frames.orientation import CHOICES, advice, refusal
from tests.frames.test_orientation import NUMPY
from tests.gui.waiting import GUARD_MS
from tests.psf.test_orientation import a_plan, upright

PLAN = a_plan((60, 72), (7, 9), (18.0, 20.0), 2, (25, 25))


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a scan whose frames are mirrored left to right, with its dark."""
    folder = tmp_path_factory.mktemp("mirrored")
    frames, places = upright(PLAN, width=5.0, noise=2.0)
    (folder / "frames").mkdir()
    (folder / "dark").mkdir()
    rows = ["file,z,y,x"]
    for frame, place in zip(frames, places, strict=True):
        name = f"z{place.z}_y{place.y}_x{place.x}.npy"
        np.save(folder / "frames" / name, np.rint(NUMPY["mirror x"](frame)).astype(np.uint16))
        rows.append(f"{name},{place.z},{place.y},{place.x}")
    (folder / "frames" / "manifest.csv").write_text("\n".join(rows) + "\n")
    np.save(folder / "dark" / "dark.npy", np.full(frames.shape[1:], 100, np.uint16))
    (folder / "plan.json").write_text(PLAN.to_json())
    return folder


def shown(qtbot: QtBot, page: Any, words: str) -> None:
    qtbot.waitUntil(lambda: page.notice.isVisible() and words in page.notice.label.text(), timeout=GUARD_MS)


def settled(qtbot: QtBot, context: Context) -> None:
    qtbot.waitUntil(lambda: not context.jobs.busy, timeout=GUARD_MS)


def assembled(qtbot: QtBot, context: Context, page: Any, out: Path) -> dict[str, Any]:
    """Assemble on the page, and return what H keeps of the orientation."""
    page.assemble(str(out))
    qtbot.waitUntil(lambda: context.state.psf == str(out), timeout=GUARD_MS)
    settled(qtbot, context)
    with open_psf(out) as matrix:
        return dict(matrix.provenance["orientation"])


def commanded(folder: Path, out: Path, choice: str) -> dict[str, Any]:
    """Assemble as the command does, and return what H keeps of the orientation."""
    arguments = ["assemble", folder / "frames", "--dark", folder / "dark", "-o", out, "--orientation", choice]
    build_app()([str(part) for part in arguments], standalone_mode=False)
    with open_psf(out) as matrix:
        return dict(matrix.provenance["orientation"])


def test_the_page_turns_mirrored_frames(
    qtbot: QtBot, context: Context, open_page: Any, mirrored: Path, tmp_path: Path
) -> None:
    page = open_page("frames")
    page.open_folder(str(mirrored))
    shown(qtbot, page, "mirrored")
    assert page.notice.label.text() == "The frames are mirrored left to right."
    assert page.notice.button.text() == "Turn upright (mirror x)"
    page.notice.button.click()
    qtbot.waitUntil(lambda: page.opened is not None and page.found is not None, timeout=GUARD_MS)
    assert not page.notice.isVisible()
    assert FrameSettings.of(context.state).orientation == "mirror x"
    assert page.panel.choices.editor("orientation").currentData() == "mirror x"
    assert assembled(qtbot, context, page, tmp_path / "H.h5") == {"applied": "mirror x", "found": None}
    assert commanded(mirrored, tmp_path / "C.h5", "mirror-x") == {"applied": "mirror x", "found": None}
    with open_psf(tmp_path / "H.h5") as ours, open_psf(tmp_path / "C.h5") as theirs:
        assert np.array_equal(np.asarray(ours), np.asarray(theirs))
    context.project.undo()
    context.project.undo()
    assert FrameSettings.of(context.state).orientation == "check"


def test_mirrored_frames_make_no_h(
    qtbot: QtBot, context: Context, open_page: Any, mirrored: Path, tmp_path: Path
) -> None:
    page, out = open_page("frames"), tmp_path / "H.h5"
    page.open_folder(str(mirrored))
    shown(qtbot, page, "mirrored")
    page.assemble(str(out))
    assert page.notice.label.text() == "No H: the frames are mirrored left to right."
    assert not context.jobs.jobs(), "refused before any work"
    page.notice.leave.click()
    assert FrameSettings.of(context.state).orientation == "as is"
    shown(qtbot, page, "used unchanged, as chosen")
    assert not page.notice.leave.isVisible(), "nothing is asked again"
    assert assembled(qtbot, context, page, out) == {"applied": "as is", "found": None}


def test_the_job_checks_orientation(
    qtbot: QtBot, context: Context, open_page: Any, mirrored: Path, tmp_path: Path
) -> None:
    page, out = open_page("frames"), tmp_path / "H.h5"
    page.open_folder(str(mirrored))
    shown(qtbot, page, "mirrored")
    page.notice.clear()
    known, page.found = page.found, None
    page.assemble(str(out))
    page.found = known
    shown(qtbot, page, "No H: the frames are mirrored left to right.")
    settled(qtbot, context)
    (job,) = context.jobs.jobs()
    assert job.error.endswith(
        "mirrored left to right; set the orientation of the frames to mirror-x, or leave them unchanged"
    )
    assert "--" not in job.error and not out.exists() and context.state.psf == ""


def test_upright_frames_pass(qtbot: QtBot, context: Context, open_page: Any, mirrored: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(mirrored, tmp_path / "upright")
    for file in (folder / "frames").glob("*.npy"):
        np.save(file, np.fliplr(np.load(file)))
    page = open_page("frames")
    page.open_folder(str(folder))
    qtbot.waitUntil(lambda: page.found is not None, timeout=GUARD_MS)
    record = assembled(qtbot, context, page, tmp_path / "H.h5")
    assert record["found"] == "as is" and record == commanded(folder, tmp_path / "C.h5", "check")
    page.panel.choices.edited.emit("orientation", "mirror x")
    shown(qtbot, page, "The frames are upright as delivered, but the settings turn them.")
    page.notice.button.click()
    assert FrameSettings.of(context.state).orientation == "check"


def test_what_cannot_be_told_is_said_with_h(qtbot: QtBot, context: Context, open_page: Any, tmp_path: Path) -> None:
    plan = a_plan((60, 60), (1, 1), (29.0, 29.0), 2, (25, 25))
    frames, places = upright(plan, width=5.0, noise=2.0)
    (tmp_path / "frames").mkdir()
    rows = ["file,z,y,x"]
    for frame, place in zip(frames, places, strict=True):
        np.save(tmp_path / "frames" / f"{place.z}.npy", frame.astype(np.uint16))
        rows.append(f"{place.z}.npy,{place.z},{place.y},{place.x}")
    (tmp_path / "frames" / "list.csv").write_text("\n".join(rows) + "\n")
    (tmp_path / "plan.json").write_text(plan.to_json())
    said: list[str] = []
    context.message.connect(said.append)
    page = open_page("frames")
    page.open_folder(str(tmp_path / "frames"))
    qtbot.waitUntil(lambda: page.found is not None, timeout=GUARD_MS)
    page.panel.choices.edited.emit("use_background", True)
    qtbot.waitUntil(lambda: page.found is not None, timeout=GUARD_MS)
    record = assembled(qtbot, context, page, tmp_path / "H.h5")
    assert "cannot be determined" in record["note"] and f"H.h5: {record['note']}" in said


def test_a_frame_is_shown_upright_before_and_after_its_correction(mirrored: Path) -> None:
    settings = FrameSettings(dark=str(mirrored / "dark"), orientation="mirror x")
    opened = open_imported(str(mirrored / "frames"), settings, PLAN)
    loaded = load_frame(opened, Position(0, 2, 3))
    assert np.array_equal(loaded.raw - 100.0, loaded.fixed)
    with open_frames(mirrored / "frames", plan_shape=PLAN.shape[:3]) as delivered:
        index = int(opened.frames[0, 2, 3])
        assert np.array_equal(loaded.raw, np.fliplr(delivered.read(index)))


def test_turned_frames_of_a_colour_are_shown_before_their_correction(tmp_path: Path) -> None:
    sensor = replace(PLAN.camera.sensor, cfa="RGGB")
    plan = replace(PLAN, camera=replace(PLAN.camera, sensor=sensor))
    frame = np.arange(np.prod(sensor.shape), dtype=np.uint16).reshape(sensor.shape)
    even = replace(plan, period=(8, 10))
    for place in even.positions():
        np.save(tmp_path / f"z{place.z}_y{place.y}_x{place.x}.npy", np.fliplr(frame))
    settings = FrameSettings(orientation="mirror x", channel="R", use_background=True)
    opened = open_imported(str(tmp_path), settings, even)
    loaded = load_frame(opened, Position(0, 1, 1))
    assert loaded.raw.max() > loaded.fixed.max() + 100, "the background is still in it"
    assert np.array_equal(loaded.raw - np.median(loaded.raw - loaded.fixed), loaded.fixed)


def test_colours_of_the_upright_sensor_are_refused_for_turned_frames(mirrored: Path, tmp_path: Path) -> None:
    plan = replace(PLAN, camera=replace(PLAN.camera, sensor=replace(PLAN.camera.sensor, cfa="RGGB")))
    for defects in (True, False):
        settings = FrameSettings(dark=str(mirrored / "dark"), orientation="mirror x", use_defects=defects)
        work = iter_assembly(open_imported(str(mirrored / "frames"), settings, plan), str(tmp_path / "H.h5"))
        if defects:
            with pytest.raises(InputError, match="the plan's upright sensor, RGGB"):
                drain(work)
        else:
            drain(work).matrix.close()


def test_a_new_folder_starts_upright(qtbot: QtBot, context: Context, open_page: Any, mirrored: Path) -> None:
    page = open_page("frames")
    page.open_folder(str(mirrored))
    qtbot.waitUntil(lambda: page.opened is not None, timeout=GUARD_MS)
    page.panel.choices.edited.emit("orientation", "mirror x")
    copy = mirrored.parent / "again"
    shutil.copytree(mirrored, copy, dirs_exist_ok=True)
    page.open_folder(str(copy))
    qtbot.waitUntil(lambda: FrameSettings.of(context.state).orientation == "check", timeout=GUARD_MS)


def test_upright_frames_and_unknown_orientations_are_no_news_and_refusals_are_one_line() -> None:
    for found, choice in (
        (FoundOrientation(name="as is"), "check"),
        (FoundOrientation(name="as is"), "as is"),
        (FoundOrientation(reason="light in 0 of 20 frames"), "check"),
        (FoundOrientation(name="rot90", cause="frames"), "rot90"),
    ):
        assert advice(found, choice) is None, (found, choice)
    undone = advice(FoundOrientation(name="as is"), "mirror x")
    scan = advice(FoundOrientation(name="mirror x", cause="scan"), "check")
    assert (undone.apply, undone.leave) == ("check", "")
    assert (scan.apply, scan.leave) == ("", "as is")
    for cause in ("frames", "scan", "either"):
        found = FoundOrientation(name="mirror x", cause=cause)
        words = refusal(found, "check")
        assert words and "--" not in words and "\n" not in words
        assert refusal(found, "as is") == refusal(found, "mirror x") == "", "chosen by the user"
    assert refusal(FoundOrientation(name="as is"), "check") == ""
    assert {name for name, _ in CHOICES} == {"check", *ORIENTATIONS}
    for stored, taken in (("rot90", "rot90"), ("sideways", "check")):
        assert FrameSettings.from_dict({"orientation": stored}).orientation == taken
