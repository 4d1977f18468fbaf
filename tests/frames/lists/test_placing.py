"""Stage coordinates find their positions, however the stage is mounted and whatever it counts in."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError
from lfcal.camera import ScanPlan, StageAxes
from lfcal.frames.lists.derived import plan_of_list
from lfcal.frames.lists.listing import Listing
from lfcal.frames.lists.placing import place
from tests.frames.lists.scans import COLUMNS, ROWS, START, Scan, frame, scan, small_camera


def plan_of(depths: Sequence[float] = (-40e3, 10e3), **settings: Any) -> ScanPlan:
    return ScanPlan(small_camera(), (ROWS, COLUMNS), (9, 11), tuple(depths), START, **settings)


def listing_of(found: Scan, *, scale: float = 1.0, unit: str = "um", shuffle: int | None = None) -> Listing:
    places = found.stage * scale
    files = tuple(f"{k:04d}.tif" for k in range(len(places)))
    if shuffle is not None:
        order = np.random.default_rng(shuffle).permutation(len(places))
        places, files = places[order], tuple(files[k] for k in order)
    return Listing("list.csv", files, (0,) * len(files), places, unit)


def truth(found: Scan, listing: Listing) -> np.ndarray:
    return found.positions[[int(name[:4]) for name in listing.files]]


def reader(found: Scan, listing: Listing):  # type: ignore[no-untyped-def]
    positions = truth(found, listing)
    return lambda k: frame(positions[k, 1:], seed=k)


CASES: dict[str, dict[str, Any]] = {
    "as the plan": {},
    "offset": {"origin": (12_345.6, -789.0, 4321.0)},
    "mirrored": {"right": "-x"},
    "both mirrored": {"right": "-x", "down": "-y"},
    "swapped": {"right": "+y", "down": "-x"},
    "depth backwards": {"away": "-z"},
    "turned": {"turn_deg": 7.0},
    "turned and jittering": {"turn_deg": -2.0, "jitter": 0.05, "origin": (1e5, 2e5, 3e5)},
    "depth along x": {"right": "+y", "down": "+z", "away": "+x"},
}


@pytest.mark.parametrize("case", CASES)
def test_frames_find_their_positions(case: str) -> None:
    found = scan(**CASES[case])
    listing = listing_of(found, shuffle=1)
    stage = StageAxes("+y", "+z", "+x") if case == "depth along x" else StageAxes()
    placed = place(listing, plan_of(stage=stage), reader(found, listing))
    np.testing.assert_array_equal(placed.positions, truth(found, listing))
    known = {key: CASES[case][key] for key in ("right", "down", "away") if key in CASES[case]}
    assert {key: getattr(placed.stage, key) for key in known} == known


def test_drift_is_where_the_stage_truly_was() -> None:
    """The jitter of the stage comes back as drift, but for the part that an affine of all frames takes up."""
    found, ideal = scan(jitter=0.1, seed=4), scan()
    listing = listing_of(found)
    placed = place(listing, plan_of())
    steps = np.array([[small_camera().step_um(z)] for z in ideal.depths])[found.positions[:, 0]]
    error = (found.stage - ideal.stage)[:, [1, 0]] / steps
    rest = placed.drift - error
    # 8 unknowns of 112 numbers
    assert np.sqrt((rest**2).mean()) < 0.035
    assert np.corrcoef(placed.drift.ravel(), error.ravel())[0, 1] > 0.95
    assert placed.rms_px == pytest.approx(np.sqrt((placed.drift**2).sum(axis=1).mean()))
    assert f"{placed.worst:04d}.tif" in placed.notes[0]


@pytest.mark.parametrize(
    ("scale", "unit", "words"), [(1e-3, "", "unit: mm"), (1.0, "", "unit: um"), (20.0, "", "unit: 1 in")]
)
def test_unit_is_told_by_the_steps_of_the_plan(scale: float, unit: str, words: str) -> None:
    found = scan()
    placed = place(listing_of(found, scale=scale, unit=unit), plan_of())
    np.testing.assert_array_equal(placed.positions, found.positions)
    assert any(words in note for note in placed.notes)


@pytest.mark.parametrize(
    ("scale", "words"), [(1.3, "are 1.300 times as far apart"), (0.97, "are 0.970 times as far apart")]
)
def test_a_z_of_another_scale_than_the_plan_s_is_said(scale: float, words: str) -> None:
    placed = place(listing_of(_deep(scan(), scale)), plan_of())
    (note,) = placed.scales
    assert note.startswith("depths: the planes") and words in note and note in placed.notes
    assert not place(listing_of(_deep(scan(), 1.005)), plan_of()).scales


def test_a_z_that_has_a_unit_of_its_own_is_said() -> None:
    """Counts of motors are of any length, and of another one along each axis."""
    found = scan()
    listing = listing_of(replace(found, stage=found.stage * [20.0, 20.0, 0.5]), unit="")
    assert "depths: 1 in the list's z is 2 µm, inferred from the plan's depths" in place(listing, plan_of()).notes
    with pytest.raises(InputError, match="z of the planes"):
        place(listing_of(_deep(found, 1e-3), unit=""), plan_of())


def test_a_plane_that_lies_elsewhere_than_planned_is_said() -> None:
    depths = (-40e3, -15e3, 10e3)
    found = scan(depths)
    stage = found.stage.copy()
    stage[found.positions[:, 0] == 1, 2] += 6e3
    placed = place(listing_of(replace(found, stage=stage)), plan_of(depths))
    assert re.search(r"z of the planes differs by up to .* µm from the plan \(\d+\.tif\)", placed.scales[-1])


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("unit", ["um", ""])
def test_planes_that_a_list_numbers_are_the_plan_s(first: int, unit: str) -> None:
    """A number says which plane is meant, whichever way the depths run and the stage's axis points."""
    for depths in ((-40e3, -10e3, 10e3), (10e3, -10e3, -40e3)):
        found = scan(depths, right="-x")
        stage = np.column_stack([found.stage[:, :2], found.positions[:, 0] + first])
        listing = replace(listing_of(replace(found, stage=stage), shuffle=1, unit=unit), counted=True)
        for away in ("+z", "-z"):
            plan = plan_of(depths, stage=StageAxes("-x", "+y", away))
            np.testing.assert_array_equal(place(listing, plan).positions, truth(found, listing))
        plan, _ = plan_of_list(listing, found.camera, read=reader(found, listing), cutout=(9, 11))
        np.testing.assert_allclose(plan.depths_um, depths, atol=1)
        np.testing.assert_array_equal(place(listing, plan).positions, truth(found, listing))
        given, _ = plan_of_list(listing, found.camera, depths_um=(-41e3, -9e3, 11e3), cutout=(9, 11))
        assert given.depths_um == ((-41e3, -9e3, 11e3) if depths[0] < 0 else (11e3, -9e3, -41e3))


def test_numbers_of_planes_that_the_plan_has_not() -> None:
    found = scan((-40e3, -10e3, 10e3))
    stage = np.column_stack([found.stage[:, :2], 2 * found.positions[:, 0]])
    listing = replace(listing_of(replace(found, stage=stage)), counted=True)
    with pytest.raises(InputError, match="expected one of 3 planes, counted from 0 or 1, got 4; correct the list"):
        place(listing, plan_of((-40e3, -10e3, 10e3)))
    with pytest.raises(InputError, match=r"depth axis: expected z, .* got \+x; correct the stage axes"):
        place(listing, plan_of((-40e3, -10e3, 10e3, 20e3, 30e3), stage=StageAxes("+y", "+z", "+x")))


def test_light_elsewhere_than_planned_is_said() -> None:
    found, plan = scan(), plan_of()
    listing = listing_of(found)
    assert not any("light:" in note for note in place(listing, plan, reader(found, listing)).notes)
    rows, columns = plan.anchor
    moved = place(listing, replace(plan, anchor=(rows + 3, columns - 4)), reader(found, listing))
    (note,) = (note for note in moved.notes if "light:" in note)
    assert f"near row {START[0]:.0f}, column {START[1]:.0f}, 5 px from the plan's anchor" in note


def test_without_light_the_plan_decides_and_it_is_said() -> None:
    found = scan(right="-x")
    placed = place(listing_of(found), plan_of())
    assert placed.stage.right == "+x"
    assert any("the list alone does not show" in note for note in placed.notes)
    stated = place(listing_of(found), plan_of(stage=StageAxes("-x")))
    np.testing.assert_array_equal(stated.positions, found.positions)


def test_missing_frames_and_repeats() -> None:
    found = scan()
    kept = np.setdiff1d(np.arange(len(found.stage)), [3, 11, 12, 40])
    some = Scan(found.camera, found.depths, found.positions[kept], found.stage[kept])
    np.testing.assert_array_equal(place(listing_of(some), plan_of()).positions, some.positions)
    twice = np.repeat(np.arange(len(found.stage)), 2)
    rng = np.random.default_rng(0)
    noisy = found.stage[twice] + rng.normal(0, 0.1, (len(twice), 3))
    double = Scan(found.camera, found.depths, found.positions[twice], noisy)
    np.testing.assert_array_equal(place(listing_of(double), plan_of(frames_averaged=2)).positions, double.positions)
    with pytest.raises(
        InputError, match=r"position z=0, y=0, x=0: expected 1 frame per position, as in the plan, got 0000\.tif, 0001"
    ):
        place(listing_of(double), plan_of())


def _moved(found: Scan, steps: float) -> Scan:
    stage = found.stage.copy()
    stage[5, :2] += np.array([1, steps < 1]) * steps * found.camera.step_um(found.depths[0])
    return replace(found, stage=stage)


def _deep(found: Scan, scale: float) -> Scan:
    return replace(found, stage=found.stage * [1, 1, scale])


REFUSED = {
    "planes": (lambda: scan((-40e3, -10e3, 10e3)), "2 planes of 7 across and 4 down, as in the plan, got 3 planes"),
    "steps": (lambda: scan(shape=(ROWS, 6)), "got 2 planes of 6 along x and 4 along y"),
    "half a step": (lambda: _moved(scan(), 0.45), "position of 0005.tif: expected at most half a step"),
    "onto another": (lambda: _moved(scan(), 1.0), "position z=0, y=0, x=6: expected 1 frame"),
    "another scale": (lambda: replace(s := scan(), stage=s.stage * [1.5, 1.5, 1]), "1.5 times as much"),
    "a third of z": (
        lambda: _deep(scan(), 1 / 3),
        ("z of the planes: expected the spacing of the planned planes, got 0.333"),
    ),
    "z in mm": (lambda: _deep(scan(), 1e-3), "correct unit or column (--columns z_mm=…)"),
    "z in nm": (lambda: _deep(scan(), 1e3), "z of the planes: expected the spacing of the planned planes, got 1e+03"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_another_scan_is_refused(case: str) -> None:
    make, words = REFUSED[case]
    with pytest.raises(InputError) as caught:
        place(listing_of(make()), plan_of())
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("case", [name for name in CASES if name != "depth along x"])
def test_the_plan_of_a_list(case: str) -> None:
    found = scan(**CASES[case])
    listing = listing_of(found, scale=1e-3, unit="", shuffle=2)
    plan, notes = plan_of_list(listing, found.camera, read=reader(found, listing), cutout=(9, 11))
    assert plan.shape == (2, ROWS, COLUMNS, 9, 11) and plan.anchor == START
    np.testing.assert_allclose(plan.depths_um, found.depths, rtol=0, atol=2000 if "jitter" in case else 1)
    placed = place(replace(listing, places=listing.places * 1e3, unit="um"), plan)
    np.testing.assert_array_equal(placed.positions, truth(found, listing))
    assert any("unit: mm" in note for note in notes)
    if "turn" not in case:
        expected = plan.stage_um(truth(found, listing))
        np.testing.assert_allclose(expected, listing.places * 1e3, atol=1.0)


def test_the_plan_of_a_list_without_light_says_what_it_assumes() -> None:
    found = scan()
    plan, notes = plan_of_list(listing_of(found), found.camera, cutout=(9, 11))
    assert plan.period == (ROWS, COLUMNS)
    assert any("(--anchor)" in note for note in notes) and any("(--stage)" in note for note in notes)


def test_what_no_plan_can_be_made_of() -> None:
    found = scan(shape=(ROWS, 6))
    with pytest.raises(
        InputError,
        match=("columns of positions in the list: expected 7, a whole number of the camera's periods, got 6"),
    ):
        plan_of_list(listing_of(found), found.camera)
    same = scan()
    same.stage[same.positions[:, 0] == 1, :2] = same.stage[same.positions[:, 0] == 0, :2]
    with pytest.raises(InputError, match="longer in farther planes"):
        plan_of_list(listing_of(same), same.camera)
    with pytest.raises(InputError, match=r"expected 2 as in the list, got 1"):
        plan_of_list(listing_of(scan()), small_camera(), depths_um=(0.0,))
    with pytest.raises(InputError, match=r"1000 times as large would fit; state the unit in .*\(--columns x_mm=COLUMN"):
        plan_of_list(listing_of(scan(), scale=1e-3), small_camera())
    with pytest.raises(InputError, match="stage coordinates, got position numbers"):
        plan_of_list(listing_of(found, unit="index"), found.camera)


def test_damaged_frames_do_not_stand_in_the_way_of_the_others() -> None:
    found = scan(right="-x")
    listing = listing_of(found)
    read = reader(found, listing)

    def some(k: int) -> np.ndarray:
        if k % 5 == 0:
            raise FileFormatError("damaged")
        return read(k) if k % 5 > 1 else read(k)[:, :-1]

    assert place(listing, plan_of(), some).stage.right == "-x"
    none = place(listing, plan_of(), lambda _: some(0))
    assert none.stage.right == "+x", "without light the plan decides"


def test_in_one_plane_the_stage_s_noise_along_the_axis_is_no_coordinate() -> None:
    """A column that hardly changes would take up drift as if it were a tilt of a thousand."""
    found = scan(depths=(10e3,), jitter=0.1, seed=4)
    rng = np.random.default_rng(3)
    noisy = replace(found, stage=found.stage + rng.normal(0, 0.02, found.stage.shape) * (0, 0, 1))
    placed, still = (place(listing_of(one), plan_of((10e3,))) for one in (noisy, found))
    np.testing.assert_allclose(placed.drift, still.drift, atol=1e-9)


@pytest.mark.parametrize("axis", [1, 2])
def test_steps_that_differ_along_one_axis_are_said(axis: int) -> None:
    """Whichever axes of the stage they are: here y and z, as depths lie along x."""
    found = scan(**CASES["depth along x"])
    longer = np.ones(3)
    longer[axis] = 1.06
    listing = replace(listing_of(found), places=found.stage * longer)
    placed = place(listing, plan_of(stage=StageAxes("+y", "+z", "+x")), reader(found, listing))
    np.testing.assert_array_equal(placed.positions, truth(found, listing))
    assert any(re.match(r"steps: 1.03\d times the plan's", note) for note in placed.notes), placed.notes
