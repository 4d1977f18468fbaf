from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import FileFormatError, InputError, StorageError, UnsafeFileError
from lfcal.camera import Camera, LensletLattice, MainLens, ScanPlan, Sensor, read_raytrix_xml

REAL = Path(__file__).parents[4] / "shared/data/raytrix_r29/r29_calibration.xml"
needs_real = pytest.mark.skipif(not REAL.exists(), reason=f"{REAL} is not on this machine")

S = math.sqrt(3) / 2
BASES = {
    "right": ((1.0, 0.0), (0.5, S)),
    "left": ((-1.0, 0.0), (-0.5, -S)),
    "obtuse": ((1.0, 0.0), (-0.5, S)),
    "down": ((0.5, -S), (1.0, 0.0)),
    "up-left": ((-0.5, S), (0.5, S)),
}
OFFSETS = {
    "left first": ((0.0, 0.0), (-1.0, 0.0), (1.0, 0.0)),
    "right first": ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0)),
    "type 0 elsewhere": ((1.0, 0.0), (0.0, 0.0), (0.5, S)),
    "far away": ((0.0, 0.0), (2.0, 0.0), (-0.5, S * 3)),
}


def xml(
    bases: tuple[tuple[float, float], ...] = BASES["left"],
    offsets: tuple[tuple[float, float], ...] = OFFSETS["left first"],
    rotation: float = 2.5e-5,
    offset: tuple[float, float] = (22.07, 8.62),
    diameter: float = 38.3737792969,
) -> str:
    """Return the text of a calibration file with these numbers."""

    def vector(pair: tuple[float, float]) -> str:
        return f"<x>{pair[0]!r}</x><y>{pair[1]!r}</y>"

    types = "".join(
        f'<lens_type id="{k}"><offset units="lens">{vector(pair)}</offset><depth_range units="virtual_depth">'
        f"<min>{1 + k}</min><max>{3 + k}</max></depth_range></lens_type>"
        for k, pair in enumerate(offsets)
    )
    return (
        f'<?xml version="1.0"?><RayCalibData version="1.0"><offset units="pix">{vector(offset)}</offset>'
        f'<diameter units="pix">{diameter!r}</diameter><rotation units="rad">{rotation!r}</rotation>'
        f'<lens_border units="pix">1</lens_border><tcp units="virtual_depth">2.1</tcp>'
        f'<lens_base_x units="lens">{vector(bases[0])}</lens_base_x>'
        f'<lens_base_y units="lens">{vector(bases[1])}</lens_base_y>'
        f'<sub_grid_base units="lens">{vector((-3.0, -2 * S))}</sub_grid_base>'
        f'<distortion type="radial"><function>Brown</function><parameter count="2">-0.0015;0.0007</parameter>'
        f'<offset units="pix"><x>3186.7</x><y>2651.1</y></offset></distortion>{types}</RayCalibData>'
    )


def straight_from_the_file(
    bases: tuple[tuple[float, float], ...],
    offsets: tuple[tuple[float, float], ...],
    rotation: float,
    offset: tuple[float, float],
    diameter: float,
    shape: tuple[int, int],
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Build lens positions (row, column) and types as the file states them, in its y-up plane, by brute force.

    Two lenses are of one type if they differ by a whole combination of the vectors that join next neighbours
    of one type: (3/2, sqrt(3)/2) and (3/2, -sqrt(3)/2) lenses.
    """
    i, j = (v.ravel() for v in np.meshgrid(np.arange(-12, 13), np.arange(-12, 13)))
    unit = i[:, None] * np.array(bases[0]) + j[:, None] * np.array(bases[1])
    same = np.linalg.inv(np.array([[1.5, S], [1.5, -S]]))
    kinds = np.full(len(unit), -1, np.intp)
    for k, place in enumerate(offsets):
        index = (unit - place) @ same
        kinds[np.abs(index - np.rint(index)).max(1) < 1e-3] = k
    assert set(kinds) == {0, 1, 2}
    c, s = math.cos(rotation), math.sin(rotation)
    up = diameter * unit @ np.array([[c, s], [-s, c]]) + np.array(offset)
    rows, columns = (shape[0] - 1) / 2 - up[:, 1], (shape[1] - 1) / 2 + up[:, 0]
    return np.stack([rows, columns], axis=-1), kinds


def assert_same_lenses(camera: Camera, places: NDArray[np.float64], kinds: NDArray[np.intp]) -> None:
    lattice = camera.lattice
    index = (camera.sensor_um(places) - np.array(lattice.offset_um)) @ np.linalg.inv(lattice.basis_um())
    whole = np.rint(index).astype(int)
    assert np.abs(index - whole).max() < 1e-3
    assert len({tuple(pair) for pair in whole.tolist()}) == len(places)
    assert np.array_equal(lattice.type_of(whole[:, 0], whole[:, 1]), kinds)


@pytest.mark.parametrize("rotation", [0.0, 2.5e-5, 0.02, -0.02])
@pytest.mark.parametrize("offsets", OFFSETS)
@pytest.mark.parametrize("bases", BASES)
def test_every_lenslet_has_the_place_and_type_of_the_file(
    tmp_path: Path, bases: str, offsets: str, rotation: float
) -> None:
    numbers = (BASES[bases], OFFSETS[offsets], rotation, (22.07, 8.62), 38.3737792969)
    path = tmp_path / "calibration.xml"
    path.write_text(xml(*numbers))
    camera = read_raytrix_xml(path)
    assert_same_lenses(camera, *straight_from_the_file(*numbers, camera.sensor.shape))
    assert abs(camera.lattice.rotation_rad + rotation) < 1e-9  # y up to y down turns the sense round
    assert [t.depth_range for t in camera.lattice.types] == [(1, 3), (2, 4), (3, 5)]


def test_the_opposite_colouring_or_sense_would_be_noticed(tmp_path: Path) -> None:
    """Counter-test: mirrored types or a mirrored rotation do not pass the comparison above."""
    numbers = (BASES["left"], OFFSETS["left first"], 0.02, (22.07, 8.62), 38.37)
    path = tmp_path / "calibration.xml"
    path.write_text(xml(*numbers))
    camera = read_raytrix_xml(path)
    lenses = straight_from_the_file(*numbers, camera.sensor.shape)
    lattice = camera.lattice
    for change in ({"type_step": 3 - lattice.type_step}, {"rotation_rad": -lattice.rotation_rad}):
        values = {name: getattr(lattice, name) for name in lattice.__slots__} | change
        wrong = Camera("w", camera.optics, LensletLattice(**values), camera.sensor)
        with pytest.raises(AssertionError):
            assert_same_lenses(wrong, *lenses)


def test_a_standing_array_swaps_the_period(tmp_path: Path) -> None:
    path = tmp_path / "standing.xml"
    path.write_text(xml(((0.0, 1.0), (S, 0.5)), ((0.0, 0.0), (0.0, 1.0), (0.0, -1.0))))
    camera = read_raytrix_xml(path)
    assert abs(camera.lattice.quarter_turns) == 1 and abs(camera.lattice.tilt_rad) < 1e-4
    assert camera.period_px == pytest.approx((115.1, 66.5), abs=0.05)


@needs_real
def test_the_real_camera() -> None:
    camera = read_raytrix_xml(REAL)
    assert camera.period_px == pytest.approx((66.465, 115.121), abs=1e-3)
    assert abs(camera.lattice.rotation_rad) == pytest.approx(2.54e-5, abs=2e-7)
    x, y = camera.lattice.offset_um
    assert (x / 5.5, -y / 5.5) == pytest.approx((22.0742185007, 8.62280279398))
    assert [t.depth_range for t in camera.lattice.types] == [(1.0, 3.0), (2.79999995232, 4.0), (3.79999995232, 100.0)]
    assert camera.distortion is not None
    assert camera.distortion.coefficients == (-0.00145956683518, 0.000735560442194)
    assert camera.distortion.centre_px == (3186.70925279, 2651.12256994)
    plan = ScanPlan.for_camera(camera, virtual_depths=[2.0, 4.0])
    assert plan.period == (66, 115)
    assert plan.period_residual_px == pytest.approx((0.465, 0.121), abs=1e-3)
    assert Camera.from_json(camera.to_json()) == camera
    left = (-1.0, -8.74227765735e-08)
    numbers = (
        (left, (-0.499999910593, -0.866025447845)),
        ((0.0, 0.0), left, (1.0, 8.74227765735e-08)),
        2.54233651836e-05,
        (22.0742185007, 8.62280279398),
        38.3737792969,
    )
    assert_same_lenses(camera, *straight_from_the_file(*numbers, camera.sensor.shape))


def test_what_the_file_does_not_hold_is_given(tmp_path: Path) -> None:
    path = tmp_path / "c.xml"
    path.write_text(xml())
    camera = read_raytrix_xml(path)
    assert camera.name == "c"
    assert camera.lattice.gap_um == pytest.approx(camera.lattice.pitch_um * 5.0)
    assert camera.lattice.clear_um == pytest.approx((38.3737792969 - 2) * 5.5)
    # sigma = 1/vf - 1/v has opposite signs and equal size at both ends of the range (1, 3)
    vf = camera.lattice.types[0].focus_depth(camera.lattice.gap_um)
    assert 1 / vf - 1 / 1 == pytest.approx(-(1 / vf - 1 / 3))
    other = read_raytrix_xml(
        path,
        sensor=Sensor((3000, 4000), 4.0),
        optics=MainLens(100e3, 8.0, 5e5),
        gap_um=700.0,
        focus_depths=(2, 3, 5),
        name="mine",
    )
    assert other.lattice.pitch_um == pytest.approx(38.3737792969 * 4.0)
    assert [t.focus_depth(700.0) for t in other.lattice.types] == pytest.approx([2, 3, 5])
    assert other.name == "mine"
    with pytest.raises(InputError, match="focus depths"):
        read_raytrix_xml(path, focus_depths=(2, 3))


def test_other_encodings_are_read(tmp_path: Path) -> None:
    path = tmp_path / "c.xml"
    path.write_text(xml())
    want = read_raytrix_xml(path)
    path.write_text(xml(), encoding="utf-16")
    assert read_raytrix_xml(path) == want
    path.write_text(xml(), encoding="utf-8-sig")
    assert read_raytrix_xml(path) == want


BROWN = '<function>Brown</function><parameter count="2">-0.0015;0.0007</parameter>'


@pytest.mark.parametrize(
    "said",
    [
        "<function>constant</function>",
        '<function> constant </function><parameter count="0"></parameter>',
        '<function>constant</function><parameter count="2">0;0</parameter>',
    ],
)
def test_constant_distortion_is_none(tmp_path: Path, said: str) -> None:
    path = tmp_path / "c.xml"
    path.write_text(xml().replace(BROWN, said))
    assert said in path.read_text() and read_raytrix_xml(path).distortion is None


BOMB = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>'
EXTERNAL = '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/hostname">]>'


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("declaration", [BOMB, EXTERNAL, '<!doctype x SYSTEM "http://localhost/x.dtd">'])
def test_declarations_are_refused(tmp_path: Path, declaration: str, encoding: str) -> None:
    path = tmp_path / "bomb.xml"
    path.write_text(xml().replace("<RayCalib", declaration + "<RayCalib", 1), encoding=encoding)
    with pytest.raises(UnsafeFileError, match="document type"):
        read_raytrix_xml(path)


def without(tag: str) -> str:
    text = xml()
    start = text.index(f"<{tag}")
    return text[:start] + text[text.index(f"</{tag}>", start) + len(tag) + 3 :]


BAD = {
    "empty": "",
    "no XML": "hello",
    "cut short": xml()[:-40],
    "another root": "<Calib/>",
    "no diameter": without("diameter"),
    "no rotation": without("rotation"),
    "no border": without("lens_border"),
    "no base": without("lens_base_x"),
    "no offset": without("offset"),
    "no sub-grid": without("sub_grid_base"),
    "two lens types": without("lens_type"),
    "twice": xml().replace("<tcp", '<diameter units="pix">3</diameter><tcp'),
    "words for numbers": xml().replace("38.3737792969", "wide"),
    "not finite": xml().replace("38.3737792969", "nan"),
    "negative": xml().replace("38.3737792969", "-38"),
    "other units": xml().replace('<diameter units="pix">', '<diameter units="mm">'),
    "square array": xml(bases=((1.0, 0.0), (0.0, 1.0))),
    "flat bases": xml(bases=((1.0, 0.0), (1.0, 0.0))),
    "types on one colour": xml(offsets=((0.0, 0.0), (1.0, 0.0), (-2.0, 0.0))),
    "types off the lattice": xml(offsets=((0.0, 0.0), (1.3, 0.0), (-1.0, 0.0))),
    "four ids": xml().replace('lens_type id="2"', 'lens_type id="7"'),
    "empty depth range": xml().replace("<max>3</max>", "<max>1</max>"),
    "other distortion": xml().replace("Brown", "Green"),
    "constant distortion that is none": xml().replace("Brown", "constant"),
    "no coefficients": xml().replace("-0.0015;0.0007", ""),
    "wide border": xml().replace(">1</lens_border>", ">30</lens_border>"),
    "other sub-grid": xml().replace("<x>-3.0</x>", "<x>-1.0</x>"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "bad.xml"
    path.write_text(BAD[kind])
    with pytest.raises(FileFormatError) as caught:
        read_raytrix_xml(path)
    assert "\n" not in str(caught.value) and "bad.xml" in str(caught.value)


def test_other_bytes_and_sizes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "bytes.xml"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(FileFormatError):
        read_raytrix_xml(path)
    path.write_text(" " * (1 << 20) + xml())
    with pytest.raises(UnsafeFileError, match="1 MB"):
        read_raytrix_xml(path)
    path.write_text("<a>" * 100_000)
    with pytest.raises(FileFormatError):
        read_raytrix_xml(path)
    with pytest.raises(StorageError, match="check the path"):
        read_raytrix_xml(tmp_path / "absent.xml")
    with pytest.raises(StorageError):
        read_raytrix_xml(tmp_path)
