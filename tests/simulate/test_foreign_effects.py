"""Effects of other packages: the documented one is complete, and broken ones are left out with a reason."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.cli import main
from lfcal.simulate import effects as rooms
from lfcal.simulate import expose, outlook_of, plan_effects, simulate_psf
from lfcal.simulate.effects import LensTypeDefocus, ShotNoise, find_effects, registered
from tests.distribution import code_of, in_a_new_process, install
from tests.simulate.common import BASE, FAST, difference, responses, small_camera, small_plan

PAGE = code_of("extending.md", "An effect")
Install = Callable[[str, str], None]


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install an effect of another package for one test."""

    def put(source: str, name: str) -> None:
        install(monkeypatch, tmp_path, "their_effects", source, {"lfcal.effects": f"theirs = their_effects:{name}"})
        found = find_effects()
        for home in (rooms, registered):
            monkeypatch.setattr(home, "CATALOGUE", found)

    return put


def test_the_documented_effect_is_planned_and_enters_h(foreign: Install) -> None:
    foreign(PAGE[0], "ArrayDecentre")
    plan = replace(small_plan(cutout=41), period=(2, 3))
    row = plan_effects(plan, 0.03).row("array_decentre")
    assert not row.on and "unknown for this camera" in row.reason
    switched = plan_effects(plan, 0.03, {"array_decentre": "on"})
    plain = simulate_psf(plan, plan_effects(plan, 0.03), sampling=FAST)
    decentred = simulate_psf(plan, switched, sampling=FAST)
    assert difference(plain.plane(0), decentred.plane(0)) > 0.02
    names = {"plan": plan, "plan_effects": plan_effects, "simulate_psf": simulate_psf}
    exec(f"from their_effects import *\n{PAGE[1]}", names)  # the second block of the page, unchanged
    known: Any = names["H"]
    recorded = known.provenance["simulated"]["effects"]
    assert {"name": "array_decentre", "rows_um": 2.0, "columns_um": 0.0} in recorded


def test_the_documented_effect_does_what_it_says(foreign: Install) -> None:
    """It equals a camera described with its lenslets there, and its estimate holds."""
    foreign(PAGE[0], "ArrayDecentre")
    effect = find_effects().get("array_decentre")(rows_um=3.0, columns_um=-1.0)
    plan = small_plan()
    camera, s = plan.camera, plan.camera.lattice_scale
    x, y = camera.lattice.offset_um
    moved = replace(camera, lattice=replace(camera.lattice, offset_um=(x - 1.0 * s, y + 3.0 * s)))
    found = responses(plan, (*BASE, effect))
    assert difference(responses(replace(plan, camera=moved), BASE), found) < 1e-4
    measured = difference(responses(plan, BASE), found)
    assert 0.5 * measured <= effect.estimate(outlook_of(plan, 0)).error <= 2 * measured


def test_the_command_line_lists_it(foreign, monkeypatch, capfd):
    foreign(PAGE[0], "ArrayDecentre")
    words = ["simulate", "bench", "--virtual-depths", "4", "--plan-only", "--json", "--effect", "array_decentre=on"]
    monkeypatch.setattr(sys, "argv", ["lfcal", *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code and '"array_decentre"' in capfd.readouterr().out


@pytest.mark.long
def test_the_window_lists_it(foreign, tmp_path):
    foreign(PAGE[0], "ArrayDecentre")
    code = """
from lfcal_gui.pages.simulate.model import SimulateSettings
from lfcal_gui.pages.simulate.model_effects import verdict_of
from tests.simulate.common import small_plan
settings = SimulateSettings(overrides=(("array_decentre", "on"),))
print(*(row.name for row in verdict_of(small_plan(), settings).rows if row.on))
"""
    assert "array_decentre" in in_a_new_process(tmp_path, code).split()


SHOWN = PAGE[0].replace("ArrayDecentre", "effect")
ABSTRACT = "from lfcal.simulate.effects import SceneEffect\nclass effect(SceneEffect):\n    name = title = 'theirs'"

BROKEN = {
    "nameless": ("def effect(): ...", "expected a part with a name"),
    "no effect": ("class effect:\n    name = 'theirs'", "expected a class derived from Effect"),
    "abstract": (ABSTRACT, "lacks the methods estimate"),
    "not frozen": (SHOWN.replace("frozen=True, ", ""), "expected a frozen dataclass"),
    "no title": (SHOWN.replace("    title:", "    subtitle:"), "lacks a title"),
    "no defaults": (SHOWN.replace("float = 1.0", "float"), "rows_um"),
    "estimate fails": (SHOWN.replace("outlook.pixel_um", "outlook.pixels_um"), "pixels_um"),
    "no estimate": (
        SHOWN.replace('return Estimate(shift, "px", ', 'return (shift, "px", '),
        "did not return an Estimate",
    ),
    "does not load": ("raise RuntimeError('their library is missing')", "their library is missing"),
}


@pytest.mark.parametrize(("source", "reason"), BROKEN.values(), ids=BROKEN)
def test_broken_effects_are_left_out_with_a_reason(foreign: Install, source: str, reason: str) -> None:
    own = find_effects().names()
    foreign(source, "effect")
    assert rooms.CATALOGUE.names() == own
    assert reason in rooms.CATALOGUE.failures()["theirs"]


def test_the_command_line_names_broken_effects(foreign, monkeypatch, capfd):
    foreign(BROKEN["no title"][0], "effect")
    monkeypatch.setattr(sys, "argv", ["lfcal", "simulate", "bench", "--virtual-depths", "4", "--plan-only"])
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code and "effect theirs" in capfd.readouterr().err


HOT = """
from dataclasses import dataclass
from typing import ClassVar
from lfcal.simulate.effects import Estimate, FrameEffect

@dataclass(frozen=True)
class Flicker(FrameEffect):
    name: ClassVar[str] = "flicker"
    title: ClassVar[str] = "flicker"
    rank: ClassVar[int] = 60
    pattern: str = "blemish"

    def estimate(self, outlook):
        return Estimate(1.0, "e-", 0.1, "measured")

    def on_frame(self, strip, view):
        strip += 20 * view.rng.random(strip.shape) + view.pattern(self.pattern)
        return strip
"""


def test_a_foreign_frame_effect_has_its_own_random_numbers(foreign: Install) -> None:
    """Its rank is that of shot noise: if ranks distinguished the streams, both would draw the same numbers."""
    foreign(HOT, "Flicker")
    flicker, camera = rooms.CATALOGUE.get("flicker")(), small_camera()
    light = np.full(camera.sensor.shape, 1000.0, np.float32)

    def frame(*effects: Any, index: int = 0) -> np.ndarray:
        return expose(light, camera, effects, exposure_s=0.01, seed=3, index=index).astype(float)

    plain, noise, own = frame(), frame(ShotNoise()), frame(flicker)
    assert abs(np.corrcoef((noise - plain).ravel(), (own - plain).ravel())[0, 1]) < 0.05
    repeated = np.corrcoef((own - plain).ravel(), (frame(flicker, index=1) - plain).ravel())[0, 1]
    assert 0.015 < repeated < 0.06, "the pattern is fixed from frame to frame, the noise is not"
    plan = small_plan(cutout=31)
    row = plan_effects(plan, frames=True).row("flicker")
    assert row.on and row.seconds > 0 and not plan_effects(plan).row("flicker").on


def test_own_effects_cannot_be_replaced(foreign: Install) -> None:
    foreign(PAGE[0].replace('"array_decentre"', '"lens_types"'), "ArrayDecentre")
    assert rooms.CATALOGUE.get("lens_types") is LensTypeDefocus
