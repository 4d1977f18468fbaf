"""``lfcal fit --hybrid`` and ``lfcal assemble --fill``: what a fit adds to what was recorded, and how it is marked."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.psf.facts import Facts, Origin
from tests.cli.conftest import Run
from tests.fit.commands import typed, undrawn
from tests.fit.common import few_patterns, small_plan

Lfcal = Callable[..., Run]
PLAN = replace(small_plan(15, (2.2,)), period=(4, 5))
FIT = ("--unknowns", "geometry", "--workers", 1)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def plain_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)


CORRECTED = ("--dark", "scan/dark", "--orientation", "as-is")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with simulated frames of which five are missing, and the fit of what is there."""
    place = tmp_path_factory.mktemp("fitted")
    (place / "plan.json").write_text(PLAN.to_json())
    typed(place, "simulate", "plan.json", "--frames", "scan", "--level", "grid", "--workers", 1)
    (place / "plan.json").unlink()
    for y, x in ((0, 1), (1, 3), (2, 0), (2, 4), (3, 2)):
        (place / "scan" / "frames" / f"z0_y{y:02d}_x{x:02d}.png").unlink()
    # it would name them
    for listed in (place / "scan" / "frames").glob("manifest.*"):
        listed.unlink()
    typed(place, "fit", "scan/frames", *CORRECTED, *FIT, "--positions", 0, "--no-h", drawn=False)
    return place


@pytest.fixture
def scan(place: Path, fitted: Path) -> Path:
    """Return the folder of the frames, beside it that of their fit."""
    shutil.copytree(fitted, place, dirs_exist_ok=True)
    return place / "scan"


@pytest.mark.long
@pytest.mark.usefixtures("plain_pages")
def test_missing_positions_are_filled_and_marked(lfcal: Lfcal, place: Path, scan: Path) -> None:
    bare = lfcal("assemble", "scan/frames", *CORRECTED, "-o", "bare.h5", "--dtype", "float32")
    assert bare.code == 0 and "Positions without a frame: 5 positions" in bare.out, bare.err
    assert "fill them (lfcal assemble --fill FIT)" in bare.out
    words = ("assemble", "scan/frames", *CORRECTED, "--fill", "fit", "--dtype", "float32", "--workers", 1)
    run = lfcal(*words, "-o", "H.h5")
    assert run.code == 0, run.err
    assert "5 of the missing positions are filled by the model of the fit, and marked" in run.err + run.out
    check = lfcal("verify", "H.h5", "--json")
    assert check.code == 0 and isinstance(check.json, dict) and check.json["deviations"] == []
    assert check.json["missing"] == 5
    truth = lfcal("simulate", "scan/plan.json", "--level", "grid", "-o", "truth.h5", "--workers", 1)
    assert truth.code == 0, truth.err
    with open_psf("H.h5") as H, open_psf("bare.h5") as other, open_psf("truth.h5") as true:
        missing = H.recorded == 0
        assert missing.sum() == 5 and H.facts.origin is not None
        np.testing.assert_array_equal(H.facts.origin, np.where(missing, Origin.MODEL, Origin.MEASURED))
        values, measured = np.asarray(H), np.asarray(other)
        # what was recorded is as it was
        np.testing.assert_array_equal(values[~missing], measured[~missing])
        assert not measured[missing].any()
        found, wanted = values[missing].astype(float), np.asarray(true)[missing].astype(float)
        # in the units of the frames: by the light of what was recorded
        wanted *= measured[~missing].sum(dtype=float) / np.asarray(true)[~missing].sum(dtype=float)
        off = np.sqrt(np.square(found - wanted).sum() / np.square(wanted).sum())
        assert off < 0.03
        z, y, x = np.argwhere(missing)[0].tolist()
        sigma = H.uncertainty(z, y, x)
        assert sigma is not None and sigma.max() > 0 and H.provenance["filled"]["fit"] == "fit"
        noise = H.uncertainty(*np.argwhere(~missing)[0].tolist())
        assert noise is None or np.all(noise > 0)
    plain = lfcal(*words, "-o", "H2.h5", "--json")
    assert isinstance(plain.json, dict) and plain.json["filled"] == 5 and len(plain.json["missing"]) == 5


@pytest.mark.long
@pytest.mark.usefixtures("plain_pages")
def test_a_fit_of_a_filled_h_takes_what_was_recorded(lfcal: Lfcal, place: Path, scan: Path) -> None:
    """The model is no measurement."""
    words = ("assemble", "scan/frames", *CORRECTED, "--fill", "fit", "--dtype", "float32", "--workers", 1)
    assert lfcal(*words, "-o", "H.h5").code == 0
    again = lfcal("fit", "H.h5", *FIT, "--noise", "100,1", "--positions", 0, "--no-h", "-o", "again", "--json")
    assert again.code == 0 and isinstance(again.json, dict), again.err
    assert again.json["patterns"] + len(again.json["outliers"]) == 15


def test_a_fit_of_something_else_fills_nothing(lfcal: Lfcal, place: Path, scan: Path) -> None:
    path = place / "fit" / "fit.json"
    kept = json.loads(path.read_text())
    camera = json.loads((place / "fit" / "camera.json").read_text())

    def told(what: str, change: dict[str, object] | None = None, text: str | None = None) -> None:
        path.write_text(json.dumps(kept | (change or {})) if text is None else text)
        run = lfcal("assemble", "scan/frames", *CORRECTED, "--fill", "fit", "-o", "H.h5")
        said = [line for line in run.err.splitlines() if "note: " not in line]
        assert run.code == 2 and len(said) == 1 and what in said[0], run.err
        assert not list(place.glob("H.h5*"))

    told("fit, period", {"scan": kept["scan"] | {"period": [9, 5]}})
    told("fit, depths", {"depths_um": [kept["depths_um"][0] + 50.0]})
    told("fit, anchor", {"scan": kept["scan"] | {"anchor": [3.0, 4.0]}})
    told("the results of a fit", {"gains": ["much"]})
    told("the results of a fit", {"gains": []})
    told("a result of an older version of lfcal", None, json.dumps({k: v for k, v in kept.items() if k != "scan"}))
    told('"lfcal-fit", version 1', None, "{}")
    told("fit.json", None, "no JSON")
    told("light as in the frames of plane 0", {"gains": [1.5 * kept["gains"][0]]})
    told("at least one fitted pattern", {"positions": []})
    camera["lattice"]["offset_um"] = [camera["lattice"]["offset_um"][0] + 25.0, camera["lattice"]["offset_um"][1]]
    (place / "fit" / "camera.json").write_text(json.dumps(camera))
    told("the fit of the camera that recorded plane 0")
    (place / "fit" / "camera.json").unlink()
    told("camera.json")
    run = lfcal("assemble", "scan/frames", *CORRECTED, "--fill", "nowhere", "-o", "H.h5")
    assert run.code == 2 and "nowhere" in run.err.splitlines()[-1]


@pytest.mark.long
def test_h_is_the_hybrid_of_all_that_was_recorded(lfcal: Lfcal, place: Path) -> None:
    """A pattern more that the model lacks at each position; all are used, though few are fitted."""
    data = few_patterns()
    values = np.asarray(data) + 400.0 * (data.recorded > 0)[..., None, None] * (np.indices((15, 15)).sum(0) % 4 == 0)
    facts = Facts.of(data.shape[:3], data.cutout, **data.facts.known())
    save(PSFMatrix(values, depths=data.depths, camera=data.camera, anchor=data.anchor, facts=facts), place / "few.h5")
    run = lfcal("fit", "few.h5", *FIT, "--positions", 4, "--hybrid")
    assert run.code == 0, run.err
    assert "6 positions changed by" in run.out + run.err
    said = json.loads((place / "fit" / "fit.json").read_text())
    assert said["patterns"] <= 4 and said["hybrid"]["hybrid"] == 6 and said["hybrid"]["model"] == 2
    page = (place / "fit" / "report" / "index.html").read_text()
    assert "6 positions changed by" in page
    assert lfcal("verify", "fit/H.h5").code == 0
    with open_psf("fit/H.h5") as H:
        np.testing.assert_array_equal(H.recorded, data.recorded)
        assert H.facts.origin is not None and H.provenance["hybrid"]["hybrid"] == 6
        np.testing.assert_array_equal(H.facts.origin > 1, data.recorded == 0)
        there = data.recorded > 0
        model = lfcal("fit", "few.h5", *FIT, "--positions", 4, "-o", "plain")
        assert model.code == 0, model.err
        with open_psf("plain/H.h5") as plain:
            near, far = (np.square(np.asarray(one) - values)[there].sum() for one in (H, plain))
            assert near < 0.5 * far
    bad = lfcal("fit", "few.h5", "--hybrid", "--no-h", "-o", "c")
    assert bad.code == 2 and bad.err.count("\n") == 1 and "--hybrid: expected an H to write" in bad.err
    assert not (place / "c").exists()
