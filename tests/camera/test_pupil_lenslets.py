"""Lenslets in a pupil plane: geometry against similar triangles, files, refusals, and what does not apply."""

from __future__ import annotations

import copy
import json
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base import FileFormatError, InputError
from lfcal.camera import (
    Camera,
    Draft,
    LensletLattice,
    MainLens,
    Microscope,
    NoLatticeError,
    PupilLenslets,
    ScanPlan,
    Sensor,
    derived_of,
    doubts,
    preset,
    quantities_of,
    value_at,
)
from lfcal.lattice import slope_of_virtual_depth

FLFM = preset("flfm_20x05")


def test_a_step_of_the_source_moves_every_elemental_image_by_one_pixel():
    # similar triangles: objective -> native image M x, Fourier lens -> slope M x / f, lenslet -> B M x / f
    step = FLFM.step_um()
    slope = 20.0 * step / 150e3
    assert slope * 60e3 == pytest.approx(6.5)
    assert FLFM.magnification == pytest.approx(8.0)
    assert FLFM.period_px == (1.0, 1.0)


def test_the_spread_with_depth_is_that_of_rays_through_the_objective():
    # the ray that meets the lenslet at c left the focal plane at angle t; from depth z it arrives displaced by z tan t
    z, c = 2.0, 1000.0
    t = math.asin(20.0 * c / 150e3)
    displaced = 20.0 * -z * math.tan(t) / 150e3 * 60e3
    assert FLFM.lattice.spread(FLFM.optics, z) * c == pytest.approx(displaced, rel=0.01)


def test_a_description_survives_a_file_and_older_programs_refuse_it_by_version():
    text = FLFM.to_json()
    assert Camera.from_json(text) == FLFM
    assert json.loads(text)["version"] == 3
    assert json.loads(preset("r29").to_json())["version"] == 2
    assert "type" not in json.loads(preset("r29").to_json())["lattice"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lens_centres_um": ()}, "lenslets"),
        ({"lens_centres_um": ((0.0, 0.0), (0.0, 0.0))}, "a different centre"),
        ({"lens_centres_um": ((0.0, math.nan),)}, "centre of a lenslet"),
        ({"focal_lengths_um": (1.0, 2.0)}, "one for all lenslets, or one for each of the 7"),
        ({"aperture": "star"}, "round or square"),
        ({"fourier_um": 0.0}, "Fourier lens"),
        ({"clear_um": -1.0}, "clear diameter"),
    ],
)
def test_values_that_no_instrument_has_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        replace(FLFM.lattice, **change)


def test_lenslets_in_a_pupil_need_a_microscope():
    with pytest.raises(InputError, match="Microscope"):
        Camera("x", MainLens(), FLFM.lattice, Sensor())


def test_an_unknown_type_of_lenslets_in_a_file_is_refused():
    data = FLFM.to_dict()
    data["lattice"]["type"] = "Other"
    with pytest.raises(FileFormatError, match="LensletLattice or PupilLenslets"):
        Camera.from_dict(data)


@pytest.mark.parametrize("name", sorted({*LensletLattice.__dataclass_fields__} - {*PupilLenslets.__dataclass_fields__}))
def test_what_only_a_lattice_has_is_refused_by_name(name):
    with pytest.raises(NoLatticeError, match=r"^lenslet [a-z ]+: expected a camera with a periodic lenslet") as refused:
        getattr(FLFM.lattice, name)
    assert name not in str(refused.value) or "_" not in name, "the user's words, not a name of Python"
    assert not hasattr(FLFM.lattice, name)


@pytest.mark.parametrize(
    "ask",
    [
        lambda c: c.pitch_px,
        lambda c: c.lattice_scale,
        lambda c: c.depth_of(2.0),
        lambda c: c.virtual_depth(1.0),
        lambda c: slope_of_virtual_depth(c, 2.0),
    ],
)
def test_virtual_depth_and_pitch_do_not_apply(ask):
    with pytest.raises(NoLatticeError):
        ask(FLFM)


def test_lenslets_can_be_copied_and_sent_to_other_processes():
    assert pickle.loads(pickle.dumps(FLFM)) == FLFM == copy.deepcopy(FLFM)


def test_a_plan_has_one_position_per_plane_at_the_axis_and_holds_the_pattern():
    plan = ScanPlan.for_camera(FLFM, depths_um=(-20.0, 0.0, 20.0))
    assert plan.period == (1, 1)
    assert plan.virtual_depths == ()
    assert plan.period_residual_px == (0.0, 0.0)
    assert all(n % 2 for n in plan.cutout)
    assert plan.cutout[0] > 2 * 2500 / 6.5
    assert ScanPlan.from_json(plan.to_json()) == plan


def test_the_cutout_of_a_pattern_as_large_as_the_sensor_is_the_sensor():
    small = replace(FLFM, sensor=replace(FLFM.sensor, shape=(700, 700)))
    assert ScanPlan.for_camera(small, depths_um=(0.0,)).cutout == (699, 699)


def test_the_anchor_is_at_the_optical_axis():
    aside = replace(FLFM, lattice=replace(FLFM.lattice, offset_um=(65.0, -130.0)))
    plan = ScanPlan.for_camera(aside, depths_um=(0.0,))
    assert np.abs(plan.lattice_anchor).max() <= 0.5
    assert plan.anchor == (580.0, 610.0)


def test_derived_values_are_those_of_the_design_rules():
    values = {one.label: one.value for one in derived_of(FLFM)}
    assert values["pupil on the lenslets"] == pytest.approx(7500)
    assert values["field without overlap"] == pytest.approx(312.5)
    assert values["resolution λ/(2 NA) of a lenslet"] == pytest.approx(0.525 / (2 * 0.5 / 3))


def test_a_good_design_raises_no_doubt_and_a_mistyped_one_does():
    assert doubts(FLFM) == ()
    wrong = replace(FLFM, lattice=replace(FLFM.lattice, fourier_um=30e3))
    assert any("outside the pupil" in line for line in doubts(wrong))
    wide = replace(FLFM, lattice=replace(FLFM.lattice, clear_um=4000.0))
    assert any("overlap" in line for line in doubts(wide))
    small = replace(FLFM, sensor=replace(FLFM.sensor, shape=(400, 400)))
    assert any("outside the 400 x 400 px sensor" in line for line in doubts(small))


def test_every_value_has_a_label_and_a_text():
    shown = {q.path: q.text(value_at(FLFM, q.path)) for q in quantities_of(FLFM)}
    assert shown["lattice.fourier_um"] == "150 mm"
    assert shown["lattice.lens_centres_um"].startswith("0, 0; 2500, 0")
    assert "lattice.pitch_um" not in shown


def test_a_draft_assumes_seven_lenslets_across_the_pupil():
    camera = Draft("FourierMicroscope", {"lattice.fourier_um": 75e3}).camera("mine")
    assert len(camera.lattice.lens_centres_um) == 7
    assert camera.lattice.clear_um == pytest.approx(camera.lattice.pupil_um(camera.optics) / 3, rel=1e-3)
    assert camera.marks["lattice.fourier_um"] == "stated"
    assert camera.marks["lattice.clear_um"] == "assumed"
    assert Draft.of(camera, {}).camera("mine") == camera


def test_a_draft_refuses_values_of_the_other_kind():
    with pytest.raises(InputError, match="an entry of a Fourier light-field microscope"):
        Draft("FourierMicroscope", {"lattice.pitch_um": 100.0})
    with pytest.raises(InputError, match="an entry of a microscope"):
        Draft("Microscope", {"lattice.fourier_um": 100.0})


def test_a_lenslet_alone_has_no_neighbours():
    assert PupilLenslets(((0.0, 0.0),), 1e5, 6e4, (6e4,), 1e3).spacing_um == math.inf
    assert Microscope().telecentric
