"""Effects that the camera does not describe: the sentence, and the measurements that determine them."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations
from typing import Any

import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.fit import GROUPS
from lfcal.simulate import plan_effects, undescribed_effects
from lfcal.simulate.effects import WHITE_IMAGE, Coma, CoverGlass, catalogue
from lfcal.simulate.undescribed import BEAD_FRAMES
from tests.cli import conftest
from tests.simulate.common import small_plan

lfcal = conftest.lfcal
KNOWN = tuple(effect for effect in catalogue() if effect.measured_by)


def test_the_largest_effects_are_named_first() -> None:
    """Each share is that of the planner's row; effects that are described, switched or small are left out."""
    plan = small_plan()
    chosen = plan_effects(plan, 0.03, {"lenslet_gap": "off"}, effects=[Coma(0.001)])
    found = undescribed_effects(chosen, plan.camera)
    shares = [row.estimate.error for row in found.rows]
    assert shares == sorted(shares, reverse=True) and shares[-1] > 0.015
    assert not {"lenslet_gap", "coma"} & {row.name for row in found.rows}
    first, second = found.rows[:2]
    assert found.sentence.startswith(
        f"not described: {first.effect.title}, up to {100 * shares[0]:.2g} % of the image; "
        f"{second.effect.title}, up to {100 * shares[1]:.2g} %; "
    )
    assert found.sentence.endswith(f"; {len(shares) - 3} smaller ones")
    fine = undescribed_effects(plan_effects(plan, 4.0), plan.camera)
    assert fine.sentence == "" and fine.lines("bench") == ()


def test_a_described_effect_needs_no_measurement() -> None:
    plan = small_plan()
    before = undescribed_effects(plan_effects(plan), plan.camera)
    after = undescribed_effects(plan_effects(plan, effects=[CoverGlass(100.0)]), plan.camera)
    assert "cover glass" in before.sentence and "cover glass" not in after.sentence


def test_every_undescribed_effect_has_one_measurement() -> None:
    plan = replace(small_plan(), depths_um=tuple(map(preset("bench").depth_of, (2.5, 4.0))))
    found = undescribed_effects(plan_effects(plan, 1e-3), plan.camera)
    planned = [row.name for one in found.measurements for row in one.rows]
    assert sorted(planned) == sorted(row.name for row in found.rows)
    frames = [one.frames for one in found.measurements]
    assert frames == sorted(frames, key=lambda n: n or 99), "the cheapest first"
    for one in found.measurements:
        for row in one.rows:
            source = row.effect.settled_by(plan.camera)
            assert one.frames == {"": 0, WHITE_IMAGE: 1}.get(source, BEAD_FRAMES * len(one.depths_um))
            if one.depths_um:
                assert all(source in words for words in one.commands if "--unknowns" in words)


def test_the_fewest_depths_show_all_effects() -> None:
    """One recording: each effect has at least half its largest error in a proposed plane, and fewer planes miss one."""
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[1.2, 2.5, 4.0, 6.0], cutout=41)
    depths = plan.depths_um
    chosen = plan_effects(plan, 1e-3)
    (beads,) = (one for one in undescribed_effects(chosen, plan.camera).measurements if one.depths_um)
    each = [plan_effects(ScanPlan.for_camera(plan.camera, depths_um=[z], cutout=41), 1e-3) for z in depths]
    errors = {row.name: [found.row(row.name).estimate.error for found in each] for row in beads.rows}
    shown = [{name for name, some in errors.items() if some[k] >= 0.5 * max(some)} for k in range(len(depths))]

    def complete(planes: Iterable[int]) -> bool:
        return set(errors) == set().union(*(shown[k] for k in planes))

    assert complete(depths.index(z_um) for z_um in beads.depths_um) and len({row.z_um for row in beads.rows}) > 1
    assert not any(complete(planes) for planes in combinations(range(len(depths)), len(beads.depths_um) - 1))


@pytest.mark.parametrize("effect", KNOWN, ids=lambda effect: effect.name)
def test_what_determines_an_effect_exists(effect: Any) -> None:
    assert effect.measured_by == WHITE_IMAGE or effect.measured_by in {group.name for group in GROUPS}


def test_a_camera_without_a_lattice_states_its_values() -> None:
    plan = ScanPlan.for_camera(preset("flfm_20x05"), depths_um=[0.0], cutout=101)
    found = undescribed_effects(plan_effects(plan), plan.camera)
    assert all(one.frames == 0 for one in found.measurements)


def test_the_commands_are_those_of_lfcal(lfcal: Any) -> None:
    """They are printed, and know every option; with --long they run as they are printed."""
    words = ("simulate", "bench", "--virtual-depths", "4", "--cutout", "41", "--plan-only")
    planned, printed = lfcal(*words, "--json"), lfcal(*words).out
    assert planned.code == 0, planned.err
    missing = planned.json["undescribed"]
    assert missing["sentence"].startswith("not described: cover glass, up to ")
    beads = next(one for one in missing["measurements"] if one["frames"] == BEAD_FRAMES)
    assert "cover_glass" in beads["effects"] and beads["depths_um"] == pytest.approx([preset("bench").depth_of(4.0)])
    assert all(command in printed for command in beads["commands"])
    for command in {words for one in missing["measurements"] for words in one["commands"]}:
        words = shlex.split(command)
        names = words[1:3] if words[1:3] == ["plan", "fit"] else words[1:2]
        help_text = lfcal(*names, "--help").out
        assert all(word.partition("=")[0] in help_text for word in words if word.startswith("--"))


TRUTH: dict[str, Any] = {
    "cover_glass": {"thickness_um": 100.0, "index": 1.52},
    "lenslet_spherical": {"waves": 0.25},
    "spherical": {"waves": 0.25},
    "finite_source": {"diameter_um": 50.0},
    "crosstalk": {"share": 0.01},
}
DETERMINED = {
    "gap_um": 290.4 - 100 * (1 - 1 / 1.52),
    "lenslet_waves_0": 0.25,
    "lenslet_waves_1": 0.25,
    "lenslet_waves_2": 0.25,
    "zernike_4_0": 0.25 / 6,
    "source_um": 50.0,
    "crosstalk": 0.01,
}
"""True values of the fit's unknowns: the plate shortens the gap by t (1 - 1/n), and rho^4 is a sixth of R(4, 0)."""


@pytest.mark.long
def test_the_proposed_bead_frames_determine_the_effects(lfcal, tmp_path, monkeypatch):
    """The commands as they are printed, with a simulated camera that has all these effects."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "truth.json").write_text(json.dumps([{"name": name, **values} for name, values in TRUTH.items()]))
    planned = lfcal("simulate", "bench", "--virtual-depths", "4", "--plan-only", "--json")
    beads = next(one for one in planned.json["undescribed"]["measurements"] if one["frames"] == BEAD_FRAMES)
    assert set(TRUTH) <= set(beads["effects"])
    for command in beads["commands"]:
        words = shlex.split(command)[1:]
        if words[0] == "acquire":
            words += ["--backend", "sim", "--option", "optics=grid", "--option", "effects=truth.json"]
        done = lfcal(*words)
        assert done.code == 0, done.err
    plan = ScanPlan.from_json((tmp_path / "beads.json").read_text())
    assert plan.depths_um == pytest.approx(beads["depths_um"])
    assert len(json.loads((tmp_path / "positions.json").read_text())["positions"]) == BEAD_FRAMES
    found = {one["name"]: one for one in json.loads((tmp_path / "fit" / "fit.json").read_text())["parameters"]}
    for name, truth in DETERMINED.items():
        assert abs(found[name]["value"] - truth) < 4 * found[name]["sigma"], name
        assert found[name]["sigma"] < abs(truth) / 5, f"{name} is determined"
