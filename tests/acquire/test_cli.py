"""``lfcal acquire`` and ``lfcal doctor`` as a user runs them."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.acquire.finish import iter_assemble_session
from lfcal.acquire.recording.recording_file import RecordingFile
from lfcal.acquire.recording.source import RecordingSource, read_checks
from lfcal.acquire.redo import RedoList, read_suspects
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, preset
from lfcal.campaign import Goal, iter_adaptive
from lfcal.devices.registry import open_rig
from lfcal.devices.simulated.backend import simulated_rig
from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
from lfcal.judge import Unlike, inspect, iter_evidence
from lfcal.psf import AssemblySettings, PSFMatrix, open_psf
from lfcal.simulate import simulate_psf
from tests.acquire.rigs import frames_of, small_plan
from tests.cli.conftest import Run

Lfcal = Callable[..., Run]
PLAN = small_plan((4, 5), 2)
QUICK = ("--option", "optics=pattern")
"""Any frames will do: the cutout of this plan is too small for its camera."""
ALONE = ("--darks", 0, "--reference-every", 0)


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    path = tmp_path / "plan.json"
    path.write_text(PLAN.to_json())
    return path


def test_a_plan_is_recorded_and_assembled_with_darks_references_and_no_pedestal(
    tmp_path: Path, plan_file: Path, lfcal: Lfcal
) -> None:
    out, matrix = tmp_path / "session", tmp_path / "H.h5"
    result: Any = lfcal("acquire", plan_file, "--out", out, "--assemble", matrix, *QUICK, "--json").json
    assert (result["outcome"]["how"], result["outcome"]["acknowledged"]) == ("complete", 40)
    assert result["findings"] == [] and result["verdict"] == "This recording is without an alarm."
    assert result["bytes_gained"] > 0 and (out / "darks.h5").exists() and len(read_checks(out)) == 2
    with open_psf(matrix, check=True) as psf, open_frames(out) as recording, RecordingSource(out) as raw:
        assert psf.shape == (2, 4, 5, 21, 21)
        source = corrected_view(recording, CorrectionRecipe(), recording.metadata.plan)
        for k in range(40):
            step = np.ptp(psf.plane(source.info(k).position.z)) / 65535
            np.testing.assert_allclose(psf[source.info(k).position], source.read(k), atol=0.51 * step)
        assert psf.facts.noise is not None and psf.saturated is not None and not psf.saturated.any()
        corners = np.array([0, 0, -1, -1]), np.array([0, -1, 0, -1])
        recorded = np.array([raw.read(k)[corners] for k in range(40)], float)
        assembled = np.array([psf[raw.info(k).position][corners] for k in range(40)])
    assert recorded.mean() == pytest.approx(64, abs=2)  # the black level of the sensor
    assert assembled.mean() == pytest.approx(0, abs=1)


def test_a_rig_whose_light_cannot_be_switched_is_asked_about_its_darks(
    tmp_path: Path, plan_file: Path, lfcal: Lfcal
) -> None:
    out = tmp_path / "s"
    words = ("acquire", plan_file, "--out", out, "--backend", "folder", "--option", "path=.", "--no-check-stage")
    for more in ((), ("--dry-run",)):
        done = lfcal(*words, *more)
        assert done.code == 2 and done.err.count("\n") == 1
        assert "cover the lens when asked (--cover), or record without them (--darks 0)" in done.err
    for answer in (("--darks", 0), ("--cover",)):
        assert lfcal(*words, "--dry-run", *answer).code == 0
    assert not out.exists()


def test_the_lens_is_covered_by_hand_once_for_all_darks(
    tmp_path: Path, lfcal: Lfcal, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    plan = small_plan((2, 2), 2, exposure_s=(0.01, 0.02))
    (tmp_path / "plan.json").write_text(plan.to_json())
    rig, requests = simulated_rig(plan), list[str]()
    lamp: Any = rig.light

    class Hands(io.StringIO):
        """Do what was asked last, then press Enter."""

        def readline(self, *_: Any) -> str:
            asked = "uncover" if "uncover" in capfd.readouterr().err else "cover"
            lamp.switch(asked == "uncover")
            requests.append(asked)
            return "\n"

    monkeypatch.setattr("sys.stdin", Hands())
    monkeypatch.setattr("lfcal.devices.open_rig", lambda *_, **__: replace(rig, light=None))
    words = ("acquire", tmp_path / "plan.json", "--no-check-stage", "--cover", "--out")
    assert lfcal(*words, tmp_path / "s").code == 0 and requests == ["cover", "uncover"]
    with RecordingSource(tmp_path / "s") as source:
        assert len(source) == 8 and sorted(source.metadata.darks) == [0.01, 0.02]
    monkeypatch.setattr("sys.stdin", io.StringIO())
    done = lfcal(*words, tmp_path / "t")
    assert done.code == 2 and "by the device: lens cover: no answer" in done.err


@pytest.fixture
def bench_plan(tmp_path: Path) -> ScanPlan:
    """Return the plan of six positions whose cutout holds the patterns of its camera; it is in ``bench.json``."""
    plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0]), period=(2, 3))
    (tmp_path / "bench.json").write_text(plan.to_json())
    return plan


@pytest.mark.long
def test_by_default_the_simulator_records_the_camera_of_the_plan(
    tmp_path: Path, bench_plan: ScanPlan, lfcal: Lfcal
) -> None:
    """The quick pattern was the default: H was a blob, of which ``fit`` said that the camera was described wrongly."""
    out, matrix = tmp_path / "s", tmp_path / "H.h5"
    done = lfcal("acquire", tmp_path / "bench.json", "--out", out, "--assemble", matrix)
    assert done.code == 0 and "frames: simulated, the plan's camera (optics=auto)" in done.out
    assert SessionFile.read(out).devices.optics == "auto"
    expected = simulate_psf(bench_plan)
    with open_psf(matrix) as recorded:
        assert recorded.provenance["optics"] == "auto"
        for at in np.ndindex(recorded.shape[:3]):
            assert np.corrcoef(recorded[at].ravel(), expected[at].ravel())[0, 1] > 0.98


def test_frames_of_the_quick_pattern_are_named_and_not_blamed_on_the_camera(
    tmp_path: Path, bench_plan: ScanPlan, lfcal: Lfcal
) -> None:
    out, matrix = tmp_path / "s", tmp_path / "H.h5"
    done = lfcal("acquire", tmp_path / "bench.json", "--out", out, "--assemble", matrix, *QUICK)
    assert done.code == 0 and "quick pattern without lenslets" in done.out
    for source in (out, matrix):
        said = lfcal("fit", source, "-o", tmp_path / "fit").err
        assert "got recorded with the simulator's quick pattern, which has no lenslets" in said
        assert "without --option optics=pattern" in said and "description" not in said
    assert not (tmp_path / "fit").exists()
    with open_psf(matrix) as recorded:
        found = drain(iter_evidence(recorded))
    assert isinstance(found, Unlike) and "quick pattern, which has no lenslets" in found.reason
    rig = open_rig(bench_plan, "sim", {"optics": "pattern"})
    with pytest.raises(InputError, match="quick pattern"):
        drain(iter_adaptive(tmp_path / "until", bench_plan, rig, Goal(0.01)))
    assert not (tmp_path / "until").exists()


def test_a_session_is_resumed_with_the_optics_it_began_with(tmp_path: Path, plan_file: Path, lfcal: Lfcal) -> None:
    begin = ("acquire", plan_file, "--out", tmp_path / "s", "--darks", 0)
    assert lfcal(*begin, "--no-check-stage", *QUICK, "--option", "faults=times out@20*9").code == 2
    refused = lfcal(*begin, "--no-check-stage", "--resume")
    assert refused.code == 2 and "devices.optics: expected pattern as recorded, got auto" in refused.err
    path = tmp_path / "s" / "session.json"
    noted = json.loads(path.read_text())
    assert noted["devices"].pop("optics") == "pattern"
    path.write_text(json.dumps(noted))  # as older versions wrote it
    assert lfcal(*begin, *QUICK, "--resume", "--check-stage").code == 0
    checks = [one["stage"] for one in json.loads(path.read_text())["runs"]]
    assert checks[0] == "stage not checked: check_stage is off" and checks[-1].startswith("checked: scale right 1.0")


def test_dry_run_moves_and_writes_nothing(tmp_path: Path, plan_file: Path, lfcal: Lfcal) -> None:
    words = ("acquire", plan_file, "--out", tmp_path / "session")
    found: Any = lfcal(*words, "--dry-run", "--controls", 1, "--json").json
    assert (found["positions"], found["other_frames"]) == (40, 8 + 1 + 2)  # controls, a dark frame, references
    assert found["recording_bytes"] == 50 * (21 * 21 * 2 + 128) + (24 * 25 * 4 + 128)
    said, rate = lfcal(*words, "--dry-run").out, ("--frame-rate", 10)
    assert "nothing was moved" in said and "without readout (--frame-rate)" in said
    assert "without readout" not in lfcal(*words, "--dry-run", *rate).out
    assert "--frame-rate: expected --dry-run" in lfcal(*words, *rate).err
    assert not (tmp_path / "session").exists()


def test_a_resumed_session_reports_a_lamp_that_changed_in_between(
    tmp_path: Path, plan_file: Path, lfcal: Lfcal, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin = ("acquire", plan_file, "--out", tmp_path / "session", "--no-pack", *QUICK)
    references = ("--darks", 0, "--reference-every", 5, "--no-check-stage")
    assert lfcal(*begin, *references, "--option", "faults=times out@20*9").code == 2
    monkeypatch.setattr("lfcal.devices.simulated._optics.LIT_S", 0.02 / 1.14)
    assert "the lamp drifts" in lfcal(*begin, "--resume").out


def test_bad_input_is_one_line_and_leaves_nothing(tmp_path: Path, plan_file: Path, lfcal: Lfcal) -> None:
    limits = ("--option", "limits=-10:10,-10:10,-10:10")
    for arguments, message in (
        (("--backend", "nothing"), "device backend: expected"),
        (("--option", "velocity"), "--option: expected NAME=VALUE"),
        (("--option", "axes=-x,+y,+z"), "the scan runs in the wrong direction"),
        (("--origin", "1,2"), "write them in the form 100,-20,1500"),
        (("--tolerance", "a"), "--tolerance: expected numbers"),
        (("--bracket", "0.5"), "exposure bracket"),
        (("--backend", "gentl"), "choose a backend"),
        (limits, "the limits"),
        ((*limits, "--no-check-stage"), "the limits"),
        (("--margin", "1000", "--no-check-stage"), "smaller margin"),
        (("--redo", "/nowhere.json"), "expected a session folder"),
        (("--resume",), "expected a session folder"),
        (("--dark-every", "-1"), "--dark-every: expected a whole number ≥ 0"),
    ):
        done = lfcal("acquire", plan_file, "--out", tmp_path / "session", *arguments)
        assert done.code == 2 and message in done.err and done.err.count("\n") == 1, (arguments, done.err)
        assert not (tmp_path / "session").exists(), arguments


@pytest.mark.long
def test_suspect_positions_are_named_listed_in_h_and_recorded_again(
    tmp_path: Path, plan_file: Path, lfcal: Lfcal
) -> None:
    out, matrix = tmp_path / "session", tmp_path / "H.h5"
    begin = ("acquire", plan_file, "--out", out, *ALONE, "--no-check-stage", "--no-pack")
    stopped = lfcal(*begin, "--option", "faults=dark level@30*4")
    assert stopped.code == 2 and stopped.err.count("\n") == 1
    assert "by the content guard: dark level: expected about 6" in stopped.err
    said = lfcal(*begin, "--resume", "--on-suspect", "flag", "--option", "faults=dark level@5*4").out
    assert ": dark level\n" in said and f"record them again with --redo {out / 'suspects.json'}" in said
    suspects = read_suspects(out)
    assert RedoList.read(out / "suspects.json") == suspects and 0 < len(suspects.positions) < 5
    settings = AssemblySettings(keep_pedestal=True)
    made = drain(iter_assemble_session(out, matrix, settings=settings)).matrix
    metric = inspect(made)["suspect"]
    assert (metric.merit, metric.value, metric.detail) == ("bad", len(suspects.positions), "dark level")
    assert [tuple(p) for p in metric.positions.tolist()] == sorted(suspects.positions)
    assert set(suspects.positions) <= {place for place, _ in inspect(made).redo()}
    again: Any = lfcal(*begin, "--redo", out / "suspects.json", "--json").json
    assert "suspects" not in again and not (out / "suspects.json").exists()
    assert inspect(drain(iter_assemble_session(out, settings=settings)).matrix)["suspect"].merit == "unknown"


OTHER_STATEMENTS = ("text", [1], [[0, 0]], {"a": 1}, None)


@pytest.mark.parametrize(
    "said",
    [
        *([["z", 0, 0, "x"]], [[9, 0, 0, "x"]]),
        *(pytest.param(said, marks=pytest.mark.long) for said in OTHER_STATEMENTS),
    ],
)
def test_what_a_file_states_of_suspects_is_checked(said: Any) -> None:
    values = np.random.default_rng(1).random((1, 3, 3, 9, 9), np.float32)
    assert inspect(PSFMatrix(values, provenance={"suspect": said}))["suspect"].merit == "unknown"


def acknowledged(folder: Path) -> int:
    """Positions that are safe in a session that may not have begun."""
    if not (folder / "session.json").exists():
        return 0
    with RecordingFile(folder / "recording.h5") as recording:
        return int(recording.taken.sum())


@pytest.mark.long
@pytest.mark.skipif(os.name != "posix", reason="interrupted by a signal")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_ctrl_c_stops_in_order_and_the_session_resumes(tmp_path: Path, lfcal: Lfcal, name: str) -> None:
    plan, out = small_plan((10, 20), 1), tmp_path / "session"
    (tmp_path / "plan.json").write_text(plan.to_json())
    code = "from lfcal.cli import main; main()"
    options = ["--out", str(out), "--option", "time=real", "--no-check-stage"]
    command = [sys.executable, "-c", code, "acquire", str(tmp_path / "plan.json"), *options]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    end = time.monotonic() + 30
    while acknowledged(out) < 3 and time.monotonic() < end:
        time.sleep(0.02)
    child.send_signal(getattr(signal, name))
    said, complaint = child.communicate(timeout=30)
    assert child.returncode == 128 + getattr(signal, name)
    assert "stopping after this position" in complaint and "resume with --resume" in said
    assert 0 < len(frames_of(out)) < plan.n_positions
    assert lfcal("acquire", tmp_path / "plan.json", "--out", out, "--resume", "--no-pack").code == 0
    assert len(frames_of(out)) == plan.n_positions


def test_doctor_lists_machine_libraries_and_devices(lfcal: Lfcal) -> None:
    found: Any = lfcal("doctor", "--json").json
    assert {"Python", "processors", "memory", "disk free here", "numba cache", "lfcal"} <= set(found["machine"])
    assert found["libraries"]["numpy"] == np.__version__
    devices = {d["name"]: d for d in found["devices"]}
    assert {"sim", "micromanager", "aravis", "gentl", "folder"} <= set(devices)
    assert all(bool(d["version"]) != bool(d["reason"]) for d in devices.values())
    text = lfcal("doctor").out
    assert "sim" in text and "numba cache" in text
