from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gui.models.page import STAGES, StageState, available_stages, stage_states
from gui.models.project import FrameSettings, RecentSessions, Session, SessionState, SimulateSettings
from gui.pages.plan.model import default_plan
from lfcal.camera import PRESETS, preset
from lfcal.errors import FileFormatError, LfcalError, StorageError


def full_state() -> SessionState:
    camera = preset("bench")
    return SessionState(
        "all of it",
        camera,
        default_plan(camera),
        FrameSettings("f", "m", "p", "d", "w", False, True, True, True),
        SimulateSettings(0.01, "wave", (("coma", "on"),)),
        "a.h5",
        "b.h5",
        "rec",
        "lf.tif",
        "v.h5",
        ((0, 1, 2), (3, 4, 5)),
        {"multiplex": {"filter": "CYMG"}},
    )


@pytest.mark.parametrize("state", [SessionState(), full_state()])
def test_json_round_trip(state: SessionState) -> None:
    assert SessionState.from_json(state.to_json()) == state


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": "lfcal-session", "version": 1}', "{" * 2000, "null"])
def test_bad_files_get_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.lfcal"
    path.write_text(text)
    session = Session(full_state())
    with pytest.raises(FileFormatError) as error:
        session.open(path)
    assert "\n" not in str(error.value)
    assert session.state == full_state(), "the old session stays"


def test_undo_redo_and_unsaved() -> None:
    session = Session()
    seen: list[tuple[str, str]] = []
    session.listen(lambda old, new: seen.append((old.name, new.name)))
    session.update("rename", name="a")
    session.update("rename", name="b")
    assert seen == [("untitled", "a"), ("a", "b")]
    assert session.unsaved and session.undo_label == "rename"
    session.undo()
    assert session.state.name == "a" and session.redo_label == "rename"
    session.undo()
    assert session.state.name == "untitled" and not session.unsaved and session.undo_label == ""
    session.undo()
    session.redo()
    session.redo()
    session.redo()
    assert session.state.name == "b"
    session.undo()
    session.update("other", psf="x.h5")
    assert session.redo_label == "", "a new change ends what could be redone"


def test_a_change_to_the_same_is_none() -> None:
    session = Session()
    session.update("nothing", name="untitled")
    assert session.undo_label == "" and not session.unsaved


def test_a_drag_is_one_step_of_undo() -> None:
    session = Session()
    for k in range(10):
        session.merge("tolerance", simulate=SimulateSettings(tolerance=0.01 * (k + 1)))
    session.undo()
    assert session.state == SessionState() and session.undo_label == ""


def test_save_open_autosave(tmp_path: Path) -> None:
    session = Session(full_state())
    session.update("rename", name="saved")
    session.save(tmp_path / "s.lfcal")
    assert not session.unsaved
    session.update("rename", name="later")
    session.autosave(tmp_path / "auto.lfcal")
    assert session.unsaved, "an autosave is not a save"
    other = Session()
    other.open(tmp_path / "s.lfcal")
    assert other.state.name == "saved" and other.path == tmp_path / "s.lfcal"
    with pytest.raises(FileFormatError, match="name"):
        Session().save()
    with pytest.raises(StorageError):
        other.save(tmp_path)
    with pytest.raises(LfcalError):
        other.open(tmp_path / "none.lfcal")


def test_recent_sessions(tmp_path: Path) -> None:
    recent = RecentSessions(tmp_path / "recent.json", limit=3)
    assert recent.paths() == []
    for name in "abcd":
        (tmp_path / name).write_text("")
        recent.add(tmp_path / name)
    recent.add(tmp_path / "b")
    assert [p.name for p in recent.paths()] == ["b", "d", "c"]
    (tmp_path / "d").unlink()
    assert [p.name for p in recent.paths()] == ["b", "c"]
    recent.store.write_text("broken")
    assert recent.paths() == []


def test_stage_states(tmp_path: Path) -> None:
    file = tmp_path / "H.h5"
    file.write_text("")
    states = stage_states(SessionState())
    assert set(states) == {s.key for s in STAGES}
    assert states["psf"] is StageState.NOTHING and states["plan"] is StageState.READY
    states = stage_states(replace(full_state(), psf=str(file)), running={"simulate"}, attention={"frames"})
    assert states["psf"] is StageState.DONE
    assert states["simulate"] is StageState.RUNNING
    assert states["frames"] is StageState.ATTENTION
    assert states["acquire"] is StageState.ATTENTION, "positions are to be recorded again"
    gone = stage_states(SessionState(psf=str(tmp_path / "gone.h5")))
    assert gone["psf"] is StageState.ATTENTION


def test_only_stages_that_exist_are_offered() -> None:
    keys = [s.key for s in available_stages()]
    assert keys == [s.key for s in STAGES if s.key in keys]
    assert {"camera", "plan", "frames", "psf"} <= set(keys)


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_has_a_default_plan(name: str) -> None:
    plan = default_plan(preset(name))
    assert len(plan.depths_um) >= 2


def test_overrides() -> None:
    settings = SimulateSettings().with_override("coma", "on").with_override("shot", "off")
    assert settings.override("coma") == "on" and settings.override("stray") == "auto"
    assert settings.with_override("coma", "auto").overrides == (("shot", "off"),)
