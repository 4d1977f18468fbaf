"""Settings of all pages: the same way in and out of a project."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError, fields, replace

import pytest

from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.settings import PageSettings
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.frames.model import FrameSettings
from lfcal_gui.pages.multiplex.model import MultiplexSettings
from lfcal_gui.pages.reconstruct.model import ReconstructSettings
from lfcal_gui.pages.simulate.model import SimulateSettings

KINDS = (AcquireSettings, FrameSettings, MultiplexSettings, ReconstructSettings, SimulateSettings)
CHANGED: dict[type[PageSettings], PageSettings] = {
    AcquireSettings: AcquireSettings(darks=3, bracket=(1.0, 0.5), device_options=(("optics", "wave"),)),
    FrameSettings: FrameSettings(dark="d", use_white=False),
    MultiplexSettings: MultiplexSettings(compared=("MURA",), gain=2.0),
    ReconstructSettings: ReconstructSettings("rl-tv", region=(0, 0, 20, 30)),
    SimulateSettings: SimulateSettings(0.01, "wave", (("coma", "on"),)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_they_survive_a_saved_project_and_leave_other_pages_alone(kind: type[PageSettings]) -> None:
    others = {"not-installed": {"deep": [1, {"x": None}], "text": "kept"}}
    state = ProjectState(settings=others)
    changed = CHANGED[kind]
    again = ProjectState.from_json(replace(state, settings=changed.into(state)).to_json())
    assert kind.of(again) == changed != kind()
    assert again.settings["not-installed"] == others["not-installed"]
    back = ProjectState.from_json(again.to_json())
    assert back.settings == again.settings, "a second load and save changes nothing"


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_missing_or_damaged_takes_defaults(kind: type[PageSettings]) -> None:
    for damaged in (None, 3, "text", [], {}, {"unknown": 1}):
        assert kind.from_dict(damaged) == kind()
    for f in fields(kind):
        wrong = {f.name: {"no": "such"}} if f.default is not None else {f.name: "no number"}
        assert kind.from_dict(json.loads(json.dumps(wrong))) == kind() or f.default is None


@pytest.mark.parametrize("kind", KINDS)
def test_they_are_frozen(kind: type[PageSettings]) -> None:
    settings = kind()
    with pytest.raises(FrozenInstanceError):
        setattr(settings, fields(kind)[0].name, settings)
    assert len({kind.page for kind in KINDS}) == len(KINDS)


def test_what_one_value_is_refused_for_leaves_the_others() -> None:
    settings = ReconstructSettings(region=(0, 0, 20, 30))
    assert "iterations" in settings.why_not("iterations", -1)
    assert settings.why_not("iterations", 3) == ""
    assert settings.changed("iterations", 3) == replace(settings, iterations=3)
