"""Unknowns: what they start from, what they change, and that each changes it as it says."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.fit.groups.array import about
from lfcal.fit.parameters import GROUPS, ScanScales, Unknown, Vector, find_groups
from lfcal.fit.setup import Setup, described_effects
from lfcal.simulate.effects import LensletSpherical, MechanicalVignetting, Zernike
from tests.distribution import install


def vector(name: str, groups: tuple[str, ...] | None = None, **extra: object) -> Vector:
    camera = preset(name)
    effects = (*described_effects(camera), *extra.get("effects", ()))  # type: ignore[misc]
    setup = Setup(camera, effects, (0.0, 0.0))
    return Vector(setup, ScanScales(2, 27.0, (900.0, -700.0)), groups or GROUPS.names())


@pytest.mark.parametrize("name", ["bench", "r29", "lfm_20x05", "lfm_60x12"])
def test_the_start_is_the_description(name: str) -> None:
    found = vector(name)
    start = found.setup_at(np.zeros(len(found)))
    assert start.camera == preset(name) and start.depth_errors_um == (0.0, 0.0) and start.stage_scale == 0
    names = [one.name for one in found.unknowns]
    types = len(preset(name).lattice.types)
    assert sum(n.startswith("focal_") for n in names) == sum(n.startswith("lenslet_waves_") for n in names) == types
    assert ("f_number" in names) != ("numerical_aperture" in names)


@pytest.mark.parametrize("name", ["bench", "lfm_20x05"])
def test_every_unknown_alone_changes_the_setup_and_its_own_value(name: str) -> None:
    found = vector(name, effects=(MechanicalVignetting(),) if name == "bench" else ())
    start = found.setup_at(np.zeros(len(found)))
    for k, one in enumerate(found.unknowns):
        u = np.zeros(len(found))
        u[k] = 0.5
        values = found.values(u)
        assert values[one.name] != one.start, one.name
        assert {n: v for n, v in values.items() if n != one.name} == {
            o.name: o.start for o in found.unknowns if o.name != one.name
        }
        assert found.setup_at(u) != start, one.name


def test_values_land_where_they_belong() -> None:
    found = vector("bench")
    places = {one.name: k for k, one in enumerate(found.unknowns)}
    u = np.zeros(len(found))
    u[[places["gap_um"], places["focal_1_um"], places["lenslet_waves_2"], places["zernike_3_m1"]]] = 1.0
    setup, values = found.setup_at(u), found.values(u)
    assert setup.camera.lattice.gap_um == values["gap_um"] != preset("bench").lattice.gap_um
    focal = [t.focal_length_um for t in setup.camera.lattice.types]
    assert focal[1] == values["focal_1_um"] and focal[0] == preset("bench").lattice.types[0].focal_length_um
    assert setup.effect(LensletSpherical) == LensletSpherical(0.0, 0.0, 0.0, values["lenslet_waves_2"])
    wavefront = setup.effect(Zernike)
    assert wavefront is not None and (3, -1, values["zernike_3_m1"]) in wavefront.terms


def test_what_a_setup_has_is_where_its_unknowns_start() -> None:
    found = vector("bench", effects=(LensletSpherical(0.1, type_1=0.2), Zernike(((2, 2, 0.3), (7, 1, 0.05)))))
    start = {one.name: one.start for one in found.unknowns}
    assert start["lenslet_waves_1"] == pytest.approx(0.3) and start["zernike_2_2"] == 0.3
    wavefront = found.setup_at(np.zeros(len(found))).effect(Zernike)
    assert wavefront is not None and (7, 1, 0.05) in wavefront.terms, "terms that are no unknowns stay"


def test_rotation_and_pitch_leave_the_region_where_it_is() -> None:
    lattice = replace(preset("bench").lattice, offset_um=(13.0, -4.0), rotation_rad=0.02)
    index = (12, -7)
    point = tuple(lattice.centres_um(*index))
    for turn, grow in ((0.01, 0.0), (0.0, 0.02), (-0.02, -0.01)):
        changed = about(lattice, point, turn, grow)
        np.testing.assert_allclose(changed.centres_um(*index), point, atol=1e-9)
        assert changed.rotation_rad == pytest.approx(0.02 + turn)
        assert changed.pitch_um == pytest.approx((1 + grow) * lattice.pitch_um)
    assert np.hypot(*(replace(lattice, rotation_rad=0.03).centres_um(*index) - point)) > 5, "else it moves far"


def test_a_width_is_fitted_by_its_square() -> None:
    one = Unknown("source_um", "source", "µm", 3.0, 4.0, None, 0.0, 20.0, squared=True)
    assert one.value(1.0) == pytest.approx(5.0) and one.value(-9 / 16) == 0.0 and one.value(-9.0) == 0.0
    assert one.clipped(-9.0) == pytest.approx(-9 / 16) and one.value(one.clipped(1e6)) == pytest.approx(20.0)
    assert one.sigma_of(1.0, 0.01) == pytest.approx(0.01 * 16 / 10)
    assert math.isfinite(one.sigma_of(-9 / 16, 0.01))


def test_what_is_no_unknown_is_refused() -> None:
    with pytest.raises(InputError, match=r"unknowns: expected geometry, .*, got 'gap'; choose one of these"):
        vector("bench", ("gap",))
    with pytest.raises(InputError, match="gap_um twice"):
        vector("bench", ("geometry", "geometry"))
    with pytest.raises(InputError, match="starting value of f: expected 0 to 1, got 2"):
        Unknown("f", "iris", "", 2.0, 1.0, low=0.0, high=1.0)


def test_groups_of_other_distributions_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = """
from lfcal.fit.parameters import Group, Unknown
class Own(Group):
    name, title = "own", "something else"
    def unknowns(self, setup, frame):
        return (Unknown("own_one", self.name, "", 0.0, 1.0),)
    def applied(self, setup, values, frame):
        return setup
OWN, BAD = Own(), object()
"""
    install(
        monkeypatch,
        tmp_path,
        "others_unknowns",
        source,
        {"lfcal.unknowns": "own = others_unknowns:OWN\nbad = others_unknowns:BAD"},
    )
    found = find_groups()
    assert "own" in found and "bad" in found.failures()
    of_fourier = ["lens_centres", "optical_axis", "fourier_lens", "lenslet_gap", "travel_tilt"]
    assert [group.name for group in found if group.core] == ["geometry", *of_fourier, "focal_lengths", "iris"]
