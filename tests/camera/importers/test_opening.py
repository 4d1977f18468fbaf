"""Descriptions of others: each is known by its text, its values are right, and what it leaves open is marked."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from lfcal.base import FileFormatError, InputError, StorageError, UnsafeFileError
from lfcal.camera import (
    CAMERA_FORMATS,
    Camera,
    ImportOptions,
    Microscope,
    PupilLenslets,
    import_camera,
    preset,
    quantities_of,
)
from tests.camera.importers.files import CONFIGURATION, OLAF, napari
from tests.camera.importers.test_raytrix_xml import xml
from tests.distribution import names_of

DATA = Path(__file__).parents[4] / "shared/data"
needs_data = pytest.mark.skipif(not DATA.exists(), reason=f"{DATA} is not on this machine")


def read(folder: Path, text: str, name: str = "any.thing", **wanted: Any) -> Camera:
    (folder / name).write_text(text, encoding="utf-8")
    return import_camera(folder / name, ImportOptions(**wanted)).camera


def optics(camera: Camera) -> Microscope:
    assert isinstance(camera.optics, Microscope)
    return camera.optics


def test_olaf(tmp_path: Path) -> None:
    camera = read(tmp_path, OLAF)
    assert optics(camera) == Microscope(22.222, 0.5, 1.33, 165e3)
    assert (camera.lattice.kind, camera.lattice.pitch_um, camera.sensor.pixel_um) == ("square", 112, 6.5)
    # plenoptic 1 without mla2sensor: the sensor is at the lenslets' focal length
    assert camera.lattice.gap_um == camera.lattice.types[0].focal_length_um == 2433
    assert camera.wavelength_um == 0.53
    marks = camera.marks
    assert (marks["lattice.gap_um"], marks["lattice.types"], marks["sensor.shape"]) == ("derived", "stated", "assumed")
    assert not {"optics.magnification", "sensor.pixel_um", "lattice.pitch_um"} & set(marks.paths("assumed"))


def test_olaf_files_that_would_compute_for_ever_are_refused(tmp_path: Path) -> None:
    """References to references: 700 bytes once took 30 s and 1.4 GB to refuse."""
    bomb = "a: &a [1, 1]\n" + "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in pairwise("abcdefghiz"))
    for entry in ("gridType: *z", "plenoptic: *z", "fm: *z", "M: *z", "x: !!bool abc", "? {a: b}\n: 1"):
        name = entry.partition(":")[0]
        text = "\n".join(line for line in OLAF.splitlines() if not line.startswith(f"{name}:"))
        with pytest.raises(FileFormatError) as caught:
            read(tmp_path, text + "\n" + (bomb if "*z" in entry else "") + entry + "\n")
        assert "\n" not in str(caught.value), entry


def test_olaf_defocused_matches_f_numbers(tmp_path: Path) -> None:
    text = OLAF.replace("plenoptic: 1", "plenoptic: 2").replace("tube2mla: 0", "tube2mla: 170000")
    camera = read(tmp_path, text)
    # by hand: the tube lens images the array at t = ftl a/(a - ftl) in front of itself; the marginal ray through
    # the objective's rim is traced back from there
    f_obj, tube, array = 165e3 / 22.222, 165e3, 170e3
    before = tube * array / (array - tube)
    beyond = before - (f_obj + tube)
    lit = f_obj * 0.5 * before / beyond
    assert camera.lattice.gap_um == pytest.approx(112 * array / (2 * lit), rel=1e-9)
    assert camera.marks["lattice.gap_um"] == "derived"
    notes = import_camera(tmp_path / "any.thing").notes
    assert len(notes) == 1 and "defocused" in notes[0]


def test_olaf_hexagonal_with_three_types(tmp_path: Path) -> None:
    text = OLAF.replace("reg ", "hex ").replace("single", "multi").replace("fm: 2433", "fm: [2400, 2500, 2700.5]")
    camera = read(tmp_path, text.replace("mla2sensor: 0", "mla2sensor: 2300"))
    assert camera.lattice.kind == "hexagonal" and camera.lattice.gap_um == 2300
    assert [kind.focal_length_um for kind in camera.lattice.types] == [2400, 2500, 2700.5]


FLFM = """fobj: 9000
NA: 0.5
f1: 180000
f2: 125000
lensPitch: 3300
pixelPitch: 5.5
gridType: hex
fm: 30000
n: 1
WaveLength: 0.525
mla2sensor: 30000
spacingPixels: 600
noLensHoriz: 3
noLensVert: 3
shiftRow: 1
"""


def test_olaf_of_a_fourier_microscope(tmp_path: Path) -> None:
    camera = read(tmp_path, FLFM)
    assert optics(camera) == Microscope(20, 0.5, 1, 180e3)
    lenslets = camera.lattice
    assert isinstance(lenslets, PupilLenslets)
    # oLaF's FLFM_setCameraParams: M = fm f1 / (f2 fobj)
    assert camera.magnification == pytest.approx(30e3 * 180e3 / (125e3 * 9e3))
    # 600 pixels of 5.5 µm apart; of 3 x 3 two lie outside a pupil of 6.25 mm
    assert lenslets.spacing_um == pytest.approx(3300)
    assert len(lenslets.lens_centres_um) == 7 and (0.0, 0.0) in lenslets.lens_centres_um
    turned = read(tmp_path, FLFM.replace("shiftRow: 1", "shiftRow: 2"))
    assert isinstance(turned.lattice, PupilLenslets) and len(turned.lattice.lens_centres_um) == 7
    square = read(tmp_path, FLFM.replace("hex", "reg").replace("f2: 125000", "f2: 250000"))
    assert isinstance(square.lattice, PupilLenslets) and len(square.lattice.lens_centres_um) == 9


REFUSED = [
    (OLAF, "M: 22.222", "", "'M'"),
    (OLAF, "fm: 2433", "fm: [1, 2]", "fm"),
    (OLAF, "fm: 2433", "fm: [1, 2, 3]", "one focal length"),
    (OLAF, "single", "multi", "three focal lengths"),
    (OLAF, "gridType: reg", "gridType: tri", "gridType"),
    (OLAF, "plenoptic: 1", "plenoptic: 3", "plenoptic"),
    (OLAF, "NA: 0.5", "NA: 1.5", "numerical aperture"),
    *((OLAF, "NA: 0.5", f"NA: {other}", "NA") for other in ("half", ".nan")),
    (OLAF, "WaveLength: 0.53", "WaveLength: 530", "µm"),
    (OLAF, "n: 1.33", "noLensHoriz: 12", "'fobj'"),
    *((OLAF, "n: 1.33", n, "YAML") for n in ("n: [1.33", "n: !!python/object/apply:os.system ['true']")),
    (FLFM, "fobj: 9000", "fobj: 0", "focal lengths"),
    (FLFM, "noLensHoriz: 3", "noLensHoriz: 2.5", "whole numbers"),
    (FLFM, "noLensVert: 3", "noLensVert: 3000", "whole numbers"),
    (FLFM, "f2: 125000", "", "'f2'"),
    (FLFM, "gridType: hex", "gridType: tri", "gridType"),
    (napari(pixel_size=None), "", "", "'pixel_size'"),
    (napari(objective_na="0.5"), "", "", "objective_na"),
    (napari(medium_index=0.5), "", "", "index"),
]


def test_refusals_are_one_line_that_names_the_entry(tmp_path: Path) -> None:
    for text, old, new, words in REFUSED:
        with pytest.raises(FileFormatError) as error:
            read(tmp_path, text.replace(old, new) if old else text)
        message = str(error.value)
        assert words in message and "any.thing" in message and "\n" not in message, (new, words)


def test_napari_lf(tmp_path: Path) -> None:
    camera = read(tmp_path, napari())
    assert optics(camera) == Microscope(20, 0.5, 1.33, 180e3)
    assert (camera.lattice.pitch_um, camera.lattice.gap_um) == (125, 2433)
    assert camera.lattice.types[0].focal_length_um == 2500
    assert (camera.sensor.pixel_um, camera.sensor.fill_factor, camera.wavelength_um) == (7.4, 0.9, 0.482)
    assert (camera.marks["lattice.kind"], camera.marks["sensor.shape"]) == ("derived", "assumed")
    (tmp_path / "m.json").write_text(napari(ulens_fill_factor=0.7))
    found = import_camera(tmp_path / "m.json")
    assert found.camera.marks["lattice.clear_um"] == "assumed" and "fraction of 0.7" in found.notes[0]


@needs_data
def test_napari_lf_real_file() -> None:
    found = import_camera(DATA / "lfm_guv/metadata.json")
    assert found.camera.pitch_px == pytest.approx(15.385, abs=1e-3)
    assert optics(found.camera).numerical_aperture == 1.2 and found.camera.wavelength_um == 0.593
    assert "sensor.shape" in found.camera.marks.paths("assumed")


def test_micro_manager_configuration(tmp_path: Path) -> None:
    camera = read(tmp_path, CONFIGURATION, resolution="Res40x")
    # 40x on a specimen of 0.1625 µm a pixel: 6.5 µm
    assert optics(camera).magnification == 40 and camera.sensor.pixel_um == pytest.approx(6.5)
    assert optics(camera).numerical_aperture == 0.95
    assert camera.marks["sensor.pixel_um"] == "derived" and camera.marks["lattice.pitch_um"] == "assumed"
    other = read(tmp_path, CONFIGURATION, resolution="Res10x", values={"sensor.pixel_um": 13.0})
    # a stated pixel takes precedence over the label of the objective: there is a relay of 2x
    assert optics(other).magnification == pytest.approx(20) and other.marks["sensor.pixel_um"] == "stated"


def test_micro_manager_needs_a_resolution(tmp_path: Path) -> None:
    for resolution in ("", "Res20x"):
        with pytest.raises(InputError, match="one of Res40x, Res10x") as error:
            read(tmp_path, CONFIGURATION, resolution=resolution)
        assert "--resolution" in str(error.value)
    single = "\n".join(line for line in CONFIGURATION.splitlines() if "Res40x" not in line)
    assert optics(read(tmp_path, single)).magnification == 10
    none = "\n".join(line for line in CONFIGURATION.splitlines() if "Res" not in line)
    with pytest.raises(FileFormatError, match="PixelSize_um"):
        read(tmp_path, none)
    with pytest.raises(FileFormatError, match="PixelSize_um of Res10x"):
        read(tmp_path, single.replace("0.65", "wide"))


def test_micro_manager_metadata(tmp_path: Path) -> None:
    summary = {"Summary": {"Width": 512, "Height": 400, "BitDepth": 14, "PixelSize_um": 0.325, "Slices": 3}}
    camera = read(tmp_path, json.dumps(summary), values={"optics.magnification": 20.0})
    assert camera.sensor.shape == (400, 512) and camera.sensor.bit_depth == 14
    assert camera.sensor.pixel_um == pytest.approx(6.5)
    with pytest.raises(FileFormatError, match="Width"):
        read(tmp_path, json.dumps({"Summary": {"Width": "512", "Height": 400}}))


def test_camera_json_and_values_stated_later(tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(xml())
    imported = import_camera(tmp_path / "c.xml").camera
    assert read(tmp_path, imported.to_json()) == imported
    stated = read(tmp_path, imported.to_json(), values={"sensor.pixel_um": 11.0, "optics.f_number": 8.0})
    # the maker counts in pixels: their number is kept, and what was assumed follows
    assert stated.pitch_px == pytest.approx(imported.pitch_px)
    assert stated.lattice.gap_um == pytest.approx(4 * imported.lattice.gap_um)
    same = import_camera(tmp_path / "c.xml", ImportOptions({"sensor.pixel_um": 11.0, "optics.f_number": 8.0})).camera
    assert stated.lattice.pitch_um == pytest.approx(same.lattice.pitch_um)
    assert [t.focal_length_um for t in stated.lattice.types] == pytest.approx(
        [t.focal_length_um for t in same.lattice.types]
    )
    assert stated.marks == same.marks


def test_a_measured_camera_keeps_its_marks(tmp_path: Path) -> None:
    plain = preset("bench")
    again = read(tmp_path, plain.to_json(), values={"sensor.read_noise_e": 3.0})
    assert again.lattice == plain.lattice and again.marks["sensor.read_noise_e"] == "stated"
    assert again.marks.paths("assumed") == ()


def test_raytrix_marks(tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_text(xml())
    found = import_camera(tmp_path / "c.xml")
    marks = found.camera.marks
    assert marks["lattice.rotation_rad"] == "stated" and marks["lattice.pitch_um"] == "derived"
    for path in ("sensor.shape", "sensor.pixel_um", "optics.f_number", "lattice.gap_um", "lattice.types"):
        assert marks[path] == "assumed", path
    assert any("not applied" in note for note in found.notes)
    sure = import_camera(tmp_path / "c.xml", ImportOptions({"lattice.gap_um": 900.0, "sensor.pixel_um": 5.5})).camera
    # depth ranges are the maker's, and with the gap the focal lengths follow
    assert sure.marks["lattice.types"] == "derived"
    assert sure.lattice.types[0].focus_depth(900.0) == pytest.approx(2 / (1 / 1 + 1 / 3))


def test_other_files_are_refused(tmp_path: Path) -> None:
    for text in ("", "hello", "a,b\n1,2\n", "%PDF-1.4", "name: x\nvalue: 3\n"):
        with pytest.raises(FileFormatError, match=r"camera description.*lfcal camera new"):
            read(tmp_path, text)
    (tmp_path / "b").write_bytes(b"\x89HDF\r\n\x1a\n\xff")
    with (tmp_path / "big").open("wb") as file:
        file.truncate((1 << 24) + 1)
    for name, kind in (("b", FileFormatError), ("big", UnsafeFileError), ("absent", StorageError)):
        with pytest.raises(kind):
            import_camera(tmp_path / name)


def test_every_value_of_an_import_has_a_mark(tmp_path: Path) -> None:
    for text in (xml(), OLAF, napari()):
        camera = read(tmp_path, text)
        marked = {path for path, _ in camera.marks}
        assert {quantity.path for quantity in quantities_of(camera)} <= marked
        assert all(math.isfinite(kind.focal_length_um) for kind in camera.lattice.types)


PAGE = Path(__file__).parents[3] / "docs/camera.md"


def test_a_format_of_your_own() -> None:
    found = names_of("extending.md", "A camera format")
    form, note = found["FORMAT"], "# lab camera\npitch = 125\n"
    assert form.recognises(note)
    imported = form.read(note, Path("x.lab"), ImportOptions({"optics.magnification": 40.0}))
    camera = imported.camera
    assert (camera.lattice.pitch_um, camera.lattice.gap_um, camera.magnification) == (125, 2500, 40)
    assert camera.marks["lattice.gap_um"] == "derived" and camera.marks["sensor.pixel_um"] == "assumed"


def test_every_format_is_on_the_page() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for name in CAMERA_FORMATS.names():
        assert name.split()[0] in text, name
