from __future__ import annotations

import os
from pathlib import Path

import pytest

from lfcal.base.errors import FileFormatError
from lfcal.camera import preset
from lfcal_gui.models.autosave import UnsavedCopy, find_kept, keep, read_kept
from lfcal_gui.models.project import Project, ProjectState
from lfcal_gui.pages.setup.model_scan import default_plan


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


def test_a_copy_knows_its_project_and_opens_as_one(tmp_path: Path) -> None:
    kept = kept_of(tmp_path, path=tmp_path / "p.lfcal")
    assert kept.project == str(tmp_path / "p.lfcal") and kept.state.name == "a" and kept.newer
    other = Project()
    other.open(kept.file)
    assert other.state == kept.state


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
    assert kept.on_disk is not None and kept.on_disk.name == "on disk"
    own.write_text("damaged")
    kept = read_kept(kept.file)
    assert kept.newer and kept.on_disk is None, "a damaged file is no reason not to ask"


def test_what_it_holds_is_said(tmp_path: Path) -> None:
    camera = preset("bench")
    state = ProjectState("n", camera, default_plan(camera), psf="/data/H.h5", recording="/data/rec")
    words = "\n".join(UnsavedCopy(tmp_path / "x", state, "", 0.0).words())
    assert camera.name in words and "positions" in words and "/data/H.h5" in words and "/data/rec" in words
    assert "never saved" in UnsavedCopy(tmp_path / "x", state, "", 0.0).name()


def test_only_copies_of_dead_windows_that_hold_something_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_file_that_is_no_copy(tmp_path: Path) -> None:
    (tmp_path / "x.lfcal").write_text("[]")
    with pytest.raises(FileFormatError):
        read_kept(tmp_path / "x.lfcal")
    state = ProjectState("plain")
    (tmp_path / "y.lfcal").write_text(state.to_json())
    assert read_kept(tmp_path / "y.lfcal").project == ""
