"""Calibration files of Raytrix: every lenslet has the place and type of the file, and damaged files are refused."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, StorageError, UnsafeFileError
from lfcal.camera import Camera, MainLens, ScanPlan, Sensor, read_raytrix_xml

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
    """Build lens positions (row, column) and types as the file states them, in its y-up plane.

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


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "c.xml"


@pytest.mark.parametrize("bases", BASES)
def test_every_lenslet_has_the_place_and_type_of_the_file(path: Path, bases: str) -> None:
    for offsets in OFFSETS:
        for rotation in (0.0, 2.5e-5, 0.02, -0.02):
            numbers = (BASES[bases], OFFSETS[offsets], rotation, (22.07, 8.62), 38.3737792969)
            path.write_text(xml(*numbers))
            camera = read_raytrix_xml(path)
            assert_same_lenses(camera, *straight_from_the_file(*numbers, camera.sensor.shape))
            assert abs(camera.lattice.rotation_rad + rotation) < 1e-9, "y up to y down reverses the sense"
            assert [t.depth_range for t in camera.lattice.types] == [(1, 3), (2, 4), (3, 5)]


def test_the_opposite_colouring_or_sense_would_be_noticed(path: Path) -> None:
    numbers = (BASES["left"], OFFSETS["left first"], 0.02, (22.07, 8.62), 38.37)
    path.write_text(xml(*numbers))
    camera = read_raytrix_xml(path)
    lattice, lenses = camera.lattice, straight_from_the_file(*numbers, camera.sensor.shape)
    for change in ({"type_step": 3 - lattice.type_step}, {"rotation_rad": -lattice.rotation_rad}):
        with pytest.raises(AssertionError):
            assert_same_lenses(replace(camera, lattice=replace(lattice, **change)), *lenses)


def test_a_standing_array_swaps_the_period(path: Path) -> None:
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


def test_what_the_file_does_not_contain_is_given(path: Path) -> None:
    path.write_text(xml())
    camera = read_raytrix_xml(path)
    assert camera.name == "c"
    assert camera.lattice.gap_um == pytest.approx(camera.lattice.pitch_um * 5.0)
    assert camera.lattice.clear_um == pytest.approx((38.3737792969 - 2) * 5.5)
    # sigma = 1/vf - 1/v has opposite signs and equal size at both ends of the range (1, 3)
    vf = camera.lattice.types[0].focus_depth(camera.lattice.gap_um)
    assert 1 / vf - 1 / 1 == pytest.approx(-(1 / vf - 1 / 3))
    sensor, optics = Sensor((3000, 4000), 4.0), MainLens(100e3, 8.0, 5e5)
    other = read_raytrix_xml(path, sensor=sensor, optics=optics, gap_um=700.0, focus_depths=(2, 3, 5), name="mine")
    assert other.lattice.pitch_um == pytest.approx(38.3737792969 * 4.0) and other.name == "mine"
    assert [t.focus_depth(700.0) for t in other.lattice.types] == pytest.approx([2, 3, 5])
    with pytest.raises(InputError, match="focus depths"):
        read_raytrix_xml(path, focus_depths=(2, 3))


def test_other_encodings_and_no_distortion_are_read(path: Path) -> None:
    path.write_text(xml())
    want = read_raytrix_xml(path)
    for encoding in ("utf-16", "utf-8-sig"):
        path.write_text(xml(), encoding=encoding)
        assert read_raytrix_xml(path) == want
    brown = '<function>Brown</function><parameter count="2">-0.0015;0.0007</parameter>'
    assert brown in xml() and want.distortion is not None
    for constant in (
        "<function>constant</function>",
        '<function> constant </function><parameter count="0"></parameter>',
        '<function>constant</function><parameter count="2">0;0</parameter>',
    ):
        path.write_text(xml().replace(brown, constant))
        assert read_raytrix_xml(path).distortion is None, constant


DECLARATIONS = (
    '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>',
    '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/hostname">]>',
    '<!doctype x SYSTEM "http://localhost/x.dtd">',
)


def test_declarations_are_refused(path: Path) -> None:
    for declaration in DECLARATIONS:
        for encoding in ("utf-8", "utf-16"):
            path.write_text(xml().replace("<RayCalib", declaration + "<RayCalib", 1), encoding=encoding)
            with pytest.raises(UnsafeFileError, match="document type"):
                read_raytrix_xml(path)


def without(tag: str) -> str:
    text = xml()
    start = text.index(f"<{tag}")
    return text[:start] + text[text.index(f"</{tag}>", start) + len(tag) + 3 :]


BAD = [
    *("", "hello", xml()[:-40], "<Calib/>"),
    *map(without, ("diameter", "rotation", "lens_border", "lens_base_x", "offset", "sub_grid_base", "lens_type")),
    *(xml().replace("38.3737792969", bad) for bad in ("wide", "nan", "-38")),
    *(xml(bases=((1.0, 0.0), second)) for second in ((0.0, 1.0), (1.0, 0.0))),  # square, and flat
    *(xml(offsets=((0.0, 0.0), *places)) for places in (((1.0, 0.0), (-2.0, 0.0)), ((1.3, 0.0), (-1.0, 0.0)))),
    *(
        xml().replace(old, new)
        for old, new in (
            ("<tcp", '<diameter units="pix">3</diameter><tcp'),
            ('<diameter units="pix">', '<diameter units="mm">'),
            ('lens_type id="2"', 'lens_type id="7"'),
            ("<max>3</max>", "<max>1</max>"),
            ("Brown", "Green"),
            ("Brown", "constant"),
            ("-0.0015;0.0007", ""),
            (">1</lens_border>", ">30</lens_border>"),
            ("<x>-3.0</x>", "<x>-1.0</x>"),
        )
    ),
]
"""Damaged files."""


def test_bad_files_are_refused_in_one_line(path: Path) -> None:
    for text in BAD:
        assert text != xml()
        path.write_text(text)
        with pytest.raises(FileFormatError) as caught:
            read_raytrix_xml(path)
        assert "\n" not in str(caught.value) and "c.xml" in str(caught.value), text


def test_other_bytes_and_sizes_are_refused(path: Path) -> None:
    for content, kind, match in (
        (bytes(range(256)), FileFormatError, "."),
        (b" " * (1 << 20) + xml().encode(), UnsafeFileError, "1 MB"),
        (b"<a>" * 100_000, FileFormatError, "."),
    ):
        path.write_bytes(content)
        with pytest.raises(kind, match=match):
            read_raytrix_xml(path)
    with pytest.raises(StorageError, match="check the path"):
        read_raytrix_xml(path.with_name("absent.xml"))
    with pytest.raises(StorageError):
        read_raytrix_xml(path.parent)
