"""Frames that are mirrored while a stage axis is reversed: patterns show it, the path of the light does not."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.campaign.turned_frames import SeenPattern, find_turned_frames, seen_patterns
from lfcal.frames import ORIENTATIONS
from lfcal.frames.lists.listing import Listing
from lfcal.simulate import SimulatedCamera
from lfcal.tasks.plan import _tell_turned

Scan = tuple[ScanPlan, NDArray[np.uint16], NDArray[np.intp]]


def camera() -> Camera:
    """Return a camera whose array is not symmetric about the middle of the sensor."""
    known = preset("bench")
    lattice = replace(known.lattice, offset_um=(20.0, 22.0))
    return replace(known, lattice=lattice, sensor=replace(known.sensor, shape=(160, 180)))


@pytest.fixture(scope="module")
def scan() -> Scan:
    """Return a plan, upright frames of some of its positions, and these."""
    plan = ScanPlan.for_camera(camera(), virtual_depths=(2.5, 4.0), cutout=(49, 49))
    source = SimulatedCamera(plan)
    index = {tuple(source.position(k)): k for k in range(len(source))}
    ny, nx = plan.period
    wanted = [(z, y, x) for z in range(2) for y, x in ((ny // 4, nx // 4), (3 * ny // 4, 3 * nx // 4))]
    return plan, np.stack([source.read(index[one]) for one in wanted]), np.array(wanted)


def seen(plan: ScanPlan, frames: NDArray[np.uint16], places: NDArray[np.intp], name: str) -> list[SeenPattern]:
    turn = ORIENTATIONS[name].inverse
    return seen_patterns(lambda k: turn.apply(frames[k]), places, plan)


@pytest.mark.parametrize(
    "name", ["mirror x", *(pytest.param(one, marks=pytest.mark.long) for one in ("mirror y", "rot180"))]
)
def test_patterns_show_how_frames_are_turned(scan: Scan, name: str) -> None:
    plan = scan[0]
    found = find_turned_frames(seen(*scan, name), plan)
    assert found is not None and found.turns[0].name == name
    assert found.residual < 0.2 and found.as_is > 2 * found.residual
    assert ORIENTATIONS[name].words in found.words and ORIENTATIONS[name].option in found.options


def test_patterns_show_the_orientation_of_a_known_camera(scan: Scan) -> None:
    plan, known = scan[0], scan[0].camera
    assert find_turned_frames(seen(*scan, "as is"), plan) is None
    patterns = seen(*scan, "mirror x")
    assumed = replace(known, marks=known.marks.marked(["lattice.offset_um"], "assumed"))
    other = replace(known, lattice=replace(known.lattice, pitch_um=known.lattice.pitch_um * 1.3))
    for camera in (assumed, other):
        assert find_turned_frames(patterns, replace(plan, camera=camera)) is None
    assert find_turned_frames([], plan) is None


def test_plan_calls_mirrored_frames_mirrored(scan: Scan, caplog: pytest.LogCaptureFixture) -> None:
    """What `lfcal plan --positions` says of its list: a warning with the option that turns them."""
    plan, frames, places = scan
    positions = np.array(list(np.ndindex(plan.shape[:3])))
    near = {tuple(place): k for k, place in enumerate(places.tolist())}
    names = tuple(f"{k}.tif" for k in range(len(positions)))
    listing = Listing("list", names, (0,) * len(names), plan.stage_um(positions), "um")

    def read(k: int) -> NDArray[np.uint16]:
        z, y, x = positions[k].tolist()
        return frames[near[z, y, x]][:, ::-1]

    _tell_turned(listing, plan, read)
    ((_, level, said),) = caplog.record_tuples
    assert level == logging.WARNING and said.startswith("the frames are mirrored left to right relative to the camera")
    assert "make the plan again with --orientation mirror-x, and assemble with the same option" in said
    _tell_turned(listing, plan, lambda k: read(k)[:, ::-1])
    assert len(caplog.records) == 1
