"""``lfcal plan target``: whether showing several frames of a target at once pays, and a display that does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.frames import open_frames
from lfcal.targets import Display, Target, TargetPlan, Wishes, iter_plan_display
from lfcal.targets.subsets import coding_verdict, planned_for_display
from tests.cli.conftest import Run
from tests.targets.common import scan_of, small

Lfcal = Callable[..., Run]
SCAN = scan_of(small(200))
DISPLAY = Display((2000, 2000), 5.0)
PLAN = ("plan", "target", "scan.json", "--tolerance", "0.3", "--crosstalk", "0.02")
SOURCE = ("display:2000x2000@5um",)


@pytest.fixture(scope="module")
def plan() -> TargetPlan:
    return drain(iter_plan_display(SCAN, DISPLAY, Wishes(0.3, 0.02, 7)))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "scan.json").write_text(SCAN.to_json())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.long
def test_coding_pays_for_weak_light_only(plan: TargetPlan) -> None:
    bright, dim = coding_verdict(plan), coding_verdict(plan, signal_e=100.0)
    assert bright is not None and dim is not None
    full = SCAN.camera.sensor.full_well_e
    assert not bright.pays and bright.gain.signal_e == pytest.approx(0.8 * full)
    assert dim.pays and 100 < dim.break_even_e < 0.8 * full and dim.gain.points == 7
    words = bright.frames_words
    assert words.count("\n") == 0 and "does not pay at 16000 electrons" in words
    assert "it pays up to " + f"{bright.break_even_e:.3g}"[:1] in words and "photon noise of bright cores" in words
    assert "pays at 100 electrons" in dim.frames_words and "the sensor's noise dominates" in dim.frames_words
    facts = dim.to_dict()
    assert facts["pays"] and facts["together"] == 7 and facts["gain_db"] > 1


def test_by_what_rules_at_any_light() -> None:
    quiet = replace(SCAN.camera.sensor, read_noise_e=0.0, dark_current_e_s=0.0, bit_depth=16)
    scan = replace(SCAN, camera=replace(SCAN.camera, sensor=quiet))
    still = replace(drain(iter_plan_display(SCAN, DISPLAY, Wishes(0.3, 0.02, 3))), scan=scan)
    found = coding_verdict(still, signal_e=1000.0)
    assert found is not None and not found.pays and found.break_even_e < 10


def test_a_display_shows_several_at_once_only_where_that_pays(plan: TargetPlan) -> None:
    for signal, many in ((None, False), (100.0, True)):
        found = planned_for_display(plan, DISPLAY, coding_verdict(plan, signal_e=signal))
        assert (found.lit is not None) == many and len(found.frames) == 7
    # sums that saturate are not shown, whatever the noise says
    sensor = replace(SCAN.camera.sensor, full_well_e=4000.0, read_noise_e=200.0)
    noisy = replace(plan, scan=replace(SCAN, camera=replace(SCAN.camera, sensor=sensor)))
    verdict = coding_verdict(noisy, signal_e=3900.0)
    assert verdict is not None and verdict.gain.time.exposure < 1
    assert planned_for_display(noisy, DISPLAY, verdict).lit is None
    assert planned_for_display(plan, DISPLAY, None) is plan


def test_nothing_is_said_of_a_single_point_or_few_frames(plan: TargetPlan) -> None:
    assert coding_verdict(replace(plan, offsets_px=(plan.offsets_px[0][:2],))) is None
    assert coding_verdict(replace(plan, target=Target())) is None
    with pytest.raises(InputError, match="--signal"):
        coding_verdict(plan, signal_e=1e9)


def test_the_command_says_it_in_a_line(lfcal: Lfcal, place: Path) -> None:
    array = ("array:4x4@800um", "--most-frames", "7")
    run = lfcal(*PLAN, *array)
    (line,) = [one for one in run.out.splitlines() if "coded" in one]
    assert run.code == 0 and line.startswith("showing 7 frames together, coded: does not pay"), run.err
    said = lfcal(*PLAN, *array, "--signal", 50, "--json").json
    assert isinstance(said, dict) and said["coding"]["pays"] and said["coding"]["up_to_e"] > 50


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("display:2x3",), "display: expected display:ROWSxCOLUMNS@PITCH"),
        (("display:20x20@5um",), "room for two points"),
        (("array:4x4@800um", "--patterns", "p"), "--patterns: expected a display, got a target that a stage moves"),
        ((*SOURCE, "--most-frames", "7", "--signal", "0"), "--signal: expected a number > 0"),
        (
            ("point", "--most-frames", "2", "--signal", "5"),
            "target for coded frames: expected at least two points, and enough frames",
        ),
        ((*SOURCE, "--pose", "rotation=1"), "--pose: expected a target that a stage moves, got a display"),
    ],
)
def test_bad_input_ends_in_a_line(lfcal: Lfcal, place: Path, words: tuple[str, ...], said: str) -> None:
    run = lfcal(*PLAN, *words, "-o", "out.json")
    assert run.code == 2 and run.err.count("\n") == 1 and said in run.err, run.err
    assert not (place / "out.json").exists()


@pytest.mark.long
def test_a_display_from_its_plan_to_h(lfcal: Lfcal, place: Path) -> None:
    words = (*SOURCE, "--most-frames", 7, "--signal", 100, "--patterns", "shown", "-o", "plan.json")
    run = lfcal(*PLAN, *words)
    assert run.code == 0 and "frames show 4 subsets of points together" in run.out, run.err
    # pictures are replaced where that is asked for, and none of an earlier plan stays
    (place / "shown" / "frame_0099.png").write_bytes(b"of an earlier plan")
    again = lfcal(*PLAN, *words[:-1], "other.json")
    assert again.code == 2 and "add --force" in again.err and not (place / "other.json").exists(), again.err
    assert lfcal(*PLAN, *words, "--force").code == 0
    plan = TargetPlan.from_json((place / "plan.json").read_text())
    shown = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted((place / "shown").iterdir())]
    assert plan.lit is not None and len(shown) == 7 and shown[0].shape == (2000, 2000)
    assert {int((one > 0).sum()) for one in shown} == {4 * len(plan.target.holes)}
    run = lfcal("acquire", "plan.json", "-o", "s", "--darks", 2, "--reference-every", 0, "--assemble", "A.h5")
    assert run.code == 0 and "A.h5: H" in run.out, run.err
    # the same frames in a folder, as a display's own program records them
    folder = place / "folder"
    folder.mkdir()
    with open_frames("s") as source:
        for k in range(len(source)):
            cv2.imwrite(str(folder / f"f{k}.png"), source.read(k))
    again = lfcal("assemble", "folder", "--plan", "plan.json", "-o", "C.h5", "--json").json
    assert isinstance(again, dict) and again["target"]["points"] > 100


@pytest.mark.long
def test_several_subsets_at_once_are_as_much_more_light(lfcal: Lfcal, place: Path) -> None:
    words = (*SOURCE, "--most-frames", 7, "--signal", 100, "--patterns", "shown", "-o", "plan.json")
    assert lfcal(*PLAN, *words).code == 0
    plan = TargetPlan.from_json((place / "plan.json").read_text())
    run = lfcal("acquire", "plan.json", "-o", "s", "--darks", 2, "--reference-every", 0, "--assemble", "A.h5")
    assert run.code == 0, run.err
    alone = replace(plan, lit=None)
    (place / "alone.json").write_text(alone.to_json())
    run = lfcal("acquire", "alone.json", "-o", "t", "--darks", 2, "--reference-every", 0, "--assemble", "B.h5")
    assert run.code == 0, run.err
    light = [np.asarray(open_frames(one).read(3), float) - 64 for one in ("s", "t")]
    assert light[0].sum() == pytest.approx(4 * light[1].sum(), rel=0.1)
    assert lfcal("compare", "A.h5", "B.h5", "--json").code == 0


def test_frames_of_a_display_are_not_asked_of_a_stage(lfcal: Lfcal, place: Path, plan: TargetPlan) -> None:
    found = planned_for_display(plan, DISPLAY, coding_verdict(plan, signal_e=100.0))
    (place / "plan.json").write_text(found.to_json())
    run = lfcal("acquire", "plan.json", "-o", "s", "--backend", "micromanager")
    assert run.code == 2 and "lfcal plan target --patterns" in run.err, run.err
    assert not (place / "s").exists()
