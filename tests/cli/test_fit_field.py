"""``lfcal fit`` of several regions of the field."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.camera import Camera, ScanPlan
from lfcal.fit import Setup
from lfcal.fit.model import Fineness, predict
from lfcal.fit.setup import described_effects
from lfcal.fit.stored import read_fit
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.psf.facts import Facts
from lfcal.simulate.effects import FieldAberrations
from lfcal.simulate.effects.described import parse_entries
from tests.cli.conftest import Run
from tests.fit.field_common import ANCHORS, camera

Lfcal = Callable[..., Run]
LAW = FieldAberrations(0.4, 0.0, radius_um=7e3)


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


def test_regions_are_fitted_as_one_camera(place: Path, lfcal: Lfcal) -> None:
    run = lfcal("fit", "centre.h5", "edge.h5", "--unknowns", "field_wavefront", "--workers", "1")
    assert not run.code, run.err
    assert "wavefront (waves)" in run.out and "field_coma" in run.out
    found = json.loads((place / "fit" / "field.json").read_text())
    assert [one["name"] for one in found["regions"]] == ["centre", "edge"] and found["complete"]
    coma = next(one for one in found["parameters"] if one["name"] == "field_coma")
    _, (law,) = parse_entries(place / "fit" / "effects.json")
    assert isinstance(law, FieldAberrations) and law.coma == coma["value"]
    assert abs(coma["value"] / law.radius_um - 0.4 / 7e3) < 4 * coma["sigma"] / law.radius_um < 0.1 * 0.4 / 7e3
    # a region's folder is as of a fit of its own: its sources beside their places, and H there
    aside = found["regions"][1]["aside_px"]
    assert read_fit(place / "fit" / "edge").setup.aside_px == tuple(aside) != (0.0, 0.0)
    with open_psf(place / "fit" / "edge" / "H.h5") as H, open_psf(place / "edge.h5") as measured:
        assert H.anchor == measured.anchor and H.provenance["fit"]["aside_px"] == aside
        data, model = np.asarray(measured[0, 1, 2]), np.asarray(H[0, 1, 2])
        assert np.corrcoef(data.ravel(), model.ravel())[0, 1] > 0.99
    assert Camera.from_json((place / "fit" / "camera.json").read_text()).name == camera().name
    again = lfcal("fit", "centre.h5", "edge.h5", "--unknowns", "field_wavefront")
    assert again.code == 2 and "exists; add --force" in again.err
    # H of these regions does not stay beside another camera
    bare = lfcal("fit", "centre.h5", "edge.h5", "--no-h", "--force")
    assert bare.code == 2 and "no fit of another camera" in bare.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("centre.h5", "centre.h5"), "SOURCE: expected regions of different names, got centre twice"),
        (("centre.h5", "other.h5"), "region 'other': expected 30 px or more from 'centre', got 0 px"),
        (("centre.h5", "edge.h5", "--hybrid"), "--hybrid: expected one SOURCE, got 2"),
        (("centre.h5", "edge.h5", "--validate"), "--validate: expected one SOURCE, got 2"),
        (("centre.h5", "--unknowns", "field_wavefront"), "which needs a main lens, and patterns of several regions"),
    ],
)
def test_what_is_no_set_of_regions_is_refused_in_a_line(
    place: Path, lfcal: Lfcal, words: tuple[str, ...], said: str
) -> None:
    (place / "other.h5").write_bytes((place / "centre.h5").read_bytes())
    run = lfcal("fit", *words)
    assert run.code == 2 and said in run.err and not (place / "fit").exists()
