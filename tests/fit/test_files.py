"""A fit as files, pictures and a page: what they hold is what was found."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, preset
from lfcal.fit import Fit, Measured, measured_of
from lfcal.fit.drawing import leftover_of, lens_types
from lfcal.fit.files import effects_text, fit_dict, iter_write_model, json_text, measured_camera
from lfcal.fit.report import iter_fit_report, report_files
from lfcal.psf import open_psf
from lfcal.simulate.effects import Crosstalk, LensletSpherical
from lfcal.simulate.effects.described import parse_entries
from tests.fit.commands import unpictured
from tests.fit.common import few_fit, few_patterns


def found() -> tuple[Measured, Fit]:
    return measured_of(few_patterns()), few_fit()


def test_the_model_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    _, fit = found()
    drain(iter_write_model(fit, tmp_path / "H.h5", provenance={"source": "here"}, workers=1))
    with open_psf(tmp_path / "H.h5") as H:
        np.testing.assert_array_equal(np.asarray(H), np.asarray(fit.model(workers=1)))
        assert H.provenance["source"] == "here" and H.provenance["fit"]["groups"] == ["geometry"]
        assert H.provenance["plan"]["camera"]["lattice"]["gap_um"] == fit.camera.lattice.gap_um
        np.testing.assert_array_equal(H.depths, few_patterns().depths)
    work = iter_write_model(fit, tmp_path / "stopped.h5", workers=1)
    assert [next(work).done for _ in range(2)] == [0, 1]
    work.close()
    assert [path.name for path in tmp_path.iterdir()] == ["H.h5"]


def test_effects_are_written_as_simulate_reads_them(tmp_path: Path) -> None:
    _, fit = found()
    more = fit.setup.with_effect(Crosstalk(0.012)).with_effect(LensletSpherical(0.0, 0.1, -0.08, 0.15))
    (tmp_path / "effects.json").write_text(effects_text(replace(fit, setup=more)))
    settings, given = parse_entries(tmp_path / "effects.json")
    assert set(settings) == {one.name for one in more.effects} and set(settings.values()) == {"on"}
    assert {one for one in more.effects if one in given} == {Crosstalk(0.012), LensletSpherical(0.0, 0.1, -0.08, 0.15)}
    data = json.loads((tmp_path / "effects.json").read_text())
    assert next(one for one in data if one["name"] == "crosstalk")["sources"] == {"share": "measured"}


def test_numbers_are_plain_and_finite() -> None:
    _, fit = found()
    text = json_text(fit_dict(fit))
    data = json.loads(text)
    assert "NaN" not in text and "Infinity" not in text
    assert [one["name"] for one in data["parameters"]] == list(fit.parameters)
    np.testing.assert_allclose(np.diag(data["correlations"]), 1.0)
    assert data["left_out_error"]["sigma"] is None and not data["left_out_error"]["known"]
    assert measured_camera(fit) == fit.camera and measured_camera(fit).marks["lattice.gap_um"] == "measured"
    assert measured_camera(fit).marks["lattice.pitch_um"] == "stated"


def test_the_residual_is_noise_alone() -> None:
    measured, fit = found()
    left = leftover_of(fit, measured)
    assert left.measured.shape == left.model.shape == left.residual.shape == measured.patterns.shape
    sigma = np.sqrt(64.0 + np.maximum(left.model, 0))
    # residuals are the difference in units of its noise
    np.testing.assert_allclose(left.residual, (left.measured - left.model) / sigma, atol=0.05)
    assert left.maps.shape == (1, 15, 15) and left.by_type.shape == (3,)
    for values in (left.by_plane, left.by_type):
        assert np.all(np.abs(values - 1.0) < 0.35)
    assert left.chi2[~measured.held_out].mean() == pytest.approx(fit.chi2, rel=0.015)
    assert left.by_plane[0] == pytest.approx(left.chi2.mean(), rel=0.01)


def test_the_type_of_the_lenslet_before_each_pixel() -> None:
    """Against the distances to all centres."""
    camera = preset("bench")
    plan = ScanPlan.for_camera(camera, virtual_depths=(3.0,), cutout=31)
    types = lens_types(camera, plan, 2, 5)
    middle = np.round(np.add(plan.anchor, (2, 5)))
    x, y = camera.sensor_um(middle)
    centres, kinds = camera.lattice.lenslets_within(300, 300, (float(x), float(y)))
    for t, s in ((0, 0), (15, 15), (30, 3), (8, 21), (22, 30)):
        point = camera.sensor_um(np.add(middle, (t - 15, s - 15)))
        assert types[t, s] == kinds[np.argmin(np.hypot(*(centres - point).T))]
    assert set(np.unique(types)) == {0, 1, 2}


def test_the_report_is_one_page_with_its_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measured, fit = found()
    page = drain(iter_fit_report(fit, measured, tmp_path / "report", "<H>.h5"))
    assert set((tmp_path / "report").iterdir()) == set(report_files(tmp_path / "report"))
    text = page.read_text()
    assert "<h1>&lt;H&gt;.h5: optics fitted from 6 patterns</h1>" in text and fit.verdict.split(";")[0][4:] in text
    assert all(name in text for name in fit.parameters) and "tilt is fixed" in text
    uneven = replace(fit, spread=replace(fit.spread, response=0.012))
    unpictured(monkeypatch)
    said = drain(iter_fit_report(uneven, measured, tmp_path / "uneven")).read_text()
    assert "Pixels respond unevenly by 1.2 % (rms)" in said and "Pixels respond" not in text
    work = iter_fit_report(fit, measured, tmp_path / "stopped")
    next(work), next(work)
    work.close()
    assert not (tmp_path / "stopped").exists()
