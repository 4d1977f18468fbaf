"""Stage coordinates, exposures and pixel sizes that OME-TIFF and Micro-Manager keep with the frames."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import FileFormatError, LfcalError
from lfcal.camera import ScanPlan
from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
from lfcal.frames.formats._ome import ome_facts
from lfcal.frames.lists.list_file import any_listing, read_micromanager
from tests.frames.lists.scans import COLUMNS, ROWS, START, Scan, frame, scan, small_camera, write_frames


def plan() -> ScanPlan:
    return ScanPlan(small_camera(), (ROWS, COLUMNS), (9, 11), (-40e3, 10e3), START)


@pytest.fixture(scope="module")
def found() -> Scan:
    """Return a scan in an order of its own, the stage turned round."""
    ordered = scan(right="-x", origin=(120.0, -40.0, 7.0))
    order = np.random.default_rng(5).permutation(len(ordered.stage))
    return Scan(ordered.camera, ordered.depths, ordered.positions[order], ordered.stage[order])


def write_ome(path: Path, found: Scan, exposure: tuple[float, str] = (20.0, "ms"), **pixels: Any) -> None:
    frames = np.stack([frame((y, x), seed=k) for k, (_, y, x) in enumerate(found.positions)])
    planes: dict[str, Any] = {f"Position{a}": (found.stage[:, k] / 1e3).tolist() for k, a in enumerate("XYZ")}
    planes |= {f"Position{a}Unit": ["mm"] * len(frames) for a in "XYZ"}
    planes |= {"ExposureTime": [exposure[0]] * len(frames), "ExposureTimeUnit": [exposure[1]] * len(frames)}
    tifffile.imwrite(path, frames, ome=True, metadata={"axes": "TYX", "Plane": planes, **pixels})


def test_an_ome_stack_says_where_each_page_belongs(tmp_path: Path, found: Scan) -> None:
    write_ome(tmp_path / "s.ome.tif", found, PhysicalSizeX=1.0, PhysicalSizeXUnit="µm")
    with open_frames(tmp_path / "s.ome.tif", plan=plan()) as source:
        np.testing.assert_array_equal([source.info(k).position for k in range(len(source))], found.positions)
        assert source.info(3).exposure_s == pytest.approx(0.02)
        notes = " ".join(source.metadata.notes)
        assert "-x,+y,+z move the image" in notes and "pixel size: 1 µm in the frames" in notes
        assert source.metadata.pixel_um == 1.0 and "stage_um" not in source.metadata.other
        np.testing.assert_array_equal(source.read(7), frame(found.positions[7, 1:], seed=7))
    assert any_listing(tmp_path / "s.ome.tif").exposures is not None


def test_exposures_that_are_hardly_seconds_are_left_out(tmp_path: Path, found: Scan) -> None:
    """Cameras count microseconds, and programs write their number where the format means seconds."""
    write_ome(tmp_path / "s.ome.tif", found, exposure=(20_000.0, "s"))
    listing = any_listing(tmp_path / "s.ome.tif")
    assert listing.exposures is None and "20000 s in s.ome.tif is implausible" in listing.notes[-1]
    write_ome(tmp_path / "s.ome.tif", found, exposure=(20_000.0, "µs"))
    assert any_listing(tmp_path / "s.ome.tif").exposures == pytest.approx((0.02,) * len(found.stage))


def test_a_pixel_size_that_is_the_camera_s_is_not_remarked(tmp_path: Path, found: Scan) -> None:
    camera = found.camera
    for size in (camera.sensor.pixel_um, camera.step_um(0.0)):
        write_ome(tmp_path / "s.ome.tif", found, PhysicalSizeX=size)
        with open_frames(tmp_path / "s.ome.tif", plan=plan()) as source:
            assert not any(note.startswith("pixels") for note in source.metadata.notes)


OME = (
    '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image>'
    '<Pixels DimensionOrder="XYCZT" {}>{}</Pixels></Image></OME>'
)
PLANE = '<Plane TheC="0" TheZ="{}" TheT="{}" PositionX="{}" PositionY="0" {}/>'


def test_planes_are_put_in_the_order_of_the_pages() -> None:
    # listed by Z first, stored by T last: Z runs faster
    text = OME.format("", "".join(PLANE.format(z, t, 10 * t + z, "") for z in range(2) for t in range(3)))
    facts = ome_facts(text, 6)
    assert facts["stage_um"][:, 0].tolist() == [0, 1, 10, 11, 20, 21] and np.isnan(facts["stage_um"][:, 2]).all()
    assert "exposure_s" not in facts


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<OME",
        "<!DOCTYPE x [<!ENTITY a 'b'>]><OME/>",
        OME.format("", PLANE.format(0, "one", 1, "")),
        OME.format("", PLANE.format(0, 0, "nan", "") + PLANE.format(0, 1, 2, "")),
        OME.format("", PLANE.format(0, 0, 1, 'PositionXUnit="parsec"') + PLANE.format(0, 1, 2, "")),
        OME.format("", PLANE.format(0, 0, 1, "") + PLANE.format(0, 1, 1, "")),
        OME.format('PhysicalSizeX="-1"', ""),
        OME.format("", PLANE.format(0, 0, 1, "")),
    ],
)
def test_what_says_nothing_is_left_out(text: str) -> None:
    assert ome_facts(text, 2) == {}


# -- Micro-Manager -----------------------------------------------------------------------------------------------


def metadata_of(found: Scan, names: list[str], version: int) -> dict[str, Any]:
    body: dict[str, Any] = {"Summary": {"PixelSize_um": 0.5, "Slices": 1}}
    for k, (name, (x, y, z)) in enumerate(zip(names, found.stage, strict=True)):
        key = f"FrameKey-{k}-0-0" if version == 1 else f"Metadata-Default/{name}"
        body[key] = {
            "FileName": name if version == 1 else f"Default/{name}",
            "XPositionUm": x,
            "YPositionUm": y,
            "ZPositionUm": z,
            "Exposure-ms": 20.0,
            "PixelSizeUm": 0.5,
            "BitDepth": 12,
        }
    return body


@pytest.mark.parametrize("version", [1, 2])
def test_a_folder_of_micro_manager(tmp_path: Path, found: Scan, version: int) -> None:
    folder = tmp_path if version == 1 else tmp_path / "Default"
    names = [f"img_channel000_position000_time{k:09d}_z000.tif" for k in range(len(found.stage))]
    folder.mkdir(exist_ok=True)
    for k, (name, (_, y, x)) in enumerate(zip(names, found.positions, strict=True)):
        tifffile.imwrite(folder / name, frame((y, x), seed=k))
    (tmp_path / "metadata.txt").write_text(json.dumps(metadata_of(found, names, version)))
    source = open_frames(tmp_path, plan=plan())
    np.testing.assert_array_equal([source.info(k).position for k in range(len(source))], found.positions)
    assert source.info(0).exposure_s == pytest.approx(0.02)
    assert source.metadata.saturation == 4095 and source.metadata.pixel_um == 0.5
    assert any("stage coordinates that Micro-Manager wrote" in note for note in source.metadata.notes)


def test_a_stack_of_micro_manager(tmp_path: Path, found: Scan) -> None:
    frames = np.stack([frame((y, x), seed=k) for k, (_, y, x) in enumerate(found.positions)])
    tifffile.imwrite(tmp_path / "scan_MMStack.ome.tif", frames, photometric="minisblack")
    body = metadata_of(found, ["scan_MMStack.ome.tif"] * len(frames), 1)
    (tmp_path / "scan_MMStack_metadata.txt").write_text(json.dumps(body))
    with open_frames(tmp_path, plan=plan()) as source:
        np.testing.assert_array_equal([source.info(k).position for k in range(len(source))], found.positions)
        np.testing.assert_array_equal(source.read(5), frames[5])


@pytest.mark.parametrize("stacked", [False, True])
def test_channels_of_micro_manager(tmp_path: Path, found: Scan, stacked: bool) -> None:
    """A channel without light is the dark of the other one (micro-manager#910)."""
    count = len(found.stage)
    lit = [frame((y, x), seed=k) for k, (_, y, x) in enumerate(found.positions)]
    dark = [np.rint(np.random.default_rng(k).normal(100, 3, lit[0].shape)).astype(np.uint16) for k in range(count)]
    names = [f"img_{k}.tif" for k in range(2 * count)]
    both = [one for pair in zip(lit, dark, strict=True) for one in pair]
    if stacked:
        names = ["scan_MMStack.ome.tif"] * len(both)
        tifffile.imwrite(tmp_path / names[0], np.stack(both), photometric="minisblack")
    else:
        for name, values in zip(names, both, strict=True):
            tifffile.imwrite(tmp_path / name, values)
    twice = Scan(found.camera, found.depths, np.repeat(found.positions, 2, 0), np.repeat(found.stage, 2, 0))
    body = metadata_of(twice, names, 1)
    frames = [entry for key, entry in body.items() if key != "Summary"]
    for k, entry in enumerate(frames):
        entry["Channel"] = "Dark" if k % 2 else "Lamp"
    (tmp_path / "scan_metadata.txt").write_text(json.dumps(body))
    with open_frames(tmp_path, plan=plan()) as source:
        assert (
            "channels: 'Lamp' is used, out of 'Lamp', 'Dark'; 'Dark' contains its dark frames"
        ) in source.metadata.notes
        np.testing.assert_array_equal([source.info(k).position for k in range(count)], found.positions)
        np.testing.assert_array_equal(source.read(5), lit[5])
        assert list(source.metadata.darks) == [0.02]
        clean = corrected_view(source, CorrectionRecipe()).read(5)
        np.testing.assert_allclose(clean, lit[5] - np.mean(dark, 0), atol=0.01)
    with open_frames(tmp_path, plan=plan(), columns="channel=Dark") as source:
        np.testing.assert_array_equal(source.read(5), dark[5])
    for k, entry in enumerate(frames):
        entry["Channel"] = "Blue" if k % 2 else "Green"
    (tmp_path / "scan_metadata.txt").write_text(json.dumps(body))
    with pytest.raises(FileFormatError, match=r"got 'Green', 'Blue'; choose one in .*--columns 'channel=Green'"):
        open_frames(tmp_path, plan=plan())
    with pytest.raises(FileFormatError, match=r"expected one of 'Green', 'Blue', got 'green'; choose one"):
        open_frames(tmp_path, plan=plan(), columns="channel=green")


def test_a_frame_without_a_place(tmp_path: Path, found: Scan) -> None:
    body = metadata_of(found, ["a.tif"] * len(found.stage), 1)
    body["FrameKey-3-0-0"].pop("XPositionUm")
    (tmp_path / "metadata.txt").write_text(json.dumps(body))
    with pytest.raises(FileFormatError, match=r"XPositionUm of a\.tif: expected a number, got None; record with"):
        open_frames(tmp_path, plan=plan())


@pytest.mark.parametrize("text", ["[]", "{}", '{"Summary": {}}', "{"])
def test_no_metadata(tmp_path: Path, text: str) -> None:
    (tmp_path / "metadata.txt").write_text(text)
    with pytest.raises(FileFormatError, match=r"metadata\.txt"):
        read_micromanager(tmp_path / "metadata.txt")
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((8, 9), np.uint16))
    with pytest.raises(FileFormatError, match="stage coordinates of every page in its metadata, got none"):
        any_listing(tmp_path / "a.tif")


@pytest.mark.parametrize("form", ["x{0:+.2f}um_y{1:+.2f}um_z{2:+.2f}um", "f_z_{2:.3f}um x={0:.2f}um y={1:.2f}um"])
def test_places_in_the_names_of_files(tmp_path: Path, found: Scan, form: str) -> None:
    names = [f"{form.format(*place)}.tif" for place in found.stage]
    write_frames(tmp_path, found, names)
    with open_frames(tmp_path, plan=plan()) as source:
        assert any("stage coordinates in the file names" in note for note in source.metadata.notes)
        for k in range(len(source)):
            name = source.info(k).label
            assert tuple(source.info(k).position) == tuple(found.positions[names.index(name)])


def test_names_in_part_without_a_place_are_not_taken_for_places(tmp_path: Path, found: Scan) -> None:
    names = [f"x{place[0]:+.2f}um_y{place[1]:+.2f}um_z{place[2]:+.2f}um.tif" for place in found.stage]
    write_frames(tmp_path, found, ["other.tif", *names[1:]])
    with pytest.raises(LfcalError):
        open_frames(tmp_path, plan=plan())
