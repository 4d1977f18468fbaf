"""The eight flips and turns against numpy's own, and white images that are flipped or turned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from lfcal.frames import (
    AS_IS,
    ORIENTATIONS,
    ArraySource,
    CorrectionChain,
    Dark,
    FrameSource,
    Noise,
    Orientation,
    OrientedSource,
    Position,
    corrected,
    named_orientation,
)
from lfcal.frames.orientation import oriented
from lfcal.frames.white_orientation import TurnedWhite, compared_orientations
from lfcal.lattice.camera_check import FITS, WRONG, check_camera
from tests.lattice.white_frames import draw_white

NUMPY: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "as is": lambda f: f,
    "rot90": np.rot90,
    "rot180": lambda f: np.rot90(f, 2),
    "rot270": lambda f: np.rot90(f, 3),
    "mirror x": np.fliplr,
    "mirror y": np.flipud,
    "transpose": np.transpose,
    "anti-transpose": lambda f: np.rot90(f, 2).T,
}
FRAME = np.arange(35).reshape(5, 7)


@pytest.mark.parametrize("name", NUMPY)
def test_arrays_places_and_regions_turn_together(name: str) -> None:
    one = ORIENTATIONS[name]
    turned = NUMPY[name](FRAME)
    assert np.array_equal(one.apply(FRAME), turned)
    assert one.shape(FRAME.shape) == turned.shape
    places = np.argwhere(np.ones(FRAME.shape, bool))
    assert np.array_equal(turned[tuple(one.places(places, FRAME.shape).astype(int).T)], FRAME.ravel())
    region = np.s_[1:4, 2:5]
    assert np.array_equal(one.apply(FRAME[one.region(region, FRAME.shape)]), turned[region])
    assert np.array_equal(one.inverse.apply(one.apply(FRAME)), FRAME)
    assert np.allclose(one.moves() @ one.inverse.moves(), np.eye(2))


def test_all_eight_differ_and_are_known_by_both_spellings() -> None:
    assert set(NUMPY) == set(ORIENTATIONS)
    assert len({one.apply(FRAME).tobytes() for one in ORIENTATIONS.values()}) == 8
    assert len({tuple(one.moves().ravel()) for one in ORIENTATIONS.values()}) == 8
    assert named_orientation("mirror-x") is named_orientation("mirror x") is ORIENTATIONS["mirror x"]
    assert named_orientation("as-is").name == AS_IS
    with pytest.raises(InputError, match="orientation: expected as-is, rot90"):
        named_orientation("rot45")
    # the words describe the frames: a letter L that was turned clockwise is put right by numpy's anticlockwise rot90
    letter = np.array([[1, 0], [1, 0], [1, 1]])
    assert np.array_equal(ORIENTATIONS["rot90"].apply(np.rot90(letter, -1)), letter)
    words = ORIENTATIONS["rot90"].words
    assert "clockwise by 90°" in words and not words.startswith("turned anti")


UPRIGHT = np.arange(3 * 6 * 8, dtype=np.uint16).reshape(3, 6, 8) * 7 + 100
POSITIONS = [Position(0, 0, k) for k in range(3)]


def delivered(frames: np.ndarray, turn: Orientation) -> np.ndarray:
    """Return frames of which ``turn`` makes the given ones."""
    return np.stack([turn.inverse.apply(frame) for frame in frames])


@pytest.mark.parametrize("name", NUMPY)
def test_corrected_frames_turn_as_a_whole_and_in_part(name: str) -> None:
    turn = ORIENTATIONS[name]
    dark = np.random.default_rng(1).integers(0, 90, (6, 8)).astype(np.float32)
    chain = CorrectionChain((Dark(np.ascontiguousarray(turn.inverse.apply(dark))),))
    source = OrientedSource(corrected(ArraySource(delivered(UPRIGHT, turn), POSITIONS), chain), turn)
    assert source.shape == (6, 8)
    assert np.array_equal(source.read(1), UPRIGHT[1] - dark)
    assert np.array_equal(source.read(2, np.s_[1:3, 4:8]), (UPRIGHT[2] - dark)[1:3, 4:8])
    assert np.array_equal(source.samples(2, np.s_[0:6, 5:7]).values, (UPRIGHT[2] - dark)[:, 5:7])
    assert source.info(1).position == POSITIONS[1]
    assert source.info(1).origin == (0, 0)
    assert source.metadata.orientation == name


@pytest.mark.parametrize("name", NUMPY)
def test_masks_saturated_samples_and_cutouts_turn_along(name: str) -> None:
    turn = ORIENTATIONS[name]
    mask = np.ones((6, 8), bool)
    mask[0, :3] = False
    frames = UPRIGHT.copy()
    frames[0, 4, 6] = 4095
    known = {"mask": turn.inverse.apply(mask), "metadata": {"saturation": 4095.0}}
    source = OrientedSource(ArraySource(delivered(frames, turn), POSITIONS, **known), turn)
    seen, found = source.info(0).mask, source.samples(0)
    assert seen is not None and np.array_equal(seen, mask)
    assert found.saturated == 1 and found.valid is not None
    assert np.array_equal(~found.valid, ~mask | (frames[0] == 4095))
    # a cutout keeps its place on the turned sensor
    sensor = np.random.default_rng(2).integers(0, 1000, (20, 30)).astype(np.uint16)
    inner = ArraySource(sensor[4:9, 9:16][None], POSITIONS[:1], origins=[(4, 9)])
    source = OrientedSource(inner, turn, sensor.shape)
    (top, left), (rows, columns) = source.info(0).origin, source.shape
    assert np.array_equal(source.read(0), turn.apply(sensor)[top : top + rows, left : left + columns])


@pytest.mark.parametrize("name", NUMPY)
def test_the_noise_of_each_sample_turns_along(name: str) -> None:
    """With a dark, each sample has a variance of its own: it stayed where it was, or was of another shape."""
    turn = ORIENTATIONS[name]
    dark = np.random.default_rng(3).integers(0, 90, (6, 8)).astype(np.float32)
    known = {"noise": Noise(4.0, 0.5)}

    def seen(orientation: Orientation) -> FrameSource:
        """Return corrected frames of which ``orientation`` makes upright ones."""
        chain = CorrectionChain((Dark(np.ascontiguousarray(orientation.inverse.apply(dark)), count=2),))
        source = corrected(ArraySource(delivered(UPRIGHT, orientation), POSITIONS, metadata=known), chain)
        return OrientedSource(source, orientation)

    for region in (None, np.s_[1:4, 2:8]):
        wanted, found = seen(ORIENTATIONS["as is"]).samples(1, region), seen(turn).samples(1, region)
        assert wanted.noise is not None and found.noise is not None
        assert isinstance(wanted.noise.constant, np.ndarray) and wanted.noise.constant.std() > 0
        for one, other in zip(found.noise[:2], wanted.noise[:2], strict=True):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(found.noise.variance(found.values), wanted.noise.variance(wanted.values))


def test_cutouts_and_regions_off_the_turned_sensor_are_refused() -> None:
    inner = ArraySource(UPRIGHT[:1], POSITIONS[:1], origins=[(4, 9)])
    with pytest.raises(InputError, match="on the sensor of 6 x 8 px"):
        OrientedSource(inner, ORIENTATIONS["mirror x"]).info(0)
    source = OrientedSource(ArraySource(UPRIGHT, POSITIONS), ORIENTATIONS["rot90"])
    assert source.read(0, np.s_[7:8, 0:6]).shape == (1, 6)
    with pytest.raises(InputError, match="region columns"):
        source.read(0, np.s_[0:2, 0:8])
    for k in range(3):  # one cutout among whole frames is placed on the sensor
        origins = [(2, 3) if n == k else (0, 0) for n in range(3)]
        turned = oriented(ArraySource(UPRIGHT, POSITIONS, origins=origins), ORIENTATIONS["rot180"], (20, 30))
        assert turned.info(k).origin == (20 - 6 - 2, 30 - 8 - 3)


# -- white images ------------------------------------------------------------------------------------------------------


SHAPE, PIXEL = (190, 230), 5.0
OFFSET = (4.3, -6.2)
"""Of a lenslet of type 0 from the frame's centre (row, column)."""


def white_camera(kind: str = "hexagonal", shape: tuple[int, int] = SHAPE, rotation: float = 0.004) -> Camera:
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))[: 3 if kind == "hexagonal" else 1]
    offset = (OFFSET[1] * PIXEL, OFFSET[0] * PIXEL)
    lattice = LensletLattice(kind, 16.0 * PIXEL, 400.0, types, rotation, offset)
    return Camera("c", MainLens(), lattice, Sensor(shape, PIXEL))


@lru_cache
def drawn(kind: str = "hexagonal", shape: tuple[int, int] = SHAPE) -> NDArray[np.uint16]:
    edges = (3.9, 2.6, 1.6) if kind == "hexagonal" else (1.0,)
    return draw_white(shape, pitch=16.0, kind=kind, edges=edges, fill=0.85, rotation=0.004, offset=OFFSET).frame


def compared(described: Camera, white: NDArray[np.uint16]) -> tuple[TurnedWhite | None, str]:
    check, turned = compared_orientations(check_camera(described, white, dark=100.0), described)
    return turned, check.verdict


@pytest.mark.parametrize("name", ["as is", "mirror x", "mirror y", "rot180"])
def test_three_lens_types_and_places_show_the_orientation(name: str) -> None:
    turned, verdict = compared(white_camera(), ORIENTATIONS[name].inverse.apply(drawn()))
    if name == "as is":
        assert turned is None and verdict == FITS
        return
    assert turned is not None and verdict == WRONG
    assert [turn.name for turn in turned.turns] == [name]
    assert turned.away_px < 0.2 and turned.as_is_px > 1
    # the mirror image about a row of lenslets keeps the order along the row
    assert (turned.sigmas is not None and turned.sigmas > 5) == (name != "mirror y")
    assert ORIENTATIONS[name].words in turned.words and turned.options == f"--orientation {ORIENTATIONS[name].option}"


@pytest.mark.parametrize("name", ["as is", "mirror x", "rot90", "transpose"])
def test_a_square_array_on_a_square_sensor(name: str) -> None:
    white = ORIENTATIONS[name].inverse.apply(drawn("square", (240, 240)))
    turned, verdict = compared(white_camera("square", (240, 240)), white)
    if name == "as is":
        assert turned is None and verdict == FITS
    else:
        assert turned is not None and [turn.name for turn in turned.turns] == [name] and turned.sigmas is None


def test_where_only_the_order_of_types_counts_all_orientations_that_fit_are_named() -> None:
    """Without a measured offset and with straight rows, mirrored and turned by 180° look alike."""
    described = white_camera(rotation=0.0)
    described = replace(
        described, marks=described.marks.marked(["lattice.offset_um", "lattice.rotation_rad"], "assumed")
    )
    turned, verdict = compared(described, ORIENTATIONS["mirror x"].inverse.apply(drawn()))
    assert turned is not None and verdict == WRONG
    assert {turn.name for turn in turned.turns} == {"mirror x", "rot180"}
    assert turned.options.count("--orientation") == 2


@pytest.mark.parametrize(
    "different", ["pitch", *(pytest.param(one, marks=pytest.mark.long) for one in ("offset", "type_step"))]
)
def test_other_differences_are_no_orientation(different: str) -> None:
    longer = replace(white_camera(), lattice=replace(white_camera().lattice, pitch_um=17.5 * PIXEL))
    elsewhere = replace(white_camera(), lattice=replace(white_camera().lattice, offset_um=(11.0, 30.0)))
    unknown = replace(white_camera(), lattice=replace(white_camera().lattice, type_step=2))
    unknown = replace(unknown, marks=unknown.marks.marked(["lattice.type_step"], "assumed"))
    turned, _ = compared({"pitch": longer, "offset": elsewhere, "type_step": unknown}[different], drawn())
    assert turned is None


def test_a_lattice_that_does_not_fit_has_no_orientation() -> None:
    blank = white_camera("square")
    check, turned = compared_orientations(check_camera(blank, drawn()), blank)
    assert turned is None and check.camera is None


def test_a_part_of_the_sensor_gives_the_camera_of_the_whole() -> None:
    """The lattice of a part, measured, is that of the whole image, wherever the description counts it from."""
    whole = check_camera(white_camera(), drawn(), dark=100.0)
    part = check_camera(white_camera(), drawn()[17:, 40:200], dark=100.0, origin=(17, 40))
    assert part.verdict == whole.verdict == FITS
    assert part.camera is not None and part.camera.sensor.shape == SHAPE
    rows, columns = np.mgrid[30:170:30, 50:190:30].astype(float)
    points = part.camera.sensor_um(np.stack([rows, columns], axis=-1).reshape(-1, 2))
    assert whole.camera is not None
    index = part.camera.lattice.lenslet_at(points)
    centres = part.camera.lattice.centres_um(*np.rint(index).T)
    back = whole.camera.lattice.lenslet_at(centres)
    away = (back - np.rint(back)) @ whole.camera.lattice.basis_um() / PIXEL
    assert np.hypot(*away.T).max() < 0.2
    np.testing.assert_array_equal(part.camera.lattice.type_at(centres), whole.camera.lattice.type_at(centres))
