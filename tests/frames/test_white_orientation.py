"""A white image that is flipped or turned against its camera is called so, by lens types and places."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from lfcal.frames.orientation import ORIENTATIONS
from lfcal.frames.white_orientation import TurnedWhite, compared_orientations
from lfcal.lattice.camera_check import FITS, WRONG, check_camera
from tests.lattice.white_frames import draw_white

SHAPE, PIXEL = (230, 270), 5.0
OFFSET = (4.3, -6.2)
"""Of a lenslet of type 0 from the frame's centre (row, column)."""


def camera(kind: str = "hexagonal", shape: tuple[int, int] = SHAPE, rotation: float = 0.004) -> Camera:
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))[: 3 if kind == "hexagonal" else 1]
    offset = (OFFSET[1] * PIXEL, OFFSET[0] * PIXEL)
    lattice = LensletLattice(kind, 16.0 * PIXEL, 400.0, types, rotation, offset)
    return Camera("c", MainLens(), lattice, Sensor(shape, PIXEL))


@lru_cache
def drawn(kind: str = "hexagonal", shape: tuple[int, int] = SHAPE) -> NDArray[np.uint16]:
    edges = (3.9, 2.6, 1.6) if kind == "hexagonal" else (1.0,)
    return draw_white(shape, pitch=16.0, kind=kind, edges=edges, fill=0.85, rotation=0.004, offset=OFFSET).frame


def found(described: Camera, delivered: NDArray[np.uint16]) -> tuple[TurnedWhite | None, str]:
    check, turned = compared_orientations(check_camera(described, delivered, dark=100.0), described)
    return turned, check.verdict


@pytest.mark.parametrize("name", ["as is", "mirror x", "mirror y", "rot180"])
def test_three_lens_types_and_places_tell_the_orientation(name: str) -> None:
    turned, verdict = found(camera(), ORIENTATIONS[name].inverse.apply(drawn()))
    if name == "as is":
        assert turned is None and verdict == FITS
        return
    assert turned is not None and verdict == WRONG
    assert [turn.name for turn in turned.turns] == [name]
    assert turned.away_px < 0.2 and turned.as_is_px > 1
    # the mirror image about a row of lenslets keeps the order along the row
    assert (turned.sigmas is not None and turned.sigmas > 5) == (name != "mirror y")
    assert ORIENTATIONS[name].words in turned.words and turned.options == f"--orientation {ORIENTATIONS[name].option}"


@pytest.mark.parametrize("name", ["as is", "mirror x", "mirror y", "rot90", "transpose"])
def test_a_square_array_on_a_square_sensor(name: str) -> None:
    turned, verdict = found(camera("square", (240, 240)), ORIENTATIONS[name].inverse.apply(drawn("square", (240, 240))))
    if name == "as is":
        assert turned is None and verdict == FITS
    else:
        assert turned is not None and [turn.name for turn in turned.turns] == [name] and turned.sigmas is None


def test_where_nothing_but_the_order_of_types_tells_all_that_fit_are_named() -> None:
    """Without a measured offset and with straight rows, mirrored and turned by 180° look alike."""
    described = camera(rotation=0.0)
    described = replace(
        described, marks=described.marks.marked(["lattice.offset_um", "lattice.rotation_rad"], "assumed")
    )
    turned, verdict = found(described, ORIENTATIONS["mirror x"].inverse.apply(drawn()))
    assert turned is not None and verdict == WRONG
    assert {turn.name for turn in turned.turns} == {"mirror x", "rot180"}
    assert turned.options.count("--orientation") == 2


def test_other_differences_are_no_orientation() -> None:
    longer = replace(camera(), lattice=replace(camera().lattice, pitch_um=17.5 * PIXEL))
    elsewhere = replace(camera(), lattice=replace(camera().lattice, offset_um=(11.0, 30.0)))
    unknown = replace(camera(), lattice=replace(camera().lattice, type_step=2))
    unknown = replace(unknown, marks=unknown.marks.marked(["lattice.type_step"], "assumed"))
    for described in (longer, elsewhere, unknown):
        turned, _ = found(described, drawn())
        assert turned is None
    blank = camera("square")
    check, turned = compared_orientations(check_camera(blank, drawn()), blank)
    assert turned is None and check.camera is None


def test_a_part_of_the_sensor_gives_the_camera_of_the_whole() -> None:
    """The lattice of a part, measured, is that of the whole image, wherever the description counts it from."""
    whole = check_camera(camera(), drawn(), dark=100.0)
    part = check_camera(camera(), drawn()[17:, 40:230], dark=100.0, origin=(17, 40))
    assert part.verdict == whole.verdict == FITS
    assert part.camera is not None and part.camera.sensor.shape == SHAPE
    rows, columns = np.mgrid[30:210:30, 50:220:30].astype(float)
    points = part.camera.sensor_um(np.stack([rows, columns], axis=-1).reshape(-1, 2))
    assert whole.camera is not None
    index = part.camera.lattice.lenslet_at(points)
    centres = part.camera.lattice.centres_um(*np.rint(index).T)
    back = whole.camera.lattice.lenslet_at(centres)
    away = (back - np.rint(back)) @ whole.camera.lattice.basis_um() / PIXEL
    assert np.hypot(*away.T).max() < 0.2
    np.testing.assert_array_equal(part.camera.lattice.type_at(centres), whole.camera.lattice.type_at(centres))
