from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base import FileFormatError, InputError, drain
from lfcal.camera import ScanPlan, preset
from lfcal.simulate import simulate_psf
from lfcal.simulate.effects import Bandwidth, Coma
from lfcal.simulate.effects.described import parse_effects
from lfcal.tasks import RunSettings
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.setup.model_scan import default_plan
from lfcal_gui.pages.simulate.model import SimulateSettings, matrix_task, pattern_of, read_settings, settings_text
from lfcal_gui.pages.simulate.model_effects import bar_share, read_terms, refused, verdict_of
from lfcal_gui.pages.simulate.model_frames import frame_question


def small_plan() -> ScanPlan:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[2.5, 3.0], cutout=41)
    return replace(plan, period=(2, 2))


def test_a_pattern_of_rays_and_logarithmic_bars() -> None:
    plan = default_plan(preset("bench"))
    for z in (0, len(plan.depths_um) - 1):
        found = pattern_of(plan, (z, 1, 2), (), "geometric", 0.05)
        assert found.shape == plan.cutout and found.values is not None and np.isfinite(found.values).all()
        assert found.caption.endswith("y 1, x 2: geometric")
    assert [bar_share(share) for share in (0, 1e-6, 1, 2)] == [0, 0, 1, 1]
    assert bar_share(0.01) == pytest.approx(0.6) and bar_share(0.1) == pytest.approx(0.8)


def test_a_verdict_is_the_answer_to_one_question() -> None:
    plan = small_plan()
    asked = SimulateSettings(0.3, "geometric", (("vignetting", "on"),))
    stale = verdict_of(plan, SimulateSettings(0.3, "geometric", (("vignetting", "off"),)))
    right = verdict_of(plan, asked)
    assert right.fits(plan, asked) and not stale.fits(plan, asked) and not right.fits(None, asked)
    assert {e.name for e in stale.found} != {e.name for e in right.found}


def with_coma() -> SimulateSettings:
    given = SimulateSettings(0.3, "geometric").with_magnitude("coma", "waves", 0.3, "measured")
    return given.with_magnitude("coma", "angle_rad", math.radians(40))


def test_what_is_left_out_uses_its_part_of_the_tolerance(tmp_path: Path) -> None:
    plan, settings = small_plan(), SimulateSettings(0.3, "geometric")
    verdict = verdict_of(plan, settings)
    left_out = np.array(verdict.found.left_out)
    assert (left_out > 0).all(), "the test needs effects that are left out"
    with drain(matrix_task(settings, str(tmp_path / "H.h5")).work_on(plan, RunSettings())).matrix as matrix:
        stated = matrix.facts.known()["error"]
    alone = simulate_psf(plan, verdict.found.effects, "geometric", tolerance=0.3)
    # the stated error includes effects that are left out
    assert (stated > alone.facts.known()["error"] + 0.9 * left_out).all()


def test_given_magnitudes_reach_planner_and_h(tmp_path: Path) -> None:
    plan, settings = small_plan(), with_coma()
    row = verdict_of(plan, settings).row("coma")
    before = verdict_of(plan, replace(settings, magnitudes=())).row("coma")
    assert row.on and row.effect == Coma(0.3, math.radians(40)) and row.given
    assert before is not None and not before.on and not before.given
    assert {one.field: one.mark for one in row.magnitudes} == {"waves": "measured", "angle_rad": "stated"}
    with drain(matrix_task(settings, str(tmp_path / "H.h5")).work_on(plan, RunSettings())).matrix as matrix:
        (coma,) = [e for e in matrix.provenance["simulated"]["effects"] if e["name"] == "coma"]
        assert coma == {"name": "coma", "waves": 0.3, "angle_rad": pytest.approx(math.radians(40))}
        assert matrix.provenance["effect_sources"] == {"coma": {"waves": "measured", "angle_rad": "stated"}}


def test_effects_that_are_not_installed_are_kept_and_named() -> None:
    data = {
        "overrides": [["halo", "on"]],
        "magnitudes": [["glare", "share", 0.1, "stated"], ["coma", "waves", 0.3, "stated"]],
    }
    settings = SimulateSettings.from_dict(data)
    assert settings.effects() == (Coma(0.3),)
    assert settings.to_dict()["magnitudes"] == data["magnitudes"]
    assert "Not installed, so omitted: halo, glare" in verdict_of(small_plan(), settings).unknown


def test_export_and_import_are_the_file_of_the_command_line(tmp_path: Path) -> None:
    path = tmp_path / "effects.json"
    settings = with_coma().with_override("bandwidth", "off").with_magnitude("bandwidth", "width_um", 0.02)
    path.write_text(settings_text(settings))
    choices, effects = parse_effects([str(path)])
    assert choices == {"bandwidth": "off"} and effects == (Bandwidth(0.02), Coma(0.3, math.radians(40)))
    found, words = read_settings(path, SimulateSettings(0.3, "geometric"))
    assert found == settings and words == "2 effects imported from effects.json"
    other = SimulateSettings().with_magnitude("spherical", "waves", 0.1).with_magnitude("coma", "waves", 9.0)
    merged, _ = read_settings(path, other)
    assert merged.given("spherical") and merged.given("coma") == settings.given("coma")


def test_the_effects_of_h_s_provenance_can_be_imported(tmp_path: Path) -> None:
    path = tmp_path / "effects.json"
    path.write_text(json.dumps([{"name": "lens_types"}, {"name": "finite_source", "diameter_um": None}]))
    found, _ = read_settings(path, SimulateSettings())
    assert found == SimulateSettings().with_override("finite_source", "on")
    path.write_text("{}")
    with pytest.raises(FileFormatError):
        read_settings(path, SimulateSettings())


DAMAGED: tuple[object, ...] = (
    *(
        [["coma", "waves", "large", "stated"]],
        [["coma", "waves", 0.3]],
        [["coma", "waves", 0.3, "guessed"]],
        [3],
        "coma",
    ),
    *([["coma", "size", 0.3, "stated"]], [["crosstalk", "share", 0.9, "stated"]]),
    [["zernike", "terms", [[3, 0, 0.1]], "stated"]],
)


def test_settings_survive_the_project_file_and_damaged_magnitudes_are_left_out() -> None:
    settings = with_coma().with_magnitude("zernike", "terms", ((3, 1, 0.1), (4, 0, -0.2)))
    state = ProjectState.from_json(replace(ProjectState(), settings=settings.into(ProjectState())).to_json())
    assert SimulateSettings.of(state) == settings
    assert settings.with_magnitude("coma", "waves", None).given("coma").keys() == {"angle_rad"}
    for magnitudes in DAMAGED:
        found = SimulateSettings.from_dict({"tolerance": 0.1, "magnitudes": magnitudes})
        assert found == SimulateSettings(0.1), magnitudes
    old = {"tolerance": 0.1, "level": "wave", "overrides": [["coma", "on"]]}
    assert SimulateSettings.from_dict(old) == SimulateSettings(0.1, "wave", (("coma", "on"),))
    assert SimulateSettings.from_dict({"passes": True}) == SimulateSettings(progressive=True)


def test_overrides_and_settings_that_cannot_be() -> None:
    settings = SimulateSettings().with_override("coma", "on").with_override("shot", "off")
    assert dict(settings.overrides)["coma"] == "on" and "stray" not in dict(settings.overrides)
    assert settings.with_override("coma", "auto").overrides == (("shot", "off"),)
    for changes in ({"tolerance": 0.0}, {"level": "magic"}, {"overrides": (("coma", "maybe"),)}):
        with pytest.raises(InputError):
            SimulateSettings(**changes)  # type: ignore[arg-type]


def test_effects_without_terms_or_on_frames_alone_have_their_own_verdict() -> None:
    verdict = verdict_of(small_plan(), SimulateSettings().with_override("zernike", "on"))
    row = verdict.row("zernike")
    assert row is not None and not row.on and "has no terms" in row.reason
    noise, types = verdict.row("shot_noise"), verdict.row("lens_types")
    assert noise is not None and not noise.enters_h and noise.on and noise.verdict_text().startswith("on in frames")
    assert types.enters_h and types.verdict_text().startswith("on: ")
    assert "shot_noise" not in {e.name for e in verdict.found}
    plan = ScanPlan.for_camera(preset("flfm_20x05"), depths_um=(-20.0, 20.0), cutout=101)
    asked = frame_question(verdict_of(plan, SimulateSettings()), (1, 0, 0))
    assert asked.place() == "z = 20 µm, position (0, 0)", "there is no virtual depth"


def test_values_of_effects_are_read_or_refused_in_a_line() -> None:
    verdict = verdict_of(small_plan(), SimulateSettings())
    wavefront, filters = verdict.row("zernike"), verdict.row("colour_filter")
    assert wavefront is not None and filters is not None
    (terms,), (cfa, leak) = wavefront.magnitudes, filters.magnitudes
    typed = [("4", "0", "0.1"), ("", " ", ""), ("3", "-1", "-5e-2")]
    assert read_terms("zernike", terms, typed) == ((4, 0, 0.1), (3, -1, -0.05))
    for words, match in {
        ("4", "0", ""): "row 1: a cell is empty; fill in n, m, waves",
        ("4", "1", "0.1"): "row 1: Zernike term: expected n",
        ("4.5", "0", "0.1"): "row 1",
        ("x", "0", "0.1"): "row 1: n: expected a number",
        ("4", "0", "nan"): "row 1: waves",
        ("900", "0", "1"): "row 1",
        ("1e30", "0", "1"): "row 1",
    }.items():
        with pytest.raises(InputError, match=match) as caught:
            read_terms("zernike", terms, [words])
        assert "\n" not in str(caught.value)
    assert refused("colour_filter", cfa, "GRBG") == ("GRBG", "")
    assert "letters" in refused("colour_filter", cfa, "QQ")[1]
    assert refused("colour_filter", leak, "5") == (0.05, "")
    assert "0 to 100 %" in refused("colour_filter", leak, "500")[1]
