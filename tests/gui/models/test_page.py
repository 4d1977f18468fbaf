"""Pages and their states; sections of the manual."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from lfcal.camera import preset
from lfcal.judge.fault import FAULTS
from lfcal_gui.models.manual import ATLAS, manual_folder, section_of
from lfcal_gui.models.page import PAGES, PageSpec, PageState, available_pages, file_state, page_registry, page_states
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.setup.model_scan import default_plan

OWN = tuple("setup acquire frames h simulate reconstruct depth multiplex accuracy watch sessions".split())


def ready(project: ProjectState) -> PageState:
    return PageState.READY


def test_the_pages_of_the_window_in_the_order_of_the_data() -> None:
    assert PAGES.names() == OWN
    assert tuple(spec.key for spec in available_pages()) == OWN
    for spec in PAGES:
        assert spec.package == f"lfcal_gui.pages.{spec.key}" and spec.title and spec.hint


def test_finding_the_pages_loads_no_window() -> None:
    code = (
        "import sys; from lfcal_gui.models.page import PAGES, page_states\n"
        "from lfcal_gui.models.project import ProjectState\n"
        "page_states(ProjectState()); "
        "print([m for m in ('PySide6', 'pyqtgraph', 'numba', 'lfcal_gui.base_page') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_page_whose_library_part_is_missing_is_left_out() -> None:
    specs = [
        PageSpec(f"p{k}", "P", "", k, "p", ready, needs)
        for k, needs in enumerate(("", "lfcal.none.at_all", "lfcal.psf"))
    ]
    assert [spec.key for spec in available_pages(specs)] == ["p0", "p2"]


def point(name: str, value: str) -> metadata.EntryPoint:
    return metadata.EntryPoint(name, value, "lfcal.pages")


NOTES = PageSpec("notes", "Notes", "Keep notes", 45, "notes", ready)
NO_PAGE: Any = type("NoPage", (), {"name": "no_page"})()


def test_pages_of_other_distributions(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        point("notes", f"{__name__}:NOTES"),
        point("bad", f"{__name__}:NO_PAGE"),
        point("gone", "no_such_module:PAGE"),
    ]
    monkeypatch.setattr(metadata, "entry_points", lambda group: points if group == "lfcal.pages" else [])
    found = page_registry()
    assert found.names() == (*OWN[:3], "notes", *OWN[3:]), "its order puts it behind Frames"
    failures = found.failures()
    assert set(failures) == {"bad", "gone"} and "PageSpec" in failures["bad"] and "no_such_module" in failures["gone"]


def test_states_follow_from_the_project(tmp_path: Path) -> None:
    file = tmp_path / "H.h5"
    file.write_text("")
    states = page_states(ProjectState())
    ready_at_once = ("setup", "frames", "simulate", "multiplex")
    assert states == {key: PageState.READY if key in ready_at_once else PageState.NOTHING for key in OWN}
    plan = default_plan(preset("bench"))
    full = ProjectState(plan=plan, psf=str(file), frames=str(tmp_path), reference="R.h5", redo=((0, 0, 0),))
    states = page_states(full, running={"simulate"}, attention={"frames", "not installed"})
    assert states["setup"] is states["h"] is PageState.DONE
    assert states["reconstruct"] is states["accuracy"] is PageState.READY
    assert states["simulate"] is PageState.RUNNING
    assert states["frames"] is PageState.ATTENTION
    assert states["acquire"] is PageState.ATTENTION, "positions are to be recorded again"
    assert set(states) == set(OWN)
    lost = str(tmp_path / "gone.h5")
    gone = page_states(ProjectState(psf=lost, reference=lost))
    assert gone["h"] is gone["simulate"] is PageState.ATTENTION


def test_states_of_files_and_of_a_folder_for_the_next_session(tmp_path: Path) -> None:
    project = ProjectState(plan=default_plan(preset("bench")), recording=str(tmp_path / "next"))
    assert page_states(project)["acquire"] is PageState.READY
    (tmp_path / "next").mkdir()
    assert page_states(project)["acquire"] is PageState.READY, "nothing is in it yet"
    (tmp_path / "next" / "session.json").write_text("{}")
    assert page_states(project)["acquire"] is PageState.DONE
    assert file_state("", ready=True) is PageState.READY
    assert file_state("", ready=False) is PageState.NOTHING
    assert file_state(str(tmp_path), ready=False) is PageState.DONE
    assert file_state(str(tmp_path / "gone"), ready=True) is PageState.ATTENTION


def test_every_fault_has_its_section_in_the_atlas() -> None:
    text = (manual_folder() / ATLAS).read_text(encoding="utf-8")
    for name in FAULTS.names():
        section = section_of(text, name)
        assert section.count("## ") == 1 and f"`{name}`." in section and "**What to do:**" in section, name
    assert section_of("# Page\n\n## One\n\n`one`. Words.\n", "two").startswith("# Page"), "without a section: all"
