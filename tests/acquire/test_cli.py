"""``lfcal acquire`` and ``lfcal doctor`` as a user runs them."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
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
from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan, preset
from lfcal.campaign import Goal, iter_adaptive
from lfcal.cli import main
from lfcal.devices.registry import open_rig
from lfcal.devices.simulated.backend import simulated_rig
from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
from lfcal.judge import Unlike, inspect, iter_evidence
from lfcal.psf import AssemblySettings, PSFMatrix, open_psf
from lfcal.simulate import simulate_psf
from tests.acquire.rigs import assert_same_frames, frames_of, small_plan

PLAN = small_plan((4, 5), 2)
QUICK = ("--option", "optics=pattern")
"""Any frames will do: the cutout of this plan is too small for its camera."""


@pytest.fixture
def plan_file(tmp_path: Path) -> Path:
    path = tmp_path / "plan.json"
    path.write_text(PLAN.to_json())
    return path


def run(*arguments: object, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["lfcal", *map(str, arguments)])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_from_plan_to_h_without_copying_by_hand(
    tmp_path: Path, plan_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, matrix = tmp_path / "session", tmp_path / "H.h5"
    options = ("--darks", 2, "--reference-every", 10, "--json")
    assert run("acquire", plan_file, "--out", out, "--assemble", matrix, *options, monkeypatch=monkeypatch) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["outcome"]["how"] == "complete"
    assert result["outcome"]["acknowledged"] == 40
    assert result["findings"] == [] and result["verdict"] == "This recording is without an alarm."
    assert result["bytes_gained"] > 0
    with open_psf(matrix, check=True) as psf, open_frames(out) as recording:
        assert psf.shape == (2, 4, 5, 21, 21)
        source = corrected_view(recording, CorrectionRecipe(), recording.metadata.plan)
        for k in range(40):
            step = np.ptp(psf.plane(source.info(k).position.z)) / 65535
            np.testing.assert_allclose(psf[source.info(k).position], source.read(k), atol=0.51 * step)
        assert psf.facts.noise is not None and psf.saturated is not None and not psf.saturated.any()


def test_by_default_a_session_brings_its_darks_and_references_and_h_has_no_pedestal(
    tmp_path: Path, plan_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, matrix = tmp_path / "session", tmp_path / "H.h5"
    assert run("acquire", plan_file, "--out", out, "--assemble", matrix, *QUICK, monkeypatch=monkeypatch) == 0
    assert (out / "darks.h5").exists()
    assert len(read_checks(out)) == 2
    with open_psf(matrix) as psf, RecordingSource(out) as raw:
        corners = [(0, 0), (0, -1), (-1, 0), (-1, -1)]
        recorded = np.array([[raw.read(k)[at] for at in corners] for k in range(len(raw))], float)
        assembled = np.array([[psf[raw.info(k).position][at] for at in corners] for k in range(len(raw))])
    assert recorded.mean() == pytest.approx(64, abs=2)  # the black level of the sensor
    assert assembled.mean() == pytest.approx(0, abs=1)


FOLDER = ("--backend", "folder", "--option", "path=.", "--no-check-stage")


def test_a_rig_whose_light_cannot_be_switched_is_asked_about_its_darks(
    tmp_path: Path, plan_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for more in ((), ("--dry-run",)):
        assert run("acquire", plan_file, "--out", tmp_path / "s", *FOLDER, *more, monkeypatch=monkeypatch) == 2
        said = capsys.readouterr().err
        assert "cover the lens when asked (--cover), or record without them (--darks 0)" in said
        assert said.count("\n") == 1
    dry = ("acquire", plan_file, "--out", tmp_path / "s", *FOLDER, "--dry-run")
    assert run(*dry, "--darks", 0, monkeypatch=monkeypatch) == 0
    assert run(*dry, "--cover", monkeypatch=monkeypatch) == 0
    assert not (tmp_path / "s").exists()


def test_the_lens_is_covered_by_hand_once_for_all_darks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = small_plan((2, 2), 2, exposure_s=(0.01, 0.02))
    (tmp_path / "plan.json").write_text(plan.to_json())
    rig = simulated_rig(plan)
    lamp = rig.light
    assert lamp is not None

    class Hands(io.StringIO):
        """Do what was asked last, then press Enter."""

        def readline(self, *_: Any) -> str:
            asked = capsys.readouterr().err
            lamp.switch("uncover" in asked)
            requests.append("uncover" if "uncover" in asked else "cover")
            return "\n"

    requests: list[str] = []
    monkeypatch.setattr(sys, "stdin", Hands())
    monkeypatch.setattr("lfcal.devices.open_rig", lambda *_, **__: replace(rig, light=None))
    arguments = ("acquire", tmp_path / "plan.json", "--out", tmp_path / "s", "--no-check-stage")
    assert run(*arguments, "--cover", monkeypatch=monkeypatch) == 0
    assert requests == ["cover", "uncover"]
    with RecordingSource(tmp_path / "s") as source:
        assert len(source) == 8 and sorted(source.metadata.darks) == [0.01, 0.02]
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    assert run(*arguments[:3], tmp_path / "t", "--no-check-stage", "--cover", monkeypatch=monkeypatch) == 2
    assert "by the device: lens cover: no answer" in capsys.readouterr().err


@pytest.fixture
def bench_plan(tmp_path: Path) -> ScanPlan:
    """Return the plan of six positions whose cutout holds the patterns of its camera; it is in ``bench.json``."""
    plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[4.0]), period=(2, 3))
    (tmp_path / "bench.json").write_text(plan.to_json())
    return plan


def test_optics_of_the_simulator_are_recorded(
    tmp_path: Path, bench_plan: ScanPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ("--out", tmp_path / "s", "--option", "optics=geometric", "--no-check-stage")
    assert run("acquire", tmp_path / "bench.json", *arguments, monkeypatch=monkeypatch) == 0
    assert all(frame.max() > 500 for frame in frames_of(tmp_path / "s").values())
    assert SessionFile.read(tmp_path / "s").devices.optics == "geometric"


def test_by_default_the_simulator_records_the_camera_of_the_plan(
    tmp_path: Path, bench_plan: ScanPlan, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The quick pattern was the default: H was a blob, of which ``fit`` said that the camera was described wrongly."""
    out, matrix = tmp_path / "s", tmp_path / "H.h5"
    arguments = ("acquire", tmp_path / "bench.json", "--out", out, "--assemble", matrix)
    assert run(*arguments, monkeypatch=monkeypatch) == 0
    assert "frames: simulated, the plan's camera (optics=auto)" in capsys.readouterr().out
    assert SessionFile.read(out).devices.optics == "auto"
    expected = simulate_psf(bench_plan)
    with open_psf(matrix) as recorded:
        assert recorded.provenance["optics"] == "auto"
        for at in np.ndindex(recorded.shape[:3]):
            assert np.corrcoef(recorded[at].ravel(), expected[at].ravel())[0, 1] > 0.98


def test_frames_of_the_quick_pattern_are_named_and_not_blamed_on_the_camera(
    tmp_path: Path, bench_plan: ScanPlan, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, matrix = tmp_path / "s", tmp_path / "H.h5"
    arguments = ("acquire", tmp_path / "bench.json", "--out", out, "--assemble", matrix, *QUICK)
    assert run(*arguments, monkeypatch=monkeypatch) == 0
    assert "quick pattern without lenslets" in capsys.readouterr().out
    for source in (out, matrix):
        assert run("fit", source, "-o", tmp_path / "fit", monkeypatch=monkeypatch) == 2
        said = capsys.readouterr().err
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


def test_a_session_is_resumed_with_the_optics_it_began_with(
    tmp_path: Path, plan_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    begin = ("acquire", plan_file, "--out", tmp_path / "s", "--darks", 0, "--no-check-stage")
    faults = ("--option", "faults=times out@20*9")
    assert run(*begin, *QUICK, *faults, monkeypatch=monkeypatch) == 2
    capsys.readouterr()
    assert run(*begin, "--resume", monkeypatch=monkeypatch) == 2
    assert "devices.optics: expected pattern as recorded, got auto" in capsys.readouterr().err
    path = tmp_path / "s" / "session.json"
    noted = json.loads(path.read_text())
    assert noted["devices"].pop("optics") == "pattern"
    path.write_text(json.dumps(noted))  # as older versions wrote it
    assert run(*begin, *QUICK, "--resume", "--check-stage", monkeypatch=monkeypatch) == 0
    checks = [one["stage"] for one in json.loads(path.read_text())["runs"]]
    assert checks[0] == "stage not checked: check_stage is off" and checks[-1].startswith("checked: scale right 1.0")


def test_dry_run_moves_and_writes_nothing(
    tmp_path: Path, plan_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "session"
    assert run("acquire", plan_file, "--out", out, "--dry-run", "--controls", 1, "--json", monkeypatch=monkeypatch) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["positions"], found["other_frames"]) == (40, 8 + 1 + 2)  # controls, a dark frame, references
    assert found["recording_bytes"] == 50 * (21 * 21 * 2 + 128) + (24 * 25 * 4 + 128)
    assert not out.exists()
    assert run("acquire", plan_file, "--out", out, "--dry-run", monkeypatch=monkeypatch) == 0
    said = capsys.readouterr().out
    assert "nothing was moved" in said and "without readout (--frame-rate)" in said
    rate = ("--frame-rate", 10)
    assert run("acquire", plan_file, "--out", out, "--dry-run", *rate, monkeypatch=monkeypatch) == 0
    assert "without readout" not in capsys.readouterr().out
    assert run("acquire", plan_file, "--out", out, *rate, monkeypatch=monkeypatch) == 2
    assert "--frame-rate: expected --dry-run" in capsys.readouterr().err and not out.exists()


def test_fault_resume_redo_and_coarse_order(
    tmp_path: Path, plan_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, calm = tmp_path / "session", tmp_path / "calm"
    start = ("acquire", plan_file, "--out", out, "--no-pack", *QUICK)
    alone = ("--darks", 0, "--reference-every", 0, *QUICK)
    faults = ("--option", "faults=times out@31*9")
    assert run(*start, *alone, "--order", "coarse", *faults, monkeypatch=monkeypatch) == 2
    assert "15 of 40 positions are safe" in capsys.readouterr().err
    assert run(*start, monkeypatch=monkeypatch) == 2
    assert "choose another folder, or resume" in capsys.readouterr().err
    assert run(*start, "--resume", monkeypatch=monkeypatch) == 0
    assert run("acquire", plan_file, "--out", calm, *alone, monkeypatch=monkeypatch) == 0
    assert_same_frames(frames_of(out), frames_of(calm))
    redo = tmp_path / "redo.json"
    RedoList.of([(1, 2, 3)], ["step outlier"]).write(redo)
    assert run(*start, "--redo", redo, "--option", "seed=9", monkeypatch=monkeypatch) == 0
    new, old = frames_of(out), frames_of(calm)
    assert [key for key in old if not np.array_equal(old[key], new[key])] == [(1, 2, 3)]


def test_a_resumed_session_reports_a_lamp_that_changed_in_between(
    tmp_path: Path, plan_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    begin = ("acquire", plan_file, "--out", tmp_path / "session", "--no-pack", *QUICK)
    references = ("--darks", 0, "--reference-every", 5, "--no-check-stage")
    fault = ("--option", "faults=times out@20*9")
    assert run(*begin, *references, *fault, monkeypatch=monkeypatch) == 2
    monkeypatch.setattr("lfcal.devices.simulated._optics.LIT_S", 0.02 / 1.14)
    capsys.readouterr()
    assert run(*begin, "--resume", monkeypatch=monkeypatch) == 0
    assert "the lamp drifts" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--backend", "nothing"], "device backend: expected"),
        (["--option", "velocity"], "--option: expected NAME=VALUE"),
        (["--option", "axes=-x,+y,+z"], "the scan runs in the wrong direction"),
        (["--origin", "1,2"], "write them in the form 100,-20,1500"),
        (["--tolerance", "a"], "--tolerance: expected numbers"),
        (["--bracket", "0.5"], "exposure bracket"),
        (["--backend", "gentl"], "choose a backend"),
        (["--option", "limits=-10:10,-10:10,-10:10"], "the limits"),
        (["--option", "limits=-10:10,-10:10,-10:10", "--no-check-stage"], "the limits"),
        (["--margin", "1000", "--no-check-stage"], "smaller margin"),
        (["--redo", "/nowhere.json"], "expected a session folder"),
        (["--resume"], "expected a session folder"),
        (["--dark-every", "-1"], "--dark-every: expected a whole number ≥ 0"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    tmp_path: Path,
    plan_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    out = tmp_path / "session"
    assert run("acquire", plan_file, "--out", out, *arguments, monkeypatch=monkeypatch) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"format":"lfcal-redo","version":2}',
        '{"format":"lfcal-redo","version":1,"positions":[[0,1]]}',
        '{"format":"lfcal-redo","version":1,"positions":[[0,1,2.5]]}',
        '{"format":"lfcal-redo","version":1,"positions":[],"reasons":["x"]}',
    ],
)
def test_bad_redo_lists_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "redo.json"
    path.write_text(text)
    with pytest.raises(FileFormatError):
        RedoList.read(path)


@pytest.mark.long
def test_suspect_positions_are_named_listed_in_h_and_recorded_again(
    tmp_path: Path, plan_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, matrix = tmp_path / "session", tmp_path / "H.h5"
    plain = ("--darks", 0, "--reference-every", 0, "--no-check-stage", "--no-pack")
    fault = ("--option", "faults=dark level@30*4")
    begin = ("acquire", plan_file, "--out", out, *plain)
    assert run(*begin, *fault, monkeypatch=monkeypatch) == 2
    complaint = capsys.readouterr().err
    assert "by the content guard: dark level: expected about 6" in complaint
    assert complaint.count("\n") == 1
    again = ("--resume", "--on-suspect", "flag", "--option", "faults=dark level@5*4")
    assert run(*begin, *again, monkeypatch=monkeypatch) == 0
    said = capsys.readouterr().out
    assert ": dark level\n" in said
    assert f"record them again with --redo {out / 'suspects.json'}" in said
    suspects = read_suspects(out)
    assert RedoList.read(out / "suspects.json") == suspects
    assert 0 < len(suspects.positions) < 5
    settings = AssemblySettings(keep_pedestal=True)
    made = drain(iter_assemble_session(out, matrix, settings=settings)).matrix
    metric = inspect(made)["suspect"]
    assert (metric.merit, metric.value, metric.detail) == ("bad", len(suspects.positions), "dark level")
    assert [tuple(p) for p in metric.positions.tolist()] == sorted(suspects.positions)
    assert set(suspects.positions) <= {place for place, _ in inspect(made).redo()}
    redo = ("--redo", out / "suspects.json", "--json")
    assert run(*begin, *redo, monkeypatch=monkeypatch) == 0
    assert "suspects" not in json.loads(capsys.readouterr().out)
    assert not (out / "suspects.json").exists()
    assert inspect(drain(iter_assemble_session(out, settings=settings)).matrix)["suspect"].merit == "unknown"


@pytest.mark.parametrize("said", ["text", [1], [["z", 0, 0, "x"]], [[9, 0, 0, "x"]], [[0, 0]], {"a": 1}, None])
def test_what_a_file_says_of_suspects_is_checked(said: Any) -> None:
    values = np.random.default_rng(1).random((1, 3, 3, 9, 9), np.float32)
    assert inspect(PSFMatrix(values, provenance={"suspect": said}))["suspect"].merit == "unknown"


def test_redo_list_comes_back(tmp_path: Path) -> None:
    given = RedoList.of([(0, 1, 2), (3, 4, 5)], ["missing"])
    given.write(tmp_path / "redo.json")
    data = json.loads((tmp_path / "redo.json").read_text())
    assert data == {
        "format": "lfcal-redo",
        "version": 1,
        "positions": [[0, 1, 2], [3, 4, 5]],
        "reasons": ["missing", ""],
    }
    assert RedoList.read(tmp_path / "redo.json") == given


def acknowledged(folder: Path) -> int:
    """Positions that are safe in a session that may not have begun."""
    if not (folder / "session.json").exists():
        return 0
    with RecordingFile(folder / "recording.h5") as recording:
        return int(recording.taken.sum())


@pytest.mark.few(1)
@pytest.mark.skipif(os.name != "posix", reason="interrupted by a signal")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", pytest.param("SIGHUP", marks=pytest.mark.long)])
def test_ctrl_c_stops_in_order_and_the_session_resumes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    plan = small_plan((10, 20), 1)
    (tmp_path / "plan.json").write_text(plan.to_json())
    out = tmp_path / "session"
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
    assert "stopping after this position" in complaint
    assert "resume with --resume" in said
    count = len(frames_of(out))
    assert 0 < count < plan.n_positions
    assert run("acquire", tmp_path / "plan.json", "--out", out, "--resume", "--no-pack", monkeypatch=monkeypatch) == 0
    assert len(frames_of(out)) == plan.n_positions


def test_doctor_lists_machine_libraries_and_devices(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("doctor", "--json", monkeypatch=monkeypatch) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert {"Python", "processors", "memory", "disk free here", "numba cache", "lfcal"} <= set(found["machine"])
    assert found["libraries"]["numpy"] == np.__version__
    devices = {d["name"]: d for d in found["devices"]}
    assert {"sim", "micromanager", "aravis", "gentl", "folder"} <= set(devices)
    assert all(bool(d["version"]) != bool(d["reason"]) for d in devices.values())
    assert run("doctor", monkeypatch=monkeypatch) == 0
    text = capsys.readouterr().out
    assert "sim" in text
    assert "numba cache" in text
