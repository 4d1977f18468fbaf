"""``lfcal multiplex`` and ``lfcal bench multiplex`` as a user runs them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from lfcal.multiplex import cfa, mask, multiplex
from tests.cli.conftest import lfcal  # noqa: F401  the fixture
from tests.frames.scenes import shared


def test_compare_tells_the_numbers(lfcal, tmp_path: Path) -> None:  # noqa: F811
    done = lfcal(
        "multiplex",
        "compare",
        "Bayer",
        "CYMG",
        "RRGG",
        "--camera",
        "r29",
        "--monte-carlo",
        20000,
        "--json",
        "-o",
        tmp_path / "gain.png",
    )
    assert done.code == 0, done.err
    found = done.json
    bayer, cymg, poor = found["modulators"]
    assert cymg["gain_additive_db"] == pytest.approx(0.645, abs=1e-3) and cymg["gain_photon_db"] < 0
    assert found["chi2"] == pytest.approx(138.9, abs=0.1) and bayer["amplification"] == pytest.approx(0.9129, abs=1e-4)
    assert poor["lost"] == {"B": pytest.approx(1.0)} and poor["gain_db"] is None
    assert found["monte_carlo_gain_db"][1][0] == pytest.approx(0.645, abs=0.05)
    assert cv2.imread(str(tmp_path / "gain.png")).shape[0] > 300
    table = lfcal("multiplex", "compare", "pinhole:5", "MURA:5", "lenslet:3*Bayer")
    assert table.code == 0 and "pinhole" in table.out


def test_demosaic_writes_what_the_library_gives(lfcal, tmp_path: Path) -> None:  # noqa: F811
    light = np.array([300.0, 200, 100])[:, None, None] * np.ones((12, 14))
    cv2.imwrite(str(tmp_path / "frame.png"), (multiplex(light, cfa("CYMG")) + 50).astype(np.uint16))
    out = tmp_path / "rgb.tif"
    done = lfcal("multiplex", "demosaic", tmp_path / "frame.png", "-o", out, "--pattern", "CYMG", "--dark", 50)
    assert done.code == 0, done.err
    np.testing.assert_allclose(tifffile.imread(out), light, atol=1e-3)
    bad = lfcal("multiplex", "demosaic", tmp_path / "frame.png", "-o", tmp_path / "no.tif")
    assert bad.code == 2 and "pattern" in bad.err and not (tmp_path / "no.tif").exists()


def test_views_of_a_measured_lattice(lfcal, tmp_path: Path) -> None:  # noqa: F811
    folder = shared("lfm_guv/Lightfield_GUVExperim1.tif").parent
    out = tmp_path / "views.tif"
    done = lfcal(
        "multiplex",
        "views",
        folder / "Lightfield_GUVExperim1.tif",
        "--white",
        folder / "Radiometry_GUVExperim1.tif",
        "--dark",
        folder / "DarkFrame_GUVExperim1.tif",
        "-o",
        out,
    )
    assert done.code == 0, done.err
    views = tifffile.imread(out)
    assert views.shape[0] == 15 * 15 and min(views.shape[1:]) >= 25


def test_search_filters_and_pictures(lfcal, tmp_path: Path) -> None:  # noqa: F811
    found = lfcal("multiplex", "search", "--chi2", 0, "--json", "-o", tmp_path / "front.png").json
    assert found["frontier"][0]["gain_db"] == pytest.approx(0.645, abs=1e-3)
    masks = lfcal("multiplex", "search", "3", "--chi2", 1)
    assert masks.code == 0 and "pinhole" in masks.out
    trials = lfcal("multiplex", "filters", "--size", 64, "--json", "-o", tmp_path / "filters.png").json
    assert {t["filter"] for t in trials["sharp edges"]} >= {"nearest", "cubic", "bilateral", "sinc"}
    assert lfcal("multiplex", "show", "MURA:5", "-o", tmp_path / "mura.png").code == 0
    for name in ("front", "filters", "mura"):
        assert cv2.imread(str(tmp_path / f"{name}.png")).std() > 5
    assert lfcal("multiplex", "search", "--chi2", 1, "--camera", "r29").code == 2
    assert lfcal("multiplex", "show", "MURA:9", "-o", tmp_path / "no.png").code == 2


def test_the_papers_figures(lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    from lfcal.cli import multiplex_figures as pictures

    monkeypatch.setattr(pictures, "RIGHT", ("MURA", "pinhole"))
    monkeypatch.setattr(pictures, "SIDE", 5)
    monkeypatch.setattr(pictures, "PICTURED", ("X-Trans",))
    done = lfcal("multiplex", "figures", tmp_path / "out", "--camera", "bench")
    assert done.code == 0, done.err
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert {f"figure{n}.png" for n in (3, 5, 6, 7)} <= names and "modulator_X-Trans.png" in names
    for path in (tmp_path / "out").iterdir():
        assert cv2.imread(str(path)).std() > 5


def test_benchmark(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from lfcal.bench import multiplex as bench

    monkeypatch.setattr(bench, "FULL", (256, 384))
    bench.command(quick=False, filters="cubic", rounds=1, workers=1, json=True)
    rows = json.loads(capsys.readouterr().out)
    assert [r["name"] for r in rows] == ["demosaic, cubic", "31 x 31 views, linear", "31 x 31 views, cubic"]
    assert all(r["ratio"] > 0 and r["bound"] == 5 for r in rows)
    assert mask("lenslet", 31).count == 961
