from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest

from lfcal.base.errors import FileFormatError, LfcalError, StorageError
from lfcal.camera import preset
from lfcal_gui.models.project import Hold, Project, ProjectState, RecentProjects
from lfcal_gui.models.stamp import stamp_of
from lfcal_gui.pages.frames.model import FrameSettings
from lfcal_gui.pages.setup.model_scan import default_plan
from lfcal_gui.pages.simulate.model import SimulateSettings


def full_state() -> ProjectState:
    camera = preset("bench")
    return ProjectState(
        "all of it",
        camera,
        default_plan(camera),
        {"multiplex": {"filter": "CYMG"}, "frames": FrameSettings("m", "p", "d", "w", False).to_dict()},
        "f",
        "a.h5",
        "b.h5",
        "rec",
        "lf.tif",
        "v.h5",
        ((0, 1, 2), (3, 4, 5)),
    )


@pytest.mark.parametrize("state", [ProjectState(), full_state()])
def test_json_round_trip(state: ProjectState) -> None:
    assert ProjectState.from_json(state.to_json()) == state


def test_files_of_the_old_format_open() -> None:
    """As written by the first version, when two pages' settings stood beside the others'."""
    camera = preset("bench")
    old = {
        "format": "lfcal-session",
        "version": 1,
        "name": "old",
        "camera": camera.to_dict(),
        "plan": None,
        "frames": {
            "folder": "/data/frames",
            "manifest": "",
            "pattern": "",
            "dark": "/data/dark",
            "white": "",
            "use_dark": True,
            "use_white": False,
            "use_defects": False,
            "use_background": True,
            "interpolation": "nearest",
        },
        "simulate": {"tolerance": 0.01, "level": "wave", "overrides": [["coma", "on"]]},
        "psf": "H.h5",
        "reference": "",
        "recording": "rec",
        "light_field": "",
        "volume": "",
        "redo": [[0, 1, 2]],
        "extra": {"acquire": {"darks": 3}},
    }
    state = ProjectState.from_json(json.dumps(old))
    assert (state.name, state.camera, state.psf, state.recording) == ("old", camera, "H.h5", "rec")
    assert state.frames == "/data/frames" and state.redo == ((0, 1, 2),)
    expected = FrameSettings(dark="/data/dark", use_white=False, use_background=True, interpolation="nearest")
    assert FrameSettings.of(state) == expected
    assert SimulateSettings.of(state) == SimulateSettings(0.01, "wave", (("coma", "on"),))
    assert state.settings["acquire"] == {"darks": 3}
    assert json.loads(state.to_json())["format"] == "lfcal-project"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"format": "lfcal-project", "version": 1}',
        '{"format": "lfcal-project", "version": 99}',
        '{"format": "lfcal-session", "version": 1, "frames": 3}',
        "{" * 2000,
        "null",
    ],
)
def test_bad_files_get_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.lfcal"
    path.write_text(text)
    project = Project(full_state())
    with pytest.raises(FileFormatError) as error:
        project.open(path)
    assert "\n" not in str(error.value)
    assert project.state == full_state(), "the old project stays"


@pytest.mark.parametrize("psf", ["a\0b.h5", "x" * 300, "a/" * 2500 + "H.h5"])
def test_paths_that_no_file_can_have_are_refused(psf: str) -> None:
    """A project with one once opened, and every look at its pages raised an error."""
    data = {**json.loads(full_state().to_json()), "psf": psf}
    state = ProjectState.from_json(json.dumps(data))
    (line,) = state.refused
    assert line.startswith("psf: project: psf: expected a path of at most 4095") and "\n" not in line
    assert state.psf == "" and stamp_of(psf) is None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("camera", {"name": "x"}),
        ("plan", 3),
        ("redo", [1]),
        ("settings", 3),
        ("volume", "a\0b"),
        ("plan", {"camera": {}}),
    ],
)
def test_one_bad_value_loses_no_other(name: str, value: object) -> None:
    whole = full_state()
    state = ProjectState.from_json(json.dumps({**json.loads(whole.to_json()), name: value}))
    (line,) = state.refused
    assert line.startswith(f"{name}: ")
    for other in json.loads(whole.to_json()):
        if other not in (name, "format", "version"):
            assert getattr(state, other) == getattr(whole, other), other
    assert "refused" not in state.to_json() and not ProjectState.from_json(state.to_json()).refused


@pytest.mark.parametrize("start", ["//", "\\\\", "\\/", "//?/UNC/", "\\??\\UNC\\", "//./pipe/"])
def test_paths_on_network_shares_are_left_out(start: str) -> None:
    """Windows logs on at the server of any path that a program looks at."""
    share = f"{start}server/share/x"
    data = json.loads(full_state().to_json())
    data["settings"] = {"frames": {"dark": share, "strict": True, "more": [[share, "dark.tif"]]}}
    state = ProjectState.from_json(json.dumps({**data, "psf": share, "volume": "//?/C:/volume.tif"}))
    assert state.psf == "" and state.volume == "//?/C:/volume.tif"
    assert state.settings["frames"] == {"dark": "", "strict": True, "more": [["", "dark.tif"]]}
    assert sorted(state.left_out) == sorted(
        [f"psf {share}", f"settings.frames.dark {share}", f"settings.frames.more {share}"]
    )
    assert "left_out" not in state.to_json() and ProjectState.from_json(state.to_json()) == state


def test_undo_redo_and_unsaved() -> None:
    project = Project()
    seen: list[tuple[str, str]] = []
    project.listen(lambda old, new: seen.append((old.name, new.name)))
    project.update("rename", name="a")
    project.update("rename", name="b")
    assert seen == [("untitled", "a"), ("a", "b")]
    assert project.unsaved and project.undo_label == "rename"
    project.undo()
    assert project.state.name == "a" and project.redo_label == "rename"
    project.undo()
    assert project.state.name == "untitled" and not project.unsaved and project.undo_label == ""
    project.undo()
    project.redo()
    project.redo()
    project.redo()
    assert project.state.name == "b"
    project.undo()
    project.update("other", psf="x.h5")
    assert project.redo_label == "", "a new change ends what could be redone"


def test_a_change_to_the_same_is_none() -> None:
    project = Project()
    project.update("nothing", name="untitled")
    assert project.undo_label == "" and not project.unsaved


def test_a_drag_is_one_step_of_undo() -> None:
    project = Project()
    for k in range(10):
        settings = SimulateSettings(tolerance=0.01 * (k + 1))
        project.merge("tolerance", settings=settings.into(project.state))
    project.undo()
    assert project.state == ProjectState() and project.undo_label == ""


def test_save_and_open(tmp_path: Path) -> None:
    project = Project(full_state())
    project.update("rename", name="saved")
    project.save(tmp_path / "s.lfcal")
    assert not project.unsaved
    assert not project.changed_on_disk
    other = Project()
    other.open(tmp_path / "s.lfcal")
    assert other.state.name == "saved" and other.path == tmp_path / "s.lfcal"
    other.update("rename", name="other")
    other.save()
    assert project.changed_on_disk and not other.changed_on_disk
    with pytest.raises(FileFormatError, match="name"):
        Project().save()
    with pytest.raises(StorageError):
        other.save(tmp_path)
    with pytest.raises(LfcalError):
        other.open(tmp_path / "none.lfcal")


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_saving_on_a_full_disk_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, project, recent = tmp_path / "p.lfcal", Project(full_state()), RecentProjects(tmp_path / "recent.json")
    project.save(path)
    recent.add(path)
    before, listed = path.read_bytes(), recent.paths()
    project.update("rename", name="later")
    monkeypatch.setattr("lfcal.base.files.sync_file", full)
    with pytest.raises(StorageError, match="No space left on device; free some space or choose another disk"):
        project.save(path)
    assert path.read_bytes() == before and project.unsaved
    recent.add(tmp_path / "another.lfcal")  # once an error in the window, after the project itself was saved
    assert recent.paths() == listed
    assert {p.name for p in tmp_path.iterdir()} == {"p.lfcal", "recent.json"}


def test_recent_projects(tmp_path: Path) -> None:
    recent = RecentProjects(tmp_path / "recent.json", limit=3)
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


def test_what_is_typed_and_taken_back_leaves_nothing_to_undo() -> None:
    project = Project()
    project.update("rename", name="a")
    for name in ("b", "bc"):
        project.merge("typing", name=name)
    assert project.before("typing").name == "a" and project.before("other").name == "bc"
    project.merge("typing", name="a")
    assert project.undo_label == "rename" and project.before("typing").name == "a"


def test_what_is_held_stays_until_it_is_released() -> None:
    project, told = Project(), list[str]()
    project.update("settings", settings={"acquire": {"darks": 1}, "plan": {}})
    project.update("rename", name="a")
    project.hold(Hold("recording", ("recording",), ("acquire",), told.append))
    project.update("folder", recording="x")
    project.merge("folder", recording="y")
    project.update("darks", settings={"acquire": {"darks": 2}, "plan": {}})
    project.update("other page", settings={"acquire": {"darks": 1}, "plan": {"seen": True}}, name="b")
    assert project.state.recording == "" and project.state.name == "b" and told == ["recording"] * 3
    for _ in range(3):  # back to the settings, which are held
        project.undo()
    assert project.state.settings["acquire"] == {"darks": 1} and told == ["recording"] * 4
    assert project.held(ProjectState(recording="x")) == "recording"
    project.release()
    project.undo()
    assert project.state == ProjectState()
    project.hold(Hold("recording", ("recording",), (), told.append))
    project.redo()
    project.start(ProjectState(recording="z"))
    project.update("folder", recording="x")
    assert project.state.recording == "x", "another project is not held by what was at work in this one"
