"""A project: its file, undo and redo, settings of pages, copies that survive a crash, recent projects."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path
from typing import Any

import pytest

from lfcal.base.errors import FileFormatError, LfcalError, StorageError
from lfcal.camera import preset
from lfcal_gui.models.autosave import UnsavedCopy, find_kept, keep, read_kept
from lfcal_gui.models.project import Hold, Project, ProjectState, RecentProjects
from lfcal_gui.models.settings import PageSettings
from lfcal_gui.models.stamp import stamp_of
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.frames.model import FrameSettings
from lfcal_gui.pages.multiplex.model import MultiplexSettings
from lfcal_gui.pages.reconstruct.model import ReconstructSettings
from lfcal_gui.pages.setup.model_scan import default_plan
from lfcal_gui.pages.simulate.model import SimulateSettings


def full_state() -> ProjectState:
    camera = preset("bench")
    settings = {"multiplex": {"filter": "CYMG"}, "frames": FrameSettings("m", "p", "d", "w", False).to_dict()}
    paths = ("f", "a.h5", "b.h5", "rec", "lf.tif", "v.h5")
    return ProjectState("all of it", camera, default_plan(camera), settings, *paths, ((0, 1, 2), (3, 4, 5)))


def test_files_of_the_old_format_open() -> None:
    """As written by the first version, when two pages' settings stood beside the others'."""
    camera = preset("bench")
    old = {
        **{"format": "lfcal-session", "version": 1, "name": "old", "camera": camera.to_dict(), "plan": None},
        "frames": {
            **{"folder": "/data/frames", "manifest": "", "pattern": "", "dark": "/data/dark", "white": ""},
            **{"use_dark": True, "use_white": False, "use_defects": False, "use_background": True},
            "interpolation": "nearest",
        },
        "simulate": {"tolerance": 0.01, "level": "wave", "overrides": [["coma", "on"]]},
        **{"psf": "H.h5", "reference": "", "recording": "rec", "light_field": "", "volume": "", "redo": [[0, 1, 2]]},
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


PROJECT = '{"format": "lfcal-project", "version": %s}'
DAMAGED = ("", "[]", "{}", PROJECT % 1, PROJECT % 99, '{"format": "lfcal-session", "version": 1, "frames": 3}', "null")


@pytest.mark.parametrize("text", [*DAMAGED, "{" * 2000])
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
    data = {**json.loads(full_state().to_json()), "psf": psf}
    state = ProjectState.from_json(json.dumps(data))
    (line,) = state.refused
    assert line.startswith("psf: project: psf: expected a path of at most 4095") and "\n" not in line
    assert state.psf == "" and stamp_of(psf) is None


BAD: tuple[tuple[str, Any], ...] = (("camera", {"name": "x"}), ("plan", 3), ("redo", [1]), ("settings", 3))


@pytest.mark.parametrize(("name", "value"), [*BAD, ("volume", "a\0b"), ("plan", {"camera": {}})])
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
    project.update("nothing", name="untitled")
    assert project.undo_label == "" and not project.unsaved, "a change to the same is none"
    project.update("rename", name="a")
    project.update("rename", name="b")
    assert seen == [("untitled", "a"), ("a", "b")]
    assert project.unsaved and project.undo_label == "rename"
    project.undo()
    assert project.state.name == "a" and project.redo_label == "rename"
    project.undo()
    assert project.state.name == "untitled" and not project.unsaved and project.undo_label == ""
    project.undo()
    for _ in range(3):
        project.redo()
    assert project.state.name == "b"
    project.undo()
    project.update("other", psf="x.h5")
    assert project.redo_label == "", "a new change ends what could be redone"


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


KINDS = (AcquireSettings, FrameSettings, MultiplexSettings, ReconstructSettings, SimulateSettings)
CHANGED: dict[type[PageSettings], PageSettings] = {
    AcquireSettings: AcquireSettings(darks=3, bracket=(1.0, 0.5), device_options=(("optics", "wave"),)),
    FrameSettings: FrameSettings(dark="d", use_white=False),
    MultiplexSettings: MultiplexSettings(compared=("MURA",), gain=2.0),
    ReconstructSettings: ReconstructSettings("rl-tv", region=(0, 0, 20, 30)),
    SimulateSettings: SimulateSettings(0.01, "wave", (("coma", "on"),)),
}


def test_what_one_value_is_refused_for_leaves_the_others() -> None:
    settings = ReconstructSettings(region=(0, 0, 20, 30))
    assert "iterations" in settings.why_not("iterations", -1)
    assert settings.why_not("iterations", 3) == ""
    assert settings.changed("iterations", 3) == replace(settings, iterations=3)


class Free:
    """A claim that is given, or not."""

    held: tuple[str, ...] = ()

    def __init__(self, path: Path) -> None:
        self.path, self.ours = path, False

    def take(self) -> bool:
        self.ours = self.path.name not in self.held
        return self.ours

    def release(self) -> None:
        self.ours = False


def kept_of(folder: Path, name: str = "a", path: Path | None = None) -> UnsavedCopy:
    project = Project(ProjectState("before"), path)
    project.update("rename", name=name)
    keep(project, folder / f"{name}.lfcal")
    assert project.unsaved, "a copy is no save"
    return read_kept(folder / f"{name}.lfcal")


def test_which_is_newer(tmp_path: Path) -> None:
    own = tmp_path / "own" / "p.lfcal"
    Project(ProjectState("on disk")).save(own)
    kept = kept_of(tmp_path, path=own)
    os.utime(kept.file, (1000, 2000))
    os.utime(own, (1000, 1999))
    kept = read_kept(kept.file)
    assert kept.newer and kept.path == own and "older than the copy" in " ".join(kept.words())
    os.utime(own, (1000, 2001))
    kept = read_kept(kept.file)
    assert not kept.newer and kept.path is None and "newer than the copy" in " ".join(kept.words())
    assert kept.on_disk.name == "on disk"
    own.write_text("damaged")
    kept = read_kept(kept.file)
    assert kept.newer and kept.on_disk is None, "a damaged file is no reason not to ask"


def test_only_copies_of_dead_windows_with_changes_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "autosave"
    folder.mkdir()
    old, new = kept_of(folder, "old"), kept_of(folder, "new")
    os.utime(old.file, (1000, 1000))
    alive = kept_of(folder, "alive")
    own = tmp_path / "p.lfcal"
    same = kept_of(folder, "same", own)
    Project(same.state).save(own)
    (folder / "broken.lfcal").write_text("{")
    monkeypatch.setattr(Free, "held", ("alive.lfcal",))
    found = find_kept(folder, Free)
    assert [kept.state.name for kept, _ in found] == ["new", "old"]
    assert all(claim.ours for _, claim in found)  # type: ignore[attr-defined]
    assert alive.file.exists() and new.file.exists()
    assert not same.file.exists(), "the project holds it already"
    assert (folder / "broken.damaged").exists(), "put aside, not deleted, and not asked about again"


@pytest.mark.parametrize("kind", KINDS)
def test_settings_survive_a_saved_project_and_damaged_ones_take_defaults(kind: type[PageSettings]) -> None:
    others = {"not-installed": {"deep": [1, {"x": None}], "text": "kept"}}
    state = ProjectState(settings=others)
    changed = CHANGED[kind]
    again = ProjectState.from_json(replace(state, settings=changed.into(state)).to_json())
    assert kind.of(again) == changed != kind()
    assert again.settings["not-installed"] == others["not-installed"]
    back = ProjectState.from_json(again.to_json())
    assert back.settings == again.settings, "a second load and save changes nothing"
    for damaged in (None, 3, "text", [], {}, {"unknown": 1}):
        assert kind.from_dict(damaged) == kind()
    for f in fields(kind):
        wrong = {f.name: {"no": "such"}} if f.default is not None else {f.name: "no number"}
        assert kind.from_dict(json.loads(json.dumps(wrong))) == kind() or f.default is None
    with pytest.raises(FrozenInstanceError):
        setattr(changed, fields(kind)[0].name, changed)
    assert len({kind.page for kind in KINDS}) == len(KINDS)


def test_a_saved_project_equals_the_one_that_is_open() -> None:
    for state in (ProjectState(), full_state()):
        assert ProjectState.from_json(state.to_json()) == state


def test_what_is_dragged_or_typed_is_one_step_of_undo_and_none_when_it_is_taken_back() -> None:
    project = Project()
    project.update("rename", name="a")
    for name in ("b", "bc"):
        project.merge("typing", name=name)
    assert project.before("typing").name == "a" and project.before("other").name == "bc"
    project.merge("typing", name="a")
    assert project.undo_label == "rename" and project.before("typing").name == "a"
    for k in range(10):
        settings = SimulateSettings(tolerance=0.01 * (k + 1))
        project.merge("tolerance", settings=settings.into(project.state))
    project.undo()
    assert project.state == ProjectState("a") and project.undo_label == "rename"


def test_a_copy_opens_as_its_project_and_says_what_it_holds(tmp_path: Path) -> None:
    kept = kept_of(tmp_path, path=tmp_path / "p.lfcal")
    assert kept.project == str(tmp_path / "p.lfcal") and kept.state.name == "a" and kept.newer
    other = Project()
    other.open(kept.file)
    assert other.state == kept.state
    (tmp_path / "x.lfcal").write_text("[]")
    with pytest.raises(FileFormatError):
        read_kept(tmp_path / "x.lfcal")
    (tmp_path / "y.lfcal").write_text(ProjectState("plain").to_json())
    assert read_kept(tmp_path / "y.lfcal").project == ""
    camera = preset("bench")
    state = ProjectState("n", camera, default_plan(camera), psf="/data/H.h5", recording="/data/rec")
    unsaved = UnsavedCopy(tmp_path / "x", state, "", 0.0)
    words = "\n".join(unsaved.words())
    assert all(one in words for one in (camera.name, "positions", "/data/H.h5", "/data/rec"))
    assert "never saved" in unsaved.name()
