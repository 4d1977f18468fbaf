"""``lfcal simulate`` as a user runs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.camera import ScanPlan, preset
from lfcal.frames import open_frames
from lfcal.psf import open_psf
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(90, 100)))
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=41), period=(2, 3))
    path = tmp_path / "plan.json"
    path.write_text(plan.to_json())
    return path


def test_plan_only_shows_every_effect(lfcal: Lfcal) -> None:
    run = lfcal("simulate", "r29", "--virtual-depths", "4", "--plan-only", "--json")
    assert run.code == 0, run.err
    rows = {row["name"]: row for row in run.json["effects"]}  # type: ignore[index, call-overload]
    assert rows["lens_types"]["on"] and not rows["bandwidth"]["on"] and len(rows) >= 28
    table = lfcal("simulate", "bench", "--virtual-depths", "4", "--plan-only", "--effect", "crosstalk=on")
    assert "switched on" in table.out and "whole H" in table.out
    assert "time with it" in table.out and "without it" in table.out
    diffraction = rows["lenslet_diffraction"]
    assert diffraction["seconds_with"] == pytest.approx(run.json["seconds"])  # type: ignore[index, call-overload]
    assert 0 < diffraction["seconds_without"] < diffraction["seconds_with"]


@pytest.mark.parametrize(
    ("words", "title"),
    [
        (("bench", "--virtual-depths", "4"), "engine grid"),  # the title was "level wave"
        (("bench", "--virtual-depths", "4", "--level", "geometric"), "engine geometric"),
        (("lfm_20x05", "--depths", "0"), "engine microscope"),
    ],
)
def test_plan_only_names_the_engine_that_runs(lfcal: Lfcal, tmp_path: Path, words: tuple[str, ...], title: str) -> None:
    words = (*words, "--cutout", "31")
    assert f"%, {title}\n" in "".join(
        f"{line.rstrip()}\n" for line in lfcal("simulate", *words, "--plan-only").out.splitlines()
    )
    engines = lfcal("simulate", *words, "--plan-only", "--json").json["engines"]  # type: ignore[index, call-overload]
    assert lfcal("simulate", *words, "-o", tmp_path / "H.h5").code == 0
    with open_psf(tmp_path / "H.h5") as H:
        assert [plane["engine"] for plane in H.provenance["simulated"]["planes"]] == engines


def test_h_from_a_plan(lfcal: Lfcal, plan_file: Path, tmp_path: Path) -> None:
    run = lfcal("simulate", plan_file, "-o", tmp_path / "H.h5", "--level", "geometric", "--json")
    assert run.code == 0, run.err
    with open_psf(tmp_path / "H.h5") as H:
        assert H.shape == (1, 2, 3, 41, 41) and H[0, 0, 0].sum() > 0.5
        assert H.provenance["plan"]["period"] == [2, 3]


@pytest.mark.parametrize("run", [(), ("--progressive",)])
def test_light_beside_the_cutout_is_reported(
    lfcal: Lfcal, plan_file: Path, tmp_path: Path, run: tuple[str, ...]
) -> None:
    """Compared with a cutout that holds all of it; each H was within 3 % by what was printed, whatever it lacked."""
    plan = ScanPlan.from_json(plan_file.read_text())
    held, shares = {}, {}
    for cutout in (21, 55):
        plan_file.write_text(replace(plan, cutout=(cutout, cutout)).to_json())
        out = tmp_path / f"{cutout}.h5"
        done = lfcal("simulate", plan_file, "-o", out, "--tolerance", 0.5, "--json", *run)
        assert done.code == 0, done.err
        assert ("contains less than 90 % of the light in 1 of 1 planes" in done.err) == (cutout == 21)
        shares[cutout] = done.json["light_in_cutout"][0]  # type: ignore[index, call-overload]
        with open_psf(out) as H:
            held[cutout] = float(H.plane(0).sum())
    assert shares[55] > 0.95 and shares[21] < 0.6
    assert shares[21] == pytest.approx(shares[55] * held[21] / held[55], rel=0.05)
    again = lfcal("simulate", plan_file, "-o", out, "--tolerance", 0.5, "--force", *run)
    assert f"light in the cutout: {100 * shares[55]:.3g} %" in again.err


def test_a_period_that_does_not_fit_the_lattice_is_reported(lfcal: Lfcal, tmp_path: Path) -> None:
    """As `lfcal plan` reports it; a plan that resamples, or has no whole period, says nothing."""
    done = lfcal("simulate", "lfm_60x12", "--depths", "0", "--plan-only")
    assert (
        "the period of H, 15 x 15 px, does not match that of the lattice, 15.385 x 15.385 px: they drift "
        "apart by 52.5 px" in done.err
    )
    planned = lfcal("plan", "lfm_60x12", "--depths", "0", "--resample", "-o", tmp_path / "plan.json")
    assert planned.code == 0, planned.err
    assert "does not fit" not in lfcal("simulate", tmp_path / "plan.json", "--plan-only").err


def test_frames_of_a_session(lfcal: Lfcal, plan_file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    run = lfcal("simulate", plan_file, "--frames", folder, "--level", "geometric", "--seed", 3)
    assert run.code == 0, run.err
    assert {p.name for p in folder.iterdir()} == {"frames", "dark", "white", "camera.json", "plan.json", "truth.json"}
    with open_frames(folder / "frames", plan_shape=(1, 2, 3)) as source:
        assert len(source) == 6 and source.shape == (90, 100)
    again = lfcal("simulate", plan_file, "--frames", folder)
    assert again.code == 2 and "empty folder" in again.err
    assembled = lfcal(
        "assemble",
        folder / "frames",
        "--dark",
        folder / "dark",
        "--plan",
        folder / "plan.json",
        "-o",
        tmp_path / "H.h5",
        "--strict",
    )
    assert assembled.code == 0, assembled.err


def test_planes_in_micrometres_and_any_number_of_threads(lfcal: Lfcal, tmp_path: Path) -> None:
    plan = ("--depths", "-20mm", "--cutout", 21, "--level", "geometric")
    made = []
    for workers in (1, 2):
        run = lfcal("simulate", "bench", *plan, "--out", tmp_path / f"{workers}.h5", "--workers", workers)
        assert run.code == 0, run.err
        with open_psf(tmp_path / f"{workers}.h5") as H:
            assert list(H.depths) == [-20000]
            made.append(H.plane(0).copy())
    np.testing.assert_array_equal(*made)


def test_the_peak_of_the_frames(lfcal: Lfcal, plan_file: Path, tmp_path: Path) -> None:
    """Twice the share of the full well is twice the light above the black level."""
    light = []
    for peak in (0.3, 0.6):
        folder = tmp_path / f"peak{peak}"
        run = lfcal("simulate", plan_file, "--frames", folder, "--level", "geometric", "--peak", peak)
        assert run.code == 0, run.err
        with open_frames(folder / "frames", plan_shape=(1, 2, 3)) as source:
            level = np.median(source.read(0))
            light.append(sum(source.read(k).astype(float).sum() - level * 90 * 100 for k in range(6)))
    assert light[1] / light[0] == pytest.approx(2, rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("bench", "--virtual-depths", "4", "--plan-only", "--peak", "0"), "--peak: expected a number > 0"),
        (("bench", "-o", "H.h5"), "virtual-depths"),
        (("bench", "--virtual-depths", "4"), "output"),
        (("nikon", "--virtual-depths", "4", "--plan-only"), "camera"),
        (("bench", "--virtual-depths", "4", "--plan-only", "--effect", "bandwidth"), "NAME=on"),
        (("bench", "--virtual-depths", "4", "--plan-only", "--effect", "magic=on"), "magic"),
        (("bench", "--virtual-depths", "4", "--plan-only", "--tolerance", "0"), "--tolerance: expected a number > 0"),
        (("bench", "--virtual-depths", "4", "--cutout", "40.5", "--plan-only"), "cutout"),
        (("missing.json", "--virtual-depths", "4", "--plan-only"), "missing.json"),
    ],
)
def test_bad_input_is_one_line_and_code_2(lfcal: Lfcal, arguments: tuple[str, ...], word: str) -> None:
    run = lfcal("simulate", *arguments)
    assert run.code == 2 and word in run.err and run.err.count("\n") == 1


def test_magnitudes_of_effects(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    planning = ("simulate", "bench", "--virtual-depths", "4", "--plan-only", "--json")
    file = tmp_path / "effects.json"
    file.write_text('[{"name": "spherical", "waves": 0.4}]')
    done = lfcal(*planning, "--effect", "coma=0.3@40deg", "--effect", file, "--effect", "bandwidth=off")
    assert done.code == 0, done.err
    rows = {row["name"]: row for row in done.json["effects"]}
    assert rows["coma"]["on"] and rows["coma"]["size"] == pytest.approx(0.3)
    assert rows["spherical"]["on"] and rows["spherical"]["size"] == pytest.approx(0.4)
    assert rows["bandwidth"]["setting"] == "off"
    wrong = lfcal(*planning, "--effect", "coma=wide")
    assert wrong.code == 2 and "expected a number" in wrong.err and len(wrong.err.splitlines()) == 1


def test_what_is_asked_for_and_cannot_show_is_said(lfcal: Callable[..., Run], tmp_path: Path) -> None:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0], cutout=11)
    (tmp_path / "plan.json").write_text(replace(plan, period=(1, 2)).to_json())
    asked = ("--effect", "zernike=on", "--effect", "read_noise=on", "--level", "geometric")
    done = lfcal("simulate", tmp_path / "plan.json", *asked, "-o", tmp_path / "H.h5")
    assert done.code == 0, done.err
    assert "note: zernike: switched on, but has no typical size" in done.err
    assert "note: read_noise: switched on, but acts on the sensor frame" in done.err


def test_h_in_passes(lfcal: Lfcal, plan_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "H.h5"
    run = lfcal("simulate", plan_file, "-o", out, "--tolerance", "0.1", "--progressive")
    assert run.code == 0, run.err
    passes = [line for line in run.err.splitlines() if "complete with errors of at most" in line]
    shares = [float(line.split("complete with errors of at most")[1].split("%")[0]) for line in passes]
    assert len(shares) == 3 and shares == sorted(shares, reverse=True) and shares[-1] <= 10
    with open_psf(out) as matrix:
        assert 100 * float(np.max(matrix.facts.known()["error"])) == pytest.approx(shares[-1], rel=0.1)
    refused = lfcal("simulate", plan_file, "--frames", tmp_path / "frames", "--progressive")
    assert refused.code == 2 and "--progressive: expected H in passes, got frames" in refused.err
