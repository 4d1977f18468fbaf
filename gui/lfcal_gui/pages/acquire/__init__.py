"""Record > Rig: connect the devices, record a session, and follow its quality.

- ``page``: the page; ``panel``: its layout
- ``setup_tab``, ``setup_panel``: devices and live view; ``_devices``, ``_stage``, ``_measuring``: parts of it
- ``record_tab``, ``record_panel``: a recording; ``_pictures``: its pictures
- ``_after``, ``step``: what is made of a session; ``_choices``: its folder and its target
- ``_lab``: large buttons for a dark lab
- ``model``: settings; ``model_live``: live frames; ``model_station``: the devices; ``model_recorder``: a recording
  as it grows, in pictures and words; ``model_folder``: state of a session folder
"""

from __future__ import annotations

from pathlib import Path

from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state


def state(project: ProjectState) -> PageState:
    """Return the state of the page: whether a session exists, and whether positions must be recorded again."""
    if project.redo:
        return PageState.ATTENTION
    # a folder that is not there yet, or holds nothing, is where the next session goes
    begun = project.recording if _holds_something(project.recording) else ""
    return file_state(begun, ready=project.plan is not None)


def _holds_something(folder: str) -> bool:
    try:
        return bool(folder) and next(Path(folder).iterdir(), None) is not None
    except OSError:
        return False


def takes(path: str) -> bool:
    """Return whether a folder is that of a session."""
    return (Path(path) / "session.json").is_file()


PAGE = PageSpec(
    "acquire",
    "Rig",
    "Record the point source at every position",
    order=30,
    package=__name__,
    state=state,
    place="record",
    needs="lfcal.acquire",
    takes=takes,
    keys=(
        ("Ctrl+G", "type a position for the stage"),
        ("Ctrl+← → ↑ ↓", "move the stage by a step in x, y"),
        ("Ctrl+Shift+↑ ↓", "move the stage by a step in z"),
        ("Esc", "stop the stage"),
        ("F11", "dark lab view: large buttons, red on black"),
        ("F9 F6 F7 F8", "in the dark lab view: next step, start, pause, stop"),
        ("Shift+F8", "in the dark lab view: abort"),
    ),
)
