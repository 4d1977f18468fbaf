"""Frames that are a part of the sensor: their place by metadata, by the light, as stated, and in all views."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.frames import (
    ArraySource,
    CorrectionRecipe,
    balanced_source,
    channel_source,
    corrected_view,
    named_orientation,
    open_frames,
    open_image,
    oriented,
)
from lfcal.frames.described import DescribedSource
from lfcal.frames.part import binned, is_part_of_sensor, parse_roi, stated_origin
from lfcal.psf import assemble_plan
from lfcal.psf.orientation import FoundOrientation
from lfcal.psf.upright import check_place, iter_upright
from tests.frames.lists.scans import COLUMNS, ROWS, START, frame, small_camera
from tests.frames.lists.test_ome_order import header
from tests.frames.scenes import session

PLAN = ScanPlan(small_camera(), (ROWS, COLUMNS), (9, 11), (-40e3, 10e3), START)
ORIGIN = (5, 6)


def test_regions_as_programs_write_them() -> None:
    region = (8, 5, 80, 78)
    read = {"8-5-80-78": region, "[8, 5, 80, 78]": region, "0-0-512": None, "a-b-c-d": None, None: None, 17: None}
    for value, wanted in read.items():
        assert parse_roi(value) == wanted
    assert parse_roi([8, 5, 80, 78]) == region and parse_roi([8, 5, 80, -78]) is None
    # a region of another size is not that of the frames
    assert stated_origin((8, 5, 78, 80), (80, 78)) == (5, 8)
    assert stated_origin(region, (80, 78)) is None and stated_origin(None, (80, 78)) is None


def test_binned_frames_and_assumed_sensors_are_no_part() -> None:
    camera = small_camera()
    assert binned((40, 48), (20, 24)) == 2 and binned((40, 48), (38, 44)) == 0
    parts = {(38, 44): True, (40, 48): False, (20, 24): False, (41, 44): False}
    assert {shape: is_part_of_sensor(shape, camera) for shape in parts} == parts
    assumed = replace(camera, marks=camera.marks.marked(["sensor.shape"], "assumed"))
    assert not is_part_of_sensor((38, 44), assumed)


def write_part(folder: Path, origin: tuple[int, int] = ORIGIN, shape: tuple[int, int] = (33, 42), **how: Any) -> None:
    """Write the part of each frame of a scan that begins at ``origin``."""
    folder.mkdir(exist_ok=True)
    part = tuple(slice(o, o + n) for o, n in zip(origin, shape, strict=True))
    for z, y, x in np.ndindex(2, ROWS, COLUMNS):
        image = frame((y, x), seed=int(100 * z + 10 * y + x))[part]
        tifffile.imwrite(folder / f"z{z}_y{y}_x{x}.tif", image, photometric="minisblack", metadata=None, **how)


def opened(folder: Path, **how: Any) -> Any:
    return open_frames(folder, pattern="z{z}_y{y}_x{x}.tif", plan=PLAN, **how)


def annotated(inner: str) -> str:
    return header("XYCZT", (1, 1, 1), "", shape=(33, 42)).replace("</OME>", f"{inner}</OME>")


MAP = (
    '<StructuredAnnotations><MapAnnotation><Value><M K="ROI">6-5-42-33</M></Value></MapAnnotation>'
    "</StructuredAnnotations>"
)
ORIGINAL = (
    "<StructuredAnnotations><XMLAnnotation><Value><OriginalMetadata><Key>ROI</Key><Value>6-5-42-33</Value>"
    "</OriginalMetadata></Value></XMLAnnotation></StructuredAnnotations>"
)
BOX = '<ROI ID="ROI:0"><Union><Rectangle ID="Shape:0" X="{}" Y="{}" Width="{}" Height="{}"/></Union></ROI>'
WITHIN = BOX.format(6, 5, 20, 20) + BOX.format(0, 0, 42, 33)


def test_the_region_that_ome_metadata_keep(tmp_path: Path) -> None:
    box, image = (6, 5, 42, 33), frame((0, 0))[5:38, 6:48]
    for inner, wanted in ((MAP, box), (ORIGINAL, box), (BOX.format(*box), box), (WITHIN, None)):
        about = annotated(inner).encode()
        tifffile.imwrite(tmp_path / "a.ome.tif", image, photometric="minisblack", metadata=None, description=about)
        found = open_image(tmp_path / "a.ome.tif")
        assert found.metadata.get("roi") == wanted, inner
        found.close()


def test_metadata_that_state_the_part_refuse_a_plan_of_the_whole(tmp_path: Path) -> None:
    """Micro-Manager keeps the region with every page; Python's way is held to it, too."""
    tag = (51123, "s", 0, json.dumps({"ROI": "6-5-42-33", "BitDepth": 12}), True)
    write_part(tmp_path / "f", extratags=[tag])
    with opened(tmp_path / "f") as source:
        assert source.metadata.stated_origin == ORIGIN
        with pytest.raises(InputError, match=r"first pixel is row 5, column 6 of it, as their metadata say; state"):
            assemble_plan(source, PLAN)
    with opened(tmp_path / "f", origin=(5, 7)) as source:
        assert "the frames' metadata state 5,6; the given 5,7 is used" in source.metadata.notes[-1]


def test_a_folder_of_micro_manager_states_the_part(tmp_path: Path) -> None:
    body = {}
    for k, (y, x) in enumerate(np.ndindex(ROWS, COLUMNS)):
        tifffile.imwrite(tmp_path / f"img{k}.tif", frame((y, x), seed=k)[5:38, 6:48])
        step = small_camera().step_um(-40e3)
        body[f"FrameKey-{k}-0-0"] = {
            **{"FileName": f"img{k}.tif", "ROI": "6-5-42-33"},
            **{"XPositionUm": step * x, "YPositionUm": step * y, "ZPositionUm": 0},
        }
    (tmp_path / "metadata.txt").write_text(json.dumps(body))
    with open_frames(tmp_path, plan=replace(PLAN, depths_um=(-40e3,), exposure_s=0.02)) as source:
        assert source.metadata.stated_origin == ORIGIN


def test_the_light_shows_the_part_and_what_was_stated_wrongly(tmp_path: Path) -> None:
    write_part(tmp_path / "f")
    with opened(tmp_path / "f") as source:
        words = r"row 5, column 6 of it, according to the position of the light .*--origin 5,6"
        with pytest.raises(InputError, match=words):
            drain(iter_upright(source, PLAN))
        # an orientation that is stated is not looked for in the light, and the place is missing all the same
        with pytest.raises(InputError, match=r"got 33 x 42 px; state .*--origin ROW,COLUMN"):
            drain(iter_upright(source, PLAN, "as-is"))
    with opened(tmp_path / "f", origin=(1, 6)) as source:
        found = FoundOrientation("as is", residual_px=0.1, offset_px=(-4.2, 0.1))
        words = "expected about 5,6, according to the position of the light, got 1,6; correct the origin"
        with pytest.raises(InputError, match=words):
            check_place(found, source, PLAN)
        check_place(replace(found, offset_px=(1.0, 0.5)), source, PLAN)
    with opened(tmp_path / "f", origin=(8, 8)) as source:
        words = "all of the frame is on the sensor of 40 x 48 px, got 8,8 for frames of 33 x 42 px"
        with pytest.raises(InputError, match=words):
            assemble_plan(source, PLAN)


def test_h_of_a_part_is_that_of_the_whole_frames(tmp_path: Path) -> None:
    """Dark and background of the part, or a dark frame of the whole sensor."""
    write_part(tmp_path / "part")
    write_part(tmp_path / "whole", (0, 0), (40, 48))
    dark = np.random.default_rng(4).integers(80, 120, (40, 48)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "dark.tif", dark)
    tifffile.imwrite(tmp_path / "dark_part.tif", dark[5:38, 6:48])
    with opened(tmp_path / "whole") as source:
        wanted = assemble_plan(corrected_view(source, CorrectionRecipe(dark=str(tmp_path / "dark.tif")), PLAN), PLAN)
    for name in ("dark.tif", "dark_part.tif"):
        with opened(tmp_path / "part", origin=ORIGIN) as source:
            view = corrected_view(source, CorrectionRecipe(dark=str(tmp_path / name)), PLAN)
            assert view.info(0).origin == ORIGIN
            turn, _ = drain(iter_upright(view, PLAN))
            assert turn.name == "as is"
            report = assemble_plan(view, PLAN)
        assert tuple(report.matrix.provenance["frames"]["origin"]) == ORIGIN
        np.testing.assert_array_equal(report.matrix[:], wanted.matrix[:])
    with opened(tmp_path / "part", origin=ORIGIN) as source:
        recipe = CorrectionRecipe(dark=str(tmp_path / "dark_part.tif"), background="border", defects=True)
        assemble_plan(corrected_view(source, recipe, PLAN), PLAN)
    with opened(tmp_path / "part", origin=ORIGIN) as source:
        recipe = CorrectionRecipe(dark=str(tmp_path / "dark.tif"), background="border")
        with pytest.raises(InputError, match="a constant for cutouts"):
            corrected_view(source, recipe, PLAN)


def test_a_part_that_is_delivered_mirrored_or_on_its_side(tmp_path: Path) -> None:
    write_part(tmp_path / "f", (5, 0), (33, 42))
    for path in (tmp_path / "f").iterdir():
        tifffile.imwrite(path, tifffile.imread(path)[:, ::-1].copy())
    with opened(tmp_path / "f", origin=(5, 6)) as source:
        upright = oriented(source, named_orientation("mirror-x"), PLAN.camera.sensor.shape)
        assert upright.info(0).origin == upright.metadata.origin == (5, 0)
        np.testing.assert_array_equal(upright.read(0), frame((0, 0), seed=0)[5:38, :42])
    # on its side, the origin is that of the sensor as delivered, 48 x 40 px: it would not fit upright
    write_part(tmp_path / "g", (12, 3), (20, 40))
    for path in (tmp_path / "g").iterdir():
        tifffile.imwrite(path, tifffile.imread(path).T.copy())
    with opened(tmp_path / "g", origin=(3, 12)) as source:
        upright = oriented(source, named_orientation("transpose"), PLAN.camera.sensor.shape)
        assert upright.metadata.origin == (12, 3)
        assemble_plan(upright, PLAN)
        turn, _ = drain(iter_upright(source, PLAN, "transpose"))
        assert turn.name == "transpose"


def test_colours_of_a_part_begin_with_its_first_pixel(tmp_path: Path) -> None:
    camera = replace(PLAN.camera, sensor=replace(PLAN.camera.sensor, cfa="RGGB"))
    plan = replace(PLAN, camera=camera)
    write_part(tmp_path / "f", (5, 6))
    with opened(tmp_path / "f", origin=(5, 6)) as source:
        described = DescribedSource(source, plan)
        assert described.metadata.cfa == "GBRG"
        with pytest.raises(InputError, match="a part that starts at the first pixel of a colour pattern"):
            channel_source(described, "R").info(0)
    mosaic = session((1, 6, 8))
    gains = (1.0, 2.0, 3.0, 4.0)
    facts = {"cfa": "GBRG", "origin": (5, 6)}
    part = ArraySource(mosaic, [(0, 0, 0)], origins=[(5, 6)], metadata=facts)
    plain = ArraySource(mosaic, [(0, 0, 0)], metadata={"cfa": "GBRG"})
    np.testing.assert_array_equal(balanced_source(part, gains).read(0), balanced_source(plain, gains).read(0))
    even = ArraySource(mosaic, [(0, 0, 0)], origins=[(4, 6)], metadata={"cfa": "RGGB", "origin": (4, 6)})
    red = channel_source(even, "R")
    assert red.info(0).origin == (2, 3) and red.metadata.origin == (2, 3)
    np.testing.assert_array_equal(red.read(0), mosaic[0, ::2, ::2])


def test_origins_that_are_none(tmp_path: Path) -> None:
    write_part(tmp_path / "f")
    for wrong in ((-1, 0), (1.5, 0), (1,)):
        with pytest.raises(InputError, match="origin of the frames"):
            opened(tmp_path / "f", origin=wrong)
    (tmp_path / "plan.json").write_text(PLAN.to_json())
    with pytest.raises(InputError, match="no option 'origin'"):
        open_frames(tmp_path / "plan.json", origin=(1, 2))
