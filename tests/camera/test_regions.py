"""Several regions of the field in one plan."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base import FileFormatError, InputError
from lfcal.camera import LatticeDistortion, RegionPlan, ScanPlan, parse_regions, preset

R29 = ScanPlan.for_camera(preset("r29"), virtual_depths=(4.0,))
BENCH = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)


def test_nine_regions_reach_centre_edges_and_corners() -> None:
    plan = RegionPlan.spread(R29, (3, 3))
    assert plan.names[0] == "centre" and len(set(plan.names)) == len(plan) == 9
    anchors = np.array(plan.anchors)
    rows, columns = R29.camera.sensor.shape
    corner = plan.plan(plan.names.index("r3c3"))
    # the outermost cutout ends within some periods of the sensor's edge
    last = np.array(corner.anchor) + np.array(corner.period) - 1 + (np.array(corner.cutout) - 1) / 2
    assert (np.array([rows, columns]) - 1 - last < 7 * np.array(R29.period)).all()
    assert (anchors == np.rint(anchors)).all()


@pytest.mark.parametrize("turn", [0.0, math.radians(0.7)])
@pytest.mark.parametrize("bent", [False, True])
def test_a_position_shows_the_same_phase_in_every_region(turn: float, bent: bool) -> None:
    """Compared with the array: what lies under the anchor of a region is what lies under that of the first."""
    lattice = replace(R29.camera.lattice, rotation_rad=turn)
    if bent:
        distortion = LatticeDistortion("radial", (0.0, 0.0), 10_000.0, ((20.0,),))
        lattice = replace(lattice, distortion=distortion)
    scan = replace(R29, camera=replace(R29.camera, lattice=lattice))
    plan = RegionPlan.spread(scan, (3, 3))
    camera = scan.camera
    first = camera.lattice.lenslet_at(camera.sensor_um(plan.anchors[0]))
    for k in range(len(plan)):
        here = camera.lattice.lenslet_at(camera.sensor_um(plan.anchors[k])) - first
        whole = np.rint(here)
        # within the lattice of a lens type: by whole lenslets, up to a fraction of one
        types = camera.lattice.type_of(*np.array([[0, whole[0]], [0, whole[1]]]).astype(int))
        assert types[0] == types[1]
        off = (here - whole) @ camera.lattice.basis_um() / camera.sensor.pixel_um
        assert np.abs(off).max() < 0.15
        np.testing.assert_allclose(plan.residual_px(k), off[::-1], atol=0.01)


def test_a_plan_comes_back_from_its_file() -> None:
    plan = RegionPlan.spread(BENCH, (3, 3))
    assert len(plan) == 9 and max(abs(v) for k in range(9) for v in plan.residual_px(k)) < 0.5
    assert plan.residual_px(0) == (0.0, 0.0)
    plan = RegionPlan.spread(BENCH, (1, 3))
    assert plan.names == ("centre", "r1c1", "r1c3")
    assert RegionPlan.from_json(plan.to_json()) == plan
    assert RegionPlan.is_one(json.loads(plan.to_json())) and not RegionPlan.is_one(BENCH.to_dict())
    with pytest.raises(FileFormatError, match="scan plan"):
        ScanPlan.from_json(plan.to_json())


def test_damaged_plans_are_refused() -> None:
    data = RegionPlan.spread(BENCH, (1, 2)).to_dict() | {"scan": replace(BENCH, anchor=(150.0, 144.0)).to_dict()}
    first = {"name": "a", "anchor": [150, 144]}
    for change, match in (
        ({"version": 2}, "version 1"),
        ({"regions": 3}, "format, version, regions and scan"),
        ({"more": 1}, "format, version, regions and scan"),
        ({"regions": [{"name": "a"}]}, "a name and an anchor"),
        ({"regions": [first | {"name": "../a"}]}, "letters, digits, _ and -"),
        ({"regions": [first, {"name": "A", "anchor": [55, 45]}]}, "different names"),
        ({"regions": [{"name": "a", "anchor": [55, 45]}]}, "first anchor of the regions: expected"),
        ({"regions": [first, {"name": "b", "anchor": [0, 45]}]}, "cutout"),
    ):
        with pytest.raises(InputError, match=match):
            RegionPlan.from_dict(data | change)


def test_there_must_be_room_for_them() -> None:
    with pytest.raises(InputError, match="room for 9 x 9"):
        RegionPlan.spread(replace(BENCH, cutout=(201, 201)), (9, 9))
    with pytest.raises(InputError, match="2 to 100 in all"):
        RegionPlan.spread(BENCH, (1, 1))
    assert parse_regions(" 3 x 4") == (3, 4)
    for text in ("", "3", "axb", "-1x3"):
        with pytest.raises(InputError, match="give two whole numbers: 3x3"):
            parse_regions(text)
