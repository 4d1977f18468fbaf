"""``lfcal fit`` of several regions of the field."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lfcal.camera import Camera, ScanPlan
from lfcal.fit import Setup
from lfcal.fit.locate import NewFrame
from lfcal.fit.model import Fineness, predict
from lfcal.fit.setup import described_effects
from lfcal.fit.stored import read_fit
from lfcal.judge.known_object import ObjectPlace, nearest, object_error
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.psf.facts import Facts
from lfcal.simulate.effects import FieldAberrations
from lfcal.simulate.effects.described import parse_entries
from tests.cli.conftest import Lfcal
from tests.fit.commands import typed
from tests.fit.field_common import ANCHORS, camera

LAW = FieldAberrations(0.4, 0.0, radius_um=7e3)


@cache
def region(name: str) -> PSFMatrix:
    """Return an H of eight positions, seven of them recorded, of a camera with coma over the field."""
    plan = ScanPlan.for_camera(camera(), virtual_depths=(2.2,), cutout=15, anchor=ANCHORS[name])
    plan = replace(plan, period=(2, 4))
    index = np.argwhere(np.ones(plan.shape[:3], bool))[[0, 1, 2, 3, 4, 6, 7]]
    true = Setup(camera(), (*described_effects(camera()), LAW), (0.0,))
    light = predict(true, plan, index, np.zeros((7, 2)), Fineness.finest)
    rng = np.random.default_rng(len(name))
    clean = 16e3 * np.maximum(light, 0) / light.max()
    values, recorded = np.zeros(plan.shape, np.float32), np.zeros(plan.shape[:3], int)
    values[tuple(index.T)] = rng.poisson(clean) + 8.0 * rng.standard_normal(clean.shape)
    recorded[tuple(index.T)] = 1
    facts = Facts.of(plan.shape[:3], plan.cutout, recorded=recorded, noise=np.tile([64.0, 1.0], (*plan.shape[:3], 1)))
    return PSFMatrix(values, depths=plan.depths_um, camera=plan.camera, anchor=plan.anchor, facts=facts)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("centre", "edge"):
        save(region(name), tmp_path / f"{name}.h5")
    monkeypatch.chdir(tmp_path)
    return tmp_path


BLACK: tuple[object, ...] = ("--black-level", 50)
WORDS: tuple[object, ...] = ("--unknowns", "field_wavefront", "--positions", "4")


def known_object(read: float = 8.0) -> tuple[np.ndarray, np.ndarray]:
    """Return two points, one in each region, the second twice as bright, and their frame."""
    volume, frame = (np.zeros(camera().sensor.shape, np.float32) for _ in range(2))
    for name, (y, x), bright in (("centre", (1, 2), 1.0), ("edge", (0, 3), 2.0)):
        plan = ScanPlan.for_camera(camera(), virtual_depths=(2.2,), cutout=15, anchor=ANCHORS[name])
        plan = replace(plan, period=(2, 4))
        true = Setup(camera(), (*described_effects(camera()), LAW), (0.0,))
        row, column = math.floor(plan.anchor[0]) + y, math.floor(plan.anchor[1]) + x
        volume[row, column] = bright
        light = predict(true, plan, np.array([[0, y, x]]), np.zeros((1, 2)), Fineness.finest)[0]
        frame[row - 7 : row + 8, column - 7 : column + 8] += bright * light
    rng = np.random.default_rng(5)
    clean = 3.5e3 * np.maximum(frame, 0) / frame.max()
    # whole numbers have a twelfth of the variance
    noisy = rng.poisson(clean) + math.sqrt(read**2 - 1 / 12) * rng.standard_normal(clean.shape)
    return volume[None], np.rint(50 + noisy).astype(np.uint16)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return the folder in which two regions were fitted, and what was said."""
    folder = tmp_path_factory.mktemp("regions")
    for name in ("centre", "edge"):
        save(region(name), folder / f"{name}.h5")
    said, _ = typed(folder, "fit", "centre.h5", "edge.h5", *WORDS, "--workers", 1, "--json", pictures=False)
    return folder, json.loads(said)


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return such a folder and what was said, where the fit was also held against points, a place and an object."""
    folder = tmp_path_factory.mktemp("judged")
    for name, of in (("centre", "centre"), ("edge", "edge"), ("there", "corner")):
        save(region(of), folder / f"{name}.h5")
    volume, frame = known_object()
    np.save(folder / "points.npy", volume)
    cv2.imwrite(str(folder / "points.tif"), frame)
    more = ("--workers", 1, "--json")
    told: dict[str, Any] = {}
    for name, words in {
        "fit": ("fit", "centre.h5", "edge.h5", *WORDS, "--hybrid", "--noise", "64,1"),
        "here": ("fit", "validate", "fit", "centre.h5", "edge.h5", "--positions", 4, "--noise", "64,1"),
        "there": ("fit", "validate", "fit", "there.h5", "--other", "--positions", 4, "--noise", "64,1"),
        "object": ("fit", "object", "fit", "points.tif", "--scene", "points.npy", "--noise", "64,1", *BLACK),
    }.items():
        told[name] = json.loads(typed(folder, *words, *more, pictures=False)[0])
    return folder, told


@pytest.mark.long
def test_regions_are_fitted_as_one_camera(whole: tuple[Path, dict[str, Any]]) -> None:
    place, _ = whole
    found = json.loads((place / "fit" / "field.json").read_text())
    assert [one["name"] for one in found["regions"]] == ["centre", "edge"] and found["complete"]
    coma = next(one for one in found["parameters"] if one["name"] == "field_coma")
    _, (law,) = parse_entries(place / "fit" / "effects.json")
    assert isinstance(law, FieldAberrations) and law.coma == coma["value"]
    assert abs(coma["value"] / law.radius_um - 0.4 / 7e3) < 4 * coma["sigma"] / law.radius_um < 0.1 * 0.4 / 7e3
    # a region's folder equals that of a separate fit: the offset of its sources, and H there
    aside = found["regions"][1]["aside_px"]
    assert read_fit(place / "fit" / "edge").setup.aside_px == tuple(aside) != (0.0, 0.0)
    with open_psf(place / "fit" / "edge" / "H.h5") as H, open_psf(place / "edge.h5") as measured:
        assert H.anchor == measured.anchor and H.provenance["fit"]["aside_px"] == aside
        data, model = np.asarray(measured[0, 1, 2]), np.asarray(H[0, 1, 2])
        assert np.corrcoef(data.ravel(), model.ravel())[0, 1] > 0.99
    assert Camera.from_json((place / "fit" / "camera.json").read_text()).name == camera().name


@pytest.mark.long
def test_what_a_fit_of_regions_wrote_is_kept(
    whole: tuple[Path, dict[str, Any]], lfcal: Lfcal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(whole[0])
    before = {path: path.stat().st_mtime_ns for path in whole[0].rglob("*")}
    words = ("fit", "centre.h5", "edge.h5", "--unknowns", "field_wavefront")
    lfcal(*words).refused("exists; add --force")
    # H of these regions is not kept with another camera
    lfcal(*words, "--no-h", "--force").refused("a folder without another fit")
    assert {path: path.stat().st_mtime_ns for path in whole[0].rglob("*")} == before
    out = lfcal(*words, "--no-h", "--workers", "1", "-o", "table").ok().out
    assert all(shown in out for shown in ("error of the model", "wavefront (waves)", "field_coma"))


@pytest.mark.long
def test_hybrid_and_validation_are_each_regions_own(judged: tuple[Path, dict[str, Any]]) -> None:
    place, told = judged
    validation = {one["name"]: one for one in told["here"]} | {told["there"]["name"]: told["there"]}
    assert set(told["fit"]["hybrid"]) == {"centre", "edge"} and set(validation) == {"centre", "edge", "there"}
    for name in ("centre", "edge"):
        folder = place / "fit" / name
        with open_psf(folder / "H.h5") as H, open_psf(place / f"{name}.h5") as measured:
            # of an H all recorded patterns are in it, not those alone that were fitted
            assert (
                (H.recorded == measured.recorded).all() and H.facts.origin is not None and H.uncertainty(0, 0, 0).any()
            )
        found = json.loads((folder / "validation.json").read_text())
        assert len(found["points"]) == 3 and found["points"] == validation[name]["points"]
        assert found["source"] == f"{name}.h5"
        assert "Points that were not fitted" in (folder / "report" / "index.html").read_text()
    # at a place that no fit saw the law's wavefront predicts, one period taken as the other does not
    there = json.loads((place / "fit" / "validation.json").read_text())
    assert len(there["points"]) == 4
    off, periodic = (there["errors"][how]["all"] for how in ("camera", "periodic"))
    assert periodic["known"] and (off["value"] if off["known"] else off["limit"]) < 0.3 * periodic["value"]


@pytest.mark.long
def test_the_field_as_a_whole_has_a_page(whole: tuple[Path, dict[str, Any]]) -> None:
    place, _ = whole
    page = (place / "fit" / "report" / "index.html").read_text()
    found = json.loads((place / "fit" / "field.json").read_text())
    for one in found["regions"]:
        # how well it does there, which the mean of all hides
        assert 0.5 < one["chi2"] < 1.6 and one["error"]["limit"] > 0
        x, y = one["field_um"]
        assert f"<td>{one['name']}</td><td>{x / 1e3:.2f}, {y / 1e3:.2f}</td><td>4</td>" in page
        down, right = one["aside_px"]
        assert f"{down:+.3f}, {right:+.3f}" in page
        for term in one["wavefront"]:
            assert f"{term['waves']:.3f} ± {term['sigma']:.2g}" in page
    assert "<th>Z(3, 1)</th>" in page and "field_coma" in page
    picture = cv2.imread(str(place / "fit" / "report" / "wavefront.png")).astype(int)
    # wavefronts in red and blue on white
    apart = picture[..., 2] - picture[..., 0]
    assert min(picture.shape[:2]) > 300 and (apart > 80).any() and (apart < -80).any()


@pytest.mark.long
def test_each_point_of_an_object_is_seen_by_h_of_the_nearest_region(judged: tuple[Path, dict[str, Any]]) -> None:
    place, told = judged
    found = told["object"]
    assert found["frame"] == "points.tif"
    # 4.8 million dark pixels hide what the points' 450 have
    assert not found["error"]["known"] and found["error"]["limit"] < 0.12
    volume, frame = known_object(1.0)
    part = np.s_[900:1060, 1150:2300]
    shot, volume = NewFrame(frame[part].astype(np.float32) - 50, origin=(900, 1150)), volume[:, *part]
    places = [ObjectPlace(place / "fit" / n / "H.h5", ANCHORS[n], (1.0,)) for n in ("centre", "edge")]
    assert nearest(places, (2000, 2400), (0, 0))[985, [1000, 1719, 1721, 2250]].tolist() == [0, 0, 1, 1]
    assert nearest(places, (2000, 1400), (0, 1000))[985, [0, 719, 721]].tolist() == [0, 0, 1]
    # with one of them for all of the field coma is lacking
    both, alone = (object_error(used, shot, volume, (1.0, 1.0), 1).error for used in (places, places[:1]))
    assert both.value < 0.03 and alone.known and alone.value > 0.1


def test_what_is_not_a_set_of_regions_is_refused(place: Path, lfcal: Lfcal) -> None:
    for name in ("other", "report"):
        (place / f"{name}.h5").write_bytes((place / "centre.h5").read_bytes())
    for words, said in (
        ("centre.h5 centre.h5", "sources: expected a different name for each region, got centre twice"),
        ("centre.h5 other.h5", "'other': expected a distance of at least 30 px from region 'centre', got 0 px"),
        ("centre.h5 edge.h5 --hybrid --no-h", "--hybrid: expected an H to write, got --no-h"),
        ("centre.h5 report.h5", "expected a region with another name, got report, which is the name of the common"),
        ("centre.h5 --unknowns field_wavefront", "which needs patterns of several regions"),
    ):
        lfcal("fit", *words.split()).refused(said)
        assert not (place / "fit").exists(), words
