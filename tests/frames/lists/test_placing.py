"""Stage coordinates find their positions, depths and steps, however the stage is mounted and whatever it counts in."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, InputError
from lfcal.camera import Camera, ScanPlan, StageAxes, preset
from lfcal.frames.lists._depths import Depths, ListedPlanes, find_depths
from lfcal.frames.lists._grid import find_grid
from lfcal.frames.lists.derived import plan_of_list, rounding, step_error, step_size
from lfcal.frames.lists.listing import Listing
from lfcal.frames.lists.placing import place
from tests.frames.lists.scans import COLUMNS, ROWS, START, Scan, frame, scan, small_camera, step_um


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


def test_units_and_scales_are_found_by_the_steps_and_depths_of_the_plan() -> None:
    found = scan()
    for scale, words in ((1e-3, "unit: mm"), (1.0, "unit: um"), (20.0, "unit: 1 in")):
        placed = place(listing_of(found, scale=scale, unit=""), plan_of())
        np.testing.assert_array_equal(placed.positions, found.positions)
        assert any(words in note for note in placed.notes)
    for scale, words in ((1.3, "are 1.300 times as far apart"), (0.97, "are 0.970 times as far apart")):
        placed = place(listing_of(_deep(found, scale)), plan_of())
        (note,) = placed.scales
        assert note.startswith("depths: the planes") and words in note and note in placed.notes
    assert not place(listing_of(_deep(found, 1.005)), plan_of()).scales
    # counts of motors are of any length, and of another one along each axis
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


@pytest.mark.parametrize(("first", "unit"), [(0, "um"), (1, "")])
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


def test_light_elsewhere_than_planned_is_said_and_without_light_the_plan_decides() -> None:
    found, plan = scan(), plan_of()
    listing = listing_of(found)
    assert not any("light:" in note for note in place(listing, plan, reader(found, listing)).notes)
    rows, columns = plan.anchor
    moved = place(listing, replace(plan, anchor=(rows + 3, columns - 4)), reader(found, listing))
    (note,) = (note for note in moved.notes if "light:" in note)
    assert f"near row {START[0]:.0f}, column {START[1]:.0f}, 5 px from the plan's anchor" in note
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
    words = r"position z=0, y=0, x=0: expected 1 frame per position, as in the plan, got 0000\.tif, 0001"
    with pytest.raises(InputError, match=words):
        place(listing_of(double), plan_of())


def _moved(found: Scan, steps: float) -> Scan:
    stage = found.stage.copy()
    stage[5, :2] += np.array([1, steps < 1]) * steps * found.camera.step_um(found.depths[0])
    return replace(found, stage=stage)


def _deep(found: Scan, scale: float) -> Scan:
    return replace(found, stage=found.stage * [1, 1, scale])


REFUSED: list[tuple[Callable[[], Scan], str]] = [
    (lambda: scan((-40e3, -10e3, 10e3)), "2 planes of 7 across and 4 down, as in the plan, got 3 planes"),
    (lambda: scan(shape=(ROWS, 6)), "got 2 planes of 6 along x and 4 along y"),
    (lambda: _moved(scan(), 0.45), "position of 0005.tif: expected at most half a step"),
    (lambda: _moved(scan(), 1.0), "position z=0, y=0, x=6: expected 1 frame"),
    (lambda: replace(s := scan(), stage=s.stage * [1.5, 1.5, 1]), "1.5 times as much"),
    (lambda: _deep(scan(), 1 / 3), "z of the planes: expected the spacing of the planned planes, got 0.333"),
    (lambda: _deep(scan(), 1e-3), "correct unit or column (--columns z_mm=…)"),
    (lambda: _deep(scan(), 1e3), "z of the planes: expected the spacing of the planned planes, got 1e+03"),
]


def test_another_scan_is_refused() -> None:
    for make, words in REFUSED:
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


def test_the_plan_of_a_list_says_what_it_assumes_and_what_is_missing() -> None:
    plan, notes = plan_of_list(listing_of(scan()), small_camera(), cutout=(9, 11))
    assert plan.period == (ROWS, COLUMNS)
    assert any("(--anchor)" in note for note in notes) and any("(--stage)" in note for note in notes)
    same, narrow = scan(), scan(shape=(ROWS, 6))
    same.stage[same.positions[:, 0] == 1, :2] = same.stage[same.positions[:, 0] == 0, :2]
    columns = "columns of positions in the list: expected 7, a whole number of the camera's periods, got 6"
    unit = r"1000 times as large would fit; state the unit in .*\(--columns x_mm=COLUMN"
    for listing, how, words in (
        (listing_of(narrow), {}, columns),
        (listing_of(same), {}, "longer in farther planes"),
        (listing_of(scan()), {"depths_um": (0.0,)}, "expected 2 as in the list, got 1"),
        (listing_of(scan(), scale=1e-3), {}, unit),
        (listing_of(narrow, unit="index"), {}, "stage coordinates, got position numbers"),
    ):
        with pytest.raises(InputError, match=words):
            plan_of_list(listing, small_camera(), **how)  # type: ignore[arg-type]


def test_damaged_frames_are_left_out_of_the_search_for_light() -> None:
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


# -- depths of planes --------------------------------------------------------------------------------------------------


DEPTHS = (-40e3, -10e3, 10e3)


def planes_of(
    *, scale: float = 1.0, error: float = 0.001, counted: bool = False, depths: tuple[float, ...] = DEPTHS
) -> ListedPlanes:
    """Return the planes of a list whose z is ``scale`` times the depth."""
    camera = small_camera()
    sizes = np.array([step_um(camera, z) for z in depths])
    heights = np.arange(len(depths), dtype=float) if counted else np.array(depths) * scale + 5e3
    return ListedPlanes("stage.csv", heights, sizes, np.full(len(depths), error), counted)


def depths_of(planes: ListedPlanes, camera: Camera | None = None) -> Depths:
    return find_depths(camera or small_camera(), StageAxes(), planes)


def stated(words: str, what: str) -> float:
    found = re.search(rf"± (\S+) µm for {what}", words)
    assert found, words
    return float(found[1])


def test_a_z_is_taken_without_a_remark_where_it_fits_its_steps_or_lies_within_the_errors() -> None:
    found = depths_of(planes_of())
    np.testing.assert_allclose(found.depths, DEPTHS, atol=0.01)
    error = 0.1 * float(np.ptp(planes_of().sizes))
    for one in (found, depths_of(planes_of(scale=1.1, error=error))):
        assert len(one.notes) == 1 and "single ones" not in one.notes[0]
    assert not re.search("part", " ".join(depths_of(planes_of(scale=1.005)).notes)), "half a per cent is no remark"


def test_a_z_of_another_scale_is_reported_and_within_the_error() -> None:
    for scale in (0.6, 0.97, 1.05, 1.8):
        found = depths_of(planes_of(scale=scale))
        words, note = found.notes
        apart = np.abs(np.array(found.depths) - DEPTHS).max()
        assert stated(words, "one") == pytest.approx(apart, rel=0.01)
        assert f"its range is {scale:.3f} times the range that the steps of the planes imply" in note
        assert "check unit and scale" in note
    planes = planes_of()
    found = depths_of(replace(planes, heights=planes.heights + np.array([0.0, 4e3, 0.0])))
    assert stated(found.notes[0], "one") == pytest.approx(2 / 3 * 4e3, rel=0.01) and len(found.notes) == 2


def test_a_z_of_another_unit_is_refused() -> None:
    what = (
        "z of the planes: expected a range of about .* µm, inferred from the steps of its planes, got .* µm; check unit"
    )
    for scale, words in (
        (3.0, what),
        (1e-3, r"got 50 µm; is z in mm\? state its unit \(--columns z_mm=COLUMN\)"),
        (1e3, r"is z in um\? state its unit \(--columns z_um=COLUMN\)"),
    ):
        with pytest.raises(InputError, match=words):
            depths_of(planes_of(scale=scale))


def test_steps_that_are_too_noisy_leave_the_axis_as_stated() -> None:
    """Planes so near each other that the stage's scatter hides which steps are longer."""
    planes = planes_of(error=1.0, depths=(-100.0, 0.0))
    assert depths_of(replace(planes, sizes=planes.sizes[::-1])).axes.away == "+z"
    assert depths_of(replace(planes_of(), sizes=planes_of().sizes[::-1])).axes.away == "-z"


def test_numbered_planes_have_the_depths_of_their_steps() -> None:
    found = depths_of(planes_of(counted=True))
    np.testing.assert_allclose(found.depths, DEPTHS, atol=0.01)
    rising = (small_camera().step_um(1e3) - small_camera().step_um(0.0)) / 1e3
    assert stated(found.notes[0], "each") == pytest.approx(0.001 / rising, rel=0.01)
    np.testing.assert_allclose(depths_of(planes_of(counted=True, depths=DEPTHS[::-1])).depths, DEPTHS[::-1], atol=0.01)
    with pytest.raises(InputError, match="steps of its planes: expected steps of one pixel each, which increase"):
        depths_of(planes_of(counted=True, depths=(-40e3, 10e3, -10e3)))
    with pytest.raises(InputError, match="expected 3 as in the list, got 1"):
        find_depths(small_camera(), StageAxes(), planes_of(counted=True), (0.0,))


def test_numbered_planes_of_a_microscope_have_to_be_given() -> None:
    camera = preset("lfm_20x05")
    with pytest.raises(InputError, match="got plane numbers; state one depth for each number"):
        depths_of(planes_of(counted=True), camera)
    found = find_depths(camera, StageAxes(), planes_of(counted=True), (20.0, 10.0, 0.0))
    assert found.depths == (20.0, 10.0, 0.0)


def test_errors_of_rounded_lists_are_of_the_size_of_what_is_wrong() -> None:
    """Whatever the place where the scan begins: frames of a row share their rounding, and do not average it out."""
    planned = ScanPlan.for_camera(preset("bench"), depths_um=(-26e3, -20e3), cutout=1)
    rng = np.random.default_rng(4)
    pulls = []
    for _ in range(30):
        places = np.round(planned.stage_um() + rng.uniform(-500, 500, 3))
        files = tuple(f"{k}.tif" for k in range(len(places)))
        listing = Listing("stage.csv", files, (0,) * len(files), places, "um")
        plan, notes = plan_of_list(listing, planned.camera, cutout=1)
        wrong = np.mean(plan.depths_um) - np.mean(planned.depths_um)
        pulls.append(wrong / stated(next(note for note in notes if note.startswith("depths:")), "all"))
    assert 0.4 < np.sqrt(np.mean(np.square(pulls))) < 1.5 and np.abs(pulls).max() < 4


def test_given_depths_fall_where_the_steps_of_numbered_planes_do() -> None:
    """From the first plane to the last: one between them may have a step that is off."""
    planes = planes_of(counted=True, depths=DEPTHS[::-1])
    odd = replace(planes, sizes=planes.sizes * np.array([1.0, 1.3, 1.0]))
    assert find_depths(small_camera(), StageAxes(), odd, DEPTHS).depths == DEPTHS[::-1]


# -- errors of steps ---------------------------------------------------------------------------------------------------


TRIES = 60


def pulls_of(
    *,
    step: float | None = None,
    digit: float = 0.0,
    scatter: float = 0.0,
    columns: float = 0.0,
    turn: float = 0.0,
    shape: tuple[int, int] = (33, 19),
) -> np.ndarray:
    """Return errors of the step of scans that begin anywhere, each over its stated error."""
    rng = np.random.default_rng(1)
    index = np.array(list(np.ndindex(*shape)))
    found = []
    for _ in range(TRIES):
        true = rng.uniform(24, 26) if step is None else step
        rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        places = index * true @ rotation + rng.uniform(-500, 500, 2) + rng.normal(0, 1, index.shape) * scatter
        shared = [rng.normal(0, 1, n)[index[:, k]] * columns for k, n in enumerate(shape)]
        places += np.stack(shared, axis=1)
        places = np.round(places / digit) * digit if digit else places
        (plane,) = find_grid(places, np.zeros(len(places)), "list").planes
        found.append((step_size(plane.steps) - true) / step_error(places, plane))
    return np.array(found)


ROUNDED = {
    "rounded": {"digit": 1.0},
    "rounded finely": {"digit": 0.1},
    "rounded to quarters": {"digit": 0.25},
    "rounded alike in all columns": {"step": 24.994, "digit": 1.0},
    "rounded coarsely": {"digit": 2.5},
    "a single row": {"digit": 1.0, "shape": (33, 1)},
    "few columns": {"digit": 1.0, "shape": (7, 4)},
    "scattered": {"scatter": 1.0},
    "scattered and rounded": {"scatter": 0.5, "digit": 1.0},
    "columns scattered as a whole": {"columns": 1.0},
    "turned and scattered": {"scatter": 1.0, "turn": 0.1},
}


@pytest.mark.few(3)
@pytest.mark.parametrize("case", ROUNDED)
def test_errors_of_steps_are_as_stated(case: str) -> None:
    pulls = pulls_of(**ROUNDED[case])  # type: ignore[arg-type]
    assert 0.5 < np.sqrt(np.mean(pulls**2)) < 1.4 and np.abs(pulls).max() < 5


def test_the_error_of_a_turned_rounded_list_is_not_too_small() -> None:
    assert np.sqrt(np.mean(pulls_of(digit=1.0, turn=0.1) ** 2)) < 1.4


def test_steps_of_whole_digits_are_not_exact() -> None:
    """All places lie on a grid of 25, which every step from 24.97 to 25.03 is rounded to; one place has no step."""
    index = np.array(list(np.ndindex(33, 19)))
    places = 25.0 * index + 3
    (plane,) = find_grid(places, np.zeros(len(places)), "list").planes
    assert 1 / 33 / 5 < step_error(places, plane) < 1 / 33
    (plane,) = find_grid(np.zeros((1, 2)), np.zeros(1), "list").planes
    assert step_error(np.zeros((1, 2)), plane) == 0
    values = {(12.5, 100.0, -7.25): 0.25, (1000.0, 1025.0): 2.5, (1.0, 2.5, 4.1): 0.1, (math.pi, math.e): 0.0}
    for numbers, digit in values.items():
        assert rounding(np.array(numbers), 25.0) == pytest.approx(digit)
