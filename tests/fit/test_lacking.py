"""Groups of unknowns that a camera has nothing of are refused where they were asked for, and say what they need."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from lfcal.base.errors import InputError
from lfcal.camera import MainLens, ScanPlan
from lfcal.fit import GROUPS, fit_camera, measured_of
from lfcal.fit.design import next_positions
from lfcal.fit.parameters import check_groups, lacking
from lfcal.simulate.effects import CATALOGUE, IndexMismatch, MechanicalVignetting
from tests.fit.common import few_patterns, setup_of, small_camera, small_plan, vector_of

PLAN = small_plan()


def microscope() -> ScanPlan:
    return ScanPlan.for_camera(small_camera("lfm_20x05"), depths_um=(5.0, 12.0), cutout=45)


@pytest.mark.parametrize("plan", [PLAN, small_plan(depths=(2.2,)), microscope()], ids=["lens", "plane", "microscope"])
def test_every_group_has_unknowns_or_says_what_it_needs(plan: ScanPlan) -> None:
    without = lacking(setup_of(plan), plan)
    names = {one.group for one in vector_of(plan, GROUPS.names()).unknowns}
    assert names | set(without) == set(GROUPS.names()) and not names & set(without)
    # the words of its own, not those of all groups
    assert all(needs and needs != "a camera that has them" for needs in without.values())
    named = [name for needs in without.values() for name in re.findall(r"effect (\w+)", needs)]
    assert named and all(name in CATALOGUE for name in named)


def test_what_a_camera_gets_it_has() -> None:
    setup = setup_of(PLAN)
    assert {"specimen", "cats_eye"} <= set(lacking(setup, PLAN)) and "blades" not in lacking(setup, PLAN)
    assert "depths" in lacking(setup_of(small_plan(depths=(2.2,))), small_plan(depths=(2.2,)))
    deep = setup_of(microscope()).with_effect(IndexMismatch(1.38, 20.0))
    assert "specimen" in lacking(setup_of(microscope()), microscope()) and "specimen" not in lacking(deep, microscope())
    lens = PLAN.camera.optics
    assert isinstance(lens, MainLens)
    round_one = replace(PLAN, camera=replace(PLAN.camera, optics=replace(lens, blades=0)))
    assert lacking(setup_of(round_one), round_one)["blades"] == "an iris with blades"
    aside = replace(PLAN, anchor=(20.0, 20.0))
    far = replace(aside, camera=replace(aside.camera, sensor=replace(aside.camera.sensor, shape=(900, 900))))
    assert "cats_eye" not in lacking(setup_of(far).with_effect(MechanicalVignetting()), far)


def test_they_are_refused_where_they_were_asked_for() -> None:
    what = (
        "unknowns: expected groups that the camera .* has, got specimen, which needs the effect "
        "index_mismatch; choose from geo"
    )
    with pytest.raises(InputError, match=what) as raised:
        fit_camera(measured_of(few_patterns()), unknowns=("geometry", "specimen"))
    assert "cats_eye" not in str(raised.value).partition("choose from")[2]
    with pytest.raises(InputError, match=what):
        next_positions(PLAN, 6, groups=("geometry", "specimen"))
    check_groups(setup_of(PLAN), PLAN, ("geometry", "depths"))
