"""``lfcal simulate`` as a user runs it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.camera import RegionPlan, ScanPlan, preset
from lfcal.frames import open_frames
from lfcal.judge.region_loss import region_loss
from lfcal.psf import open_psf, regions_of
from lfcal.simulate import plan_effects, simulate_psf
from lfcal.simulate.effects.described import parse_effects
from tests.cli.conftest import Lfcal
from tests.targets.common import small


# -- ``lfcal simulate`` as a user runs it --
@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(90, 100)))
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=41), period=(2, 3))
    path = tmp_path / "plan.json"
    path.write_text(plan.to_json())
    return path


def test_plan_only_shows_every_effect(lfcal: Lfcal) -> None:
    run = lfcal("simulate", "r29", "--virtual-depths", "4", "--plan-only", "--json").ok()
    rows = {row["name"]: row for row in run.json["effects"]}
    assert rows["lens_types"]["on"] and not rows["bandwidth"]["on"] and len(rows) >= 28
    table = lfcal("simulate", "bench", "--virtual-depths", "4", "--plan-only", "--effect", "crosstalk=on")
    assert "switched on" in table.out and "whole H" in table.out
    assert "time with it" in table.out and "without it" in table.out
    diffraction = rows["lenslet_diffraction"]
    assert diffraction["seconds_with"] == pytest.approx(run.json["seconds"])
    assert 0 < diffraction["seconds_without"] < diffraction["seconds_with"]


@pytest.mark.parametrize(
    ("camera", "title"),
    [
        ("bench --virtual-depths 4", "engine grid"),  # the title was "level wave"
        *(
            pytest.param(*one, marks=pytest.mark.long)
            for one in (
                ("bench --virtual-depths 4 --level geometric", "engine geometric"),
                ("lfm_20x05 --depths 0", "engine microscope"),
            )
        ),
    ],
)
def test_plan_only_names_the_engine_that_runs(lfcal: Lfcal, tmp_path: Path, camera: str, title: str) -> None:
    words = ("simulate", *camera.split(), "--cutout", "31")
    lines = [line.rstrip() for line in lfcal(*words, "--plan-only").out.splitlines()]
    assert any(line.endswith(f"%, {title}") for line in lines)
    engines = lfcal(*words, "--plan-only", "--json").json["engines"]
    lfcal(*words, "-o", tmp_path / "H.h5").ok()
    with open_psf(tmp_path / "H.h5") as H:
        assert [plane["engine"] for plane in H.provenance["simulated"]["planes"]] == engines


@pytest.mark.parametrize("run", [(), pytest.param(("--progressive",), marks=pytest.mark.long)])
def test_light_outside_the_cutout_is_reported(
    lfcal: Lfcal, plan_file: Path, tmp_path: Path, run: tuple[str, ...]
) -> None:
    """Compared with a cutout that contains all of it; each H was within 3 % by what was printed, whatever it lacked."""
    plan, out = ScanPlan.from_json(plan_file.read_text()), tmp_path / "H.h5"
    held, shares = {}, {}
    for cutout in (21, 55):
        plan_file.write_text(replace(plan, cutout=(cutout, cutout)).to_json())
        done = lfcal("simulate", plan_file, "-o", out, "--force", "--tolerance", 0.5, "--json", *run).ok()
        assert ("contains less than 90 % of the light in 1 of 1 planes" in done.err) == (cutout == 21)
        shares[cutout] = done.json["light_in_cutout"][0]
        with open_psf(out) as H:
            held[cutout] = float(H.plane(0).sum())
            assert H.shape == (1, 2, 3, cutout, cutout) and H.provenance["plan"]["period"] == [2, 3]
    assert shares[55] > 0.95 and shares[21] < 0.6
    assert shares[21] == pytest.approx(shares[55] * held[21] / held[55], rel=0.05)
    again = lfcal("simulate", plan_file, "-o", out, "--tolerance", 0.5, "--force", *run)
    assert f"light in the cutout: {100 * shares[55]:.3g} %" in again.err


def test_a_period_that_does_not_fit_the_lattice_is_reported(lfcal: Lfcal, tmp_path: Path) -> None:
    """As `lfcal plan` reports it; a plan that resamples, or has no whole period, reports nothing."""
    said = "the period of H, 15 x 15 px, does not match that of the lattice, 15.385 x 15.385 px: they drift apart"
    assert f"{said} by 52.5 px" in lfcal("simulate", "lfm_60x12", "--depths", "0", "--plan-only").err
    lfcal("plan", "lfm_60x12", "--depths", "0", "--resample", "-o", tmp_path / "plan.json").ok()
    assert "does not match" not in lfcal("simulate", tmp_path / "plan.json", "--plan-only").err


def test_frames_of_a_session(lfcal: Lfcal, plan_file: Path, tmp_path: Path) -> None:
    """Twice the share of the full well is twice the light above the black level."""
    light = []
    for peak in (0.3, 0.6):
        folder = tmp_path / f"peak{peak}"
        lfcal("simulate", plan_file, "--frames", folder, "--level", "geometric", "--seed", 3, "--peak", peak).ok()
        names = {"frames", "dark", "white", "camera.json", "plan.json", "truth.json"}
        assert {p.name for p in folder.iterdir()} == names
        with open_frames(folder / "frames", plan_shape=(1, 2, 3)) as source:
            assert len(source) == 6 and source.shape == (90, 100)
            level = np.median(source.read(0))
            light.append(sum(source.read(k).astype(float).sum() - level * 90 * 100 for k in range(6)))
    assert light[1] / light[0] == pytest.approx(2, rel=0.1)
    lfcal("simulate", plan_file, "--frames", folder).refused("empty folder")
    words = (folder / "frames", "--dark", folder / "dark", "--plan", folder / "plan.json", "--strict")
    lfcal("assemble", *words, "-o", tmp_path / "H.h5").ok()


def test_planes_in_micrometres_and_any_number_of_threads(lfcal: Lfcal, tmp_path: Path) -> None:
    plan = ("--depths", "-20mm", "--cutout", 21, "--level", "geometric")
    made = []
    for workers in (1, 2):
        lfcal("simulate", "bench", *plan, "--out", tmp_path / f"{workers}.h5", "--workers", workers).ok()
        with open_psf(tmp_path / f"{workers}.h5") as H:
            assert list(H.depths) == [-20000]
            made.append(H.plane(0).copy())
    np.testing.assert_array_equal(*made)


def test_bad_input_is_one_line(lfcal: Lfcal) -> None:
    planned = "bench --virtual-depths 4 --plan-only"
    for words, said in (
        (f"{planned} --peak 0", "--peak: expected a number > 0"),
        ("bench -o H.h5", "virtual-depths"),
        ("bench --virtual-depths 4", "output"),
        ("nikon --virtual-depths 4 --plan-only", "camera"),
        (f"{planned} --effect bandwidth", "NAME=on"),
        (f"{planned} --effect magic=on", "magic"),
        (f"{planned} --tolerance 0", "--tolerance: expected a number > 0"),
        (f"{planned} --cutout 40.5", "cutout"),
        ("missing.json --virtual-depths 4 --plan-only", "missing.json"),
    ):
        lfcal("simulate", *words.split()).refused(said)


def test_magnitudes_of_effects(lfcal: Lfcal, tmp_path: Path) -> None:
    planning = ("simulate", "bench", "--virtual-depths", "4", "--plan-only", "--json")
    file = tmp_path / "effects.json"
    file.write_text('[{"name": "spherical", "waves": 0.4}]')
    done = lfcal(*planning, "--effect", "coma=0.3@40deg", "--effect", file, "--effect", "bandwidth=off").ok()
    rows = {row["name"]: row for row in done.json["effects"]}
    assert rows["coma"]["on"] and rows["coma"]["size"] == pytest.approx(0.3)
    assert rows["spherical"]["on"] and rows["spherical"]["size"] == pytest.approx(0.4)
    assert rows["bandwidth"]["setting"] == "off"
    lfcal(*planning, "--effect", "coma=wide").refused("expected a number")


def test_effects_that_cannot_show_are_named(lfcal: Lfcal, tmp_path: Path) -> None:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0], cutout=11)
    (tmp_path / "plan.json").write_text(replace(plan, period=(1, 2)).to_json())
    asked = ("--effect", "zernike=on", "--effect", "read_noise=on", "--level", "geometric")
    done = lfcal("simulate", tmp_path / "plan.json", *asked, "-o", tmp_path / "H.h5").ok()
    assert "note: zernike: switched on, but has no typical size" in done.err
    assert "note: read_noise: switched on, but acts on the sensor frame" in done.err


def test_h_in_passes(lfcal: Lfcal, plan_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "H.h5"
    run = lfcal("simulate", plan_file, "-o", out, "--tolerance", "0.1", "--progressive").ok()
    passes = [line for line in run.err.splitlines() if "complete with errors of at most" in line]
    shares = [float(line.split("complete with errors of at most")[1].split("%")[0]) for line in passes]
    assert len(shares) == 3 and shares == sorted(shares, reverse=True) and shares[-1] <= 10
    with open_psf(out) as matrix:
        assert 100 * float(np.max(matrix.facts.known()["error"])) == pytest.approx(shares[-1], rel=0.1)
    refused = lfcal("simulate", plan_file, "--frames", tmp_path / "frames", "--progressive")
    refused.refused("--progressive: expected H in passes, got frames")


# -- ``lfcal simulate`` of a plan of regions: each at its own place of the field --
EFFECT = "field_curvature=2mm"


@pytest.mark.long
def test_regions_differ_by_the_effects_of_the_field(lfcal: Lfcal, tmp_path: Path) -> None:
    plan = RegionPlan.spread(ScanPlan.for_camera(small(200), virtual_depths=(4.0,), cutout=31), (1, 3))
    (tmp_path / "plan.json").write_text(plan.to_json())
    out = tmp_path / "H.h5"
    words = ("simulate", tmp_path / "plan.json", "-o", out, "--effect", EFFECT, "--tolerance", "0.1", "--json")
    assert list(lfcal(*words).ok().json["regions"]) == list(plan.names) == list(regions_of(out))
    loss = region_loss(out)
    assert loss.losses[0] == 0 and loss.losses[1:].min() > 0.01
    own = plan.plan(2)
    settings, given = parse_effects([EFFECT])
    alone = simulate_psf(own, plan_effects(own, 0.1, settings, effects=given), tolerance=0.1)
    with open_psf(out, region=plan.names[2]) as stored:
        assert stored.anchor == own.anchor
        np.testing.assert_allclose(stored.plane(0), alone.plane(0), atol=1e-5 * alone.plane(0).max())


def test_options_of_one_region_are_refused(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scan = ScanPlan.for_camera(small(200), virtual_depths=(4.0,), cutout=31)
    (tmp_path / "plan.json").write_text(RegionPlan.spread(scan, (1, 3)).to_json())
    for words in ("--frames frames", "-o H.h5 --progressive", "-o H.h5 --cutout 21"):
        lfcal("simulate", "plan.json", *words.split()).refused("leave")
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"]
