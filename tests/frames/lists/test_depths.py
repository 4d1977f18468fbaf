"""Depths of a list's planes: z of the stage held against the steps, and errors that cover what is open."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, ScanPlan, StageAxes, preset
from lfcal.frames.lists._depths import Depths, ListedPlanes, find_depths
from lfcal.frames.lists.derived import plan_of_list
from lfcal.frames.lists.listing import Listing
from tests.frames.lists.scans import small_camera, step_um

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


def test_a_z_that_fits_its_steps_is_taken_without_a_word() -> None:
    found = depths_of(planes_of())
    np.testing.assert_allclose(found.depths, DEPTHS, atol=0.01)
    assert len(found.notes) == 1 and "single ones" not in found.notes[0]
    assert not re.search("part", " ".join(depths_of(planes_of(scale=1.005)).notes)), "half a per cent is not told"


@pytest.mark.parametrize("scale", [0.6, 0.97, 1.05, 1.8])
def test_a_z_of_another_scale_is_told_and_within_the_error(scale: float) -> None:
    found = depths_of(planes_of(scale=scale))
    words, note = found.notes
    apart = np.abs(np.array(found.depths) - DEPTHS).max()
    assert stated(words, "one") == pytest.approx(apart, rel=0.01)
    assert (
        f"its range is {scale:.3f} times the range that the steps of the planes imply" in note
        and "check unit and scale" in note
    )


def test_a_single_plane_that_lies_elsewhere_is_told() -> None:
    planes = planes_of()
    found = depths_of(replace(planes, heights=planes.heights + np.array([0.0, 4e3, 0.0])))
    assert stated(found.notes[0], "one") == pytest.approx(2 / 3 * 4e3, rel=0.01) and len(found.notes) == 2


def test_what_lies_within_the_errors_is_not_told() -> None:
    error = 0.1 * float(np.ptp(planes_of().sizes))
    found = depths_of(planes_of(scale=1.1, error=error))
    assert len(found.notes) == 1 and "single ones" not in found.notes[0]


@pytest.mark.parametrize(
    ("scale", "words"),
    [
        (
            3.0,
            "z of the planes: expected a range of about .* µm, inferred from the steps of its planes, got .* µm; "
            "check unit",
        ),
        (1e-3, r"got 50 µm; is z in mm\? state its unit \(--columns z_mm=COLUMN\)"),
        (1e3, r"is z in um\? state its unit \(--columns z_um=COLUMN\)"),
    ],
)
def test_a_z_of_another_unit_is_refused(scale: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        depths_of(planes_of(scale=scale))


def test_steps_that_tell_nothing_leave_the_axis_as_it_is_said() -> None:
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
