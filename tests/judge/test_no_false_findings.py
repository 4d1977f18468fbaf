"""H without a fault has none named: small cells, files without noise, cutouts that are too small, rounded periods."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks._fault_recordings import Recording
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, preset
from lfcal.judge import Evidence, FoundFault, iter_evidence, iter_inspection, iter_search
from lfcal.judge.quality import QualityReport, inspect
from lfcal.psf import PSFMatrix
from tests.judge.common import FEWEST, SOME, Values, compressed

NEAR, FAR = (-20.0, 0.0, 20.0), (-60.0, 0.0, 60.0)


OTHER_PLANES = (((15.0, 30.0, 30.2), False), ((30.0, 30.2), True))


@cache
def microscope(pitch_px: float, depths: tuple[float, ...] = NEAR, cutout: int = 31) -> Recording:
    """Return a recording of a light-field microscope whose lenslets are so many pixels apart."""
    camera = preset("lfm_20x05")
    camera = replace(camera, sensor=replace(camera.sensor, pixel_um=camera.lattice.pitch_um / pitch_px))
    return Recording(ScanPlan.for_camera(camera, depths_um=depths, cutout=cutout))


def findings(r: Recording, values: Values, provenance: Mapping[str, Any] | None = None) -> tuple[FoundFault, ...]:
    plan = r.plan
    H = PSFMatrix(values, depths=plan.depths_um, camera=plan.camera, anchor=plan.anchor, provenance=provenance)
    evidence = drain(iter_evidence(H, patterns=SOME))
    assert isinstance(evidence, Evidence)
    return drain(iter_search(evidence))[0]


def doubted(quality: QualityReport) -> set[str]:
    return {m.key for m in quality.metrics if m.merit in ("bad", "fair")}


@pytest.mark.parametrize(
    ("pitch", "cutout"),
    [(6, 31), *(pytest.param(p, 4 * p + 3, marks=pytest.mark.long) for p in (5, 7, 8, 9, 10, 11, 12, 14, 16))],
)
def test_small_cells_without_noise_are_neither_compressed_nor_from_a_bad_sensor(pitch: int, cutout: int) -> None:
    r = microscope(pitch, cutout=cutout)
    named = {one.name for one in findings(r, r.light())}
    assert not named & {"compression", "dead_line", "bad_pixels", "hot_line", "depth_label", "pupil"}


@pytest.mark.parametrize("pitch", [pytest.param(5, marks=pytest.mark.long), 6])
def test_small_cells_with_noise_have_no_fault(pitch: int) -> None:
    """Between lenslets a few pixels apart the model is off by more than the light there, and in focus by 1 %."""
    r = microscope(pitch)
    named = {one.name for one in findings(r, r.clean())}
    assert not named & {"compression", "dead_line", "bad_pixels", "hot_line"}
    assert pitch == 5 or not named


@pytest.mark.parametrize(
    "quality", [75, pytest.param(95, marks=pytest.mark.long), pytest.param(30, marks=pytest.mark.long)]
)
def test_a_compression_is_named_with_small_cells_unless_frames_were_stored_without_loss(quality: int) -> None:
    r = microscope(9, cutout=39)
    values = compressed(r.clean(), quality)

    def named(provenance: Mapping[str, Any] | None) -> bool:
        return "compression" in {one.name for one in findings(r, values, provenance)}

    assert named(None) and named({"frames": {"codec": {"name": "unknown"}}}) and named({"frames": "any"})
    assert not named({"frames": {"codec": {"name": "lzw", "lossless": True}}})


@pytest.mark.parametrize("noise", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize("pitch", [7, pytest.param(12, marks=pytest.mark.long)])
def test_what_is_cut_off_is_no_other_fault(pitch: int, noise: bool) -> None:
    """Of complete frames whose cutouts are filled: missing frames, dark planes, stage steps, saturated pixels."""
    r = microscope(pitch, FAR)
    values = r.clean() if noise else r.light()
    quality = inspect(r.matrix(values), workers=1)
    assert [m.key for m in quality.alarms if m.key != "hot_pixels"] == ["truncation"]
    assert doubted(quality) <= {"truncation", "hot_pixels", "position"}
    values[0, 2, 3] = 0 * values[0, 2, 3]
    assert inspect(r.matrix(values), workers=1)["missing"].positions.tolist() == [[0, 2, 3]]


def test_a_fault_that_costs_nothing_does_not_hide_what_is_cut_off() -> None:
    r = microscope(7)
    H = r.matrix(r.light())
    found = drain(iter_inspection(H, inspect(H, workers=1), patterns=FEWEST))
    assert found.bad and "light at the edge" in found.verdict


@cache
def rounded() -> Recording:
    """Return a recording whose period, 7 px, is 0.4 px less than its lenslets are apart."""
    return microscope(7.4, (15.0, 30.0), 41)


def test_a_rounded_period_makes_no_seam_and_other_seams_are_named() -> None:
    quality = inspect(rounded().matrix(rounded().clean()), workers=1)
    assert quality["seam"].merit == "good" and quality["period"].merit == "fair"
    # patterns of lenslets 8 px apart, of which 7 positions were recorded as if that were a period
    r = microscope(7, rounded().plan.depths_um, 41)
    values = microscope(8, r.plan.depths_um, 41).clean()[:, :7, :7]
    assert inspect(r.matrix(np.ascontiguousarray(values)), workers=1)["seam"].merit == "bad"


def test_odd_frames_and_a_seam_that_the_camera_explains_are_none() -> None:
    """Frames change more from one to the next, and across the wrap, where a source crosses from lenslet to lenslet."""
    r = microscope(7)
    H = r.matrix(r.clean())
    quality = inspect(H, workers=1)
    fair = {key: replace(quality[key], value=3.3, merit="fair", cost=0.05) for key in ("step", "seam")}
    rest = (m if m.merit in ("good", "unknown") else replace(m, merit="good", cost=0.0) for m in quality.metrics)
    metrics = tuple(fair.get(m.key, m) for m in rest)
    found = drain(iter_inspection(H, replace(quality, metrics=metrics), patterns=FEWEST))
    assert found.compared and found.merit == "good" and "should be checked" not in found.verdict


@pytest.mark.parametrize(
    ("depths", "noise"),
    [((15.0, 30.0, 30.2), True), *(pytest.param(*one, marks=pytest.mark.long) for one in OTHER_PLANES)],
)
def test_planes_close_together_are_no_copies_and_copies_are_found(depths: tuple[float, ...], noise: bool) -> None:
    """They differ by less than noise; copies share it."""
    r = microscope(7, depths)
    values = r.clean() if noise else r.light()
    assert inspect(r.matrix(values), workers=1)["plane_copies"].merit == "good"
    values[-1] = values[-2]
    assert inspect(r.matrix(values), workers=1)["plane_copies"].merit == "bad"
    if len(depths) == 3 and noise:  # a depth that was recorded twice, among others
        r = microscope(7, (15.0, 22.0, 30.0))
        light = r.light()
        light[2] = light[1]
        assert inspect(r.matrix(r.noisy(light)), workers=1)["plane_copies"].merit == "bad"
