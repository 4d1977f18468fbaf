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


def test_steps_and_spread_are_those_of_rays_through_objective_and_lenslets():
    # similar triangles: objective -> native image M x, Fourier lens -> slope M x / f, lenslet -> B M x / f
    assert 20.0 * FLFM.step_um() / 150e3 * 60e3 == pytest.approx(6.5), "one pixel"
    assert FLFM.magnification == pytest.approx(8.0) and FLFM.period_px == (1.0, 1.0)
    # the ray that meets the lenslet at c left the focal plane at angle t; from depth z it is displaced by z tan t
    z, c = 2.0, 1000.0
    displaced = 20.0 * -z * math.tan(math.asin(20.0 * c / 150e3)) / 150e3 * 60e3
    assert FLFM.lattice.spread(FLFM.optics, z) * c == pytest.approx(displaced, rel=0.01)


def test_a_description_survives_files_and_copies_and_older_programs_refuse_its_version():
    data = json.loads(FLFM.to_json())
    assert Camera.from_dict(data) == FLFM == pickle.loads(pickle.dumps(FLFM)) == copy.deepcopy(FLFM)
    r29 = json.loads(preset("r29").to_json())
    assert data["version"] == 3 and r29["version"] == 2 and "type" not in r29["lattice"]
    data["lattice"]["type"] = "Other"
    with pytest.raises(FileFormatError, match="LensletLattice or PupilLenslets"):
        Camera.from_dict(data)


def test_values_that_no_instrument_has_are_refused():
    for change, match in (
        ({"lens_centres_um": ()}, "lenslets"),
        ({"lens_centres_um": ((0.0, 0.0), (0.0, 0.0))}, "a different centre"),
        ({"lens_centres_um": ((0.0, math.nan),)}, "centre of a lenslet"),
        ({"focal_lengths_um": (1.0, 2.0)}, "one for all lenslets, or one for each of the 7"),
        ({"aperture": "star"}, "round or square"),
        ({"fourier_um": 0.0}, "Fourier lens"),
        ({"clear_um": -1.0}, "clear diameter"),
    ):
        with pytest.raises(InputError, match=match):
            replace(FLFM.lattice, **change)
    with pytest.raises(InputError, match="Microscope"):
        Camera("x", MainLens(), FLFM.lattice, Sensor())


def test_what_only_a_lattice_has_is_refused_by_name():
    for name in {*LensletLattice.__dataclass_fields__} - {*PupilLenslets.__dataclass_fields__}:
        with pytest.raises(
            NoLatticeError, match=r"^lenslet [a-z ]+: expected a camera with a periodic lenslet"
        ) as error:
            getattr(FLFM.lattice, name)
        assert name not in str(error.value) or "_" not in name, "the user's words, not a name of Python"
        assert not hasattr(FLFM.lattice, name)
    for ask in (
        lambda c: c.pitch_px,
        lambda c: c.lattice_scale,
        lambda c: c.depth_of(2.0),
        lambda c: c.virtual_depth(1.0),
        lambda c: slope_of_virtual_depth(c, 2.0),
    ):
        with pytest.raises(NoLatticeError):
            ask(FLFM)


def test_a_plan_has_one_position_per_plane_at_the_axis_and_contains_the_pattern():
    plan = ScanPlan.for_camera(FLFM, depths_um=(-20.0, 0.0, 20.0))
    assert plan.period == (1, 1) and plan.virtual_depths == () and plan.period_residual_px == (0.0, 0.0)
    assert all(n % 2 for n in plan.cutout) and plan.cutout[0] > 2 * 2500 / 6.5
    assert ScanPlan.from_json(plan.to_json()) == plan
    small = replace(FLFM, sensor=replace(FLFM.sensor, shape=(700, 700)))
    assert ScanPlan.for_camera(small, depths_um=(0.0,)).cutout == (699, 699), "the whole sensor"
    moved = replace(FLFM, lattice=replace(FLFM.lattice, offset_um=(65.0, -130.0)))
    plan = ScanPlan.for_camera(moved, depths_um=(0.0,))
    assert np.abs(plan.lattice_anchor).max() <= 0.5 and plan.anchor == (580.0, 610.0)


def test_derived_values_are_those_of_the_design_rules():
    values = {one.label: one.value for one in derived_of(FLFM)}
    assert values["pupil on the lenslets"] == pytest.approx(7500)
    assert values["field without overlap"] == pytest.approx(312.5)
    assert values["resolution λ/(2 NA) of a lenslet"] == pytest.approx(0.525 / (2 * 0.5 / 3))
    assert PupilLenslets(((0.0, 0.0),), 1e5, 6e4, (6e4,), 1e3).spacing_um == math.inf, "one lenslet has no neighbours"
    assert Microscope().telecentric


def test_a_good_design_raises_no_doubt_and_a_mistyped_one_does():
    assert doubts(FLFM) == ()
    for part, change, expected in (
        ("lattice", {"fourier_um": 30e3}, "outside the pupil"),
        ("lattice", {"clear_um": 4000.0}, "overlap"),
        ("sensor", {"shape": (400, 400)}, "outside the 400 x 400 px sensor"),
    ):
        wrong = replace(FLFM, **{part: replace(getattr(FLFM, part), **change)})
        assert any(expected in line for line in doubts(wrong)), expected


def test_every_value_has_a_label_and_a_text():
    shown = {q.path: q.text(value_at(FLFM, q.path)) for q in quantities_of(FLFM)}
    assert shown["lattice.fourier_um"] == "150 mm"
    assert shown["lattice.lens_centres_um"].startswith("0, 0; 2500, 0")
    assert "lattice.pitch_um" not in shown


def test_a_draft_assumes_seven_lenslets_across_the_pupil():
    camera = Draft("FourierMicroscope", {"lattice.fourier_um": 75e3}).camera("mine")
    assert len(camera.lattice.lens_centres_um) == 7
    assert camera.lattice.clear_um == pytest.approx(camera.lattice.pupil_um(camera.optics) / 3, rel=1e-3)
    assert camera.marks["lattice.fourier_um"] == "stated" and camera.marks["lattice.clear_um"] == "assumed"
    assert Draft.of(camera, {}).camera("mine") == camera
    for kind, path, words in (
        ("FourierMicroscope", "lattice.pitch_um", "a Fourier light-field microscope"),
        ("Microscope", "lattice.fourier_um", "a microscope"),
    ):
        with pytest.raises(InputError, match=f"an entry of {words}"):
            Draft(kind, {path: 100.0})
