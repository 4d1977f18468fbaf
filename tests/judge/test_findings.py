"""Findings: one form for everything that is wrong with data, grouped by subject, in one verdict."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

from lfcal.acquire.guard.doubts import NO_DOUBT, Doubt
from lfcal.acquire.live_quality import LIMITS, QualityState, alarm
from lfcal.acquire.recording import SessionReport, Suspicion
from lfcal.base import RANK, SUBJECTS, Finding, Merit, by_subject, verdict_of, worst_merit
from lfcal.judge.checking import Check
from lfcal.judge.fault import FAULTS
from lfcal.judge.inspection import Inspection
from lfcal.judge.quality import METRICS, QualityReport, inspect
from lfcal.lattice import CameraCheck
from lfcal.lattice.camera_check import DIFFERS, FITS, WRONG, CheckLine
from lfcal.psf import AssemblyReport, MatrixCheck, PSFMatrix
from lfcal.targets.finding import FoundPoints


def finding(what: str = "hot line", merit: Merit = "bad", subject: str = "sensor", **more: int) -> Finding:
    return Finding(kind=what, what=what, subject=subject, remedy=f"Mend the {what}.", merit=merit, **more)


@pytest.mark.parametrize("source", [*METRICS, *FAULTS], ids=lambda one: one.name)
def test_every_metric_and_fault_has_a_subject(source: object) -> None:
    assert source.subject in SUBJECTS and source.subject != "other"  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("source", "name"),
    [
        (Inspection, "findings"),
        (QualityReport, "findings"),
        (Check, "findings"),
        (AssemblyReport, "findings"),
        (CameraCheck, "findings"),
        (Doubt, "findings"),
        (MatrixCheck, "findings"),
        (SessionReport, "findings"),
        (QualityState, "alarms"),
        (FoundPoints, "mistakes"),
    ],
)
def test_what_judges_data_gives_findings(source: type, name: str) -> None:
    """Whoever says what is wrong says it in the same form."""
    member = getattr(source, name, None)
    hints = get_type_hints(member.fget)["return"] if isinstance(member, property) else get_type_hints(source)[name]
    assert get_args(hints)[0] is Finding


def test_findings_are_grouped_in_the_order_of_a_report() -> None:
    found = by_subject([finding("a", subject="file"), finding("b", subject="stage"), finding("c", subject="file")])
    assert {subject: [one.what for one in group] for subject, group in found.items()} == {
        "stage": ["b"],
        "file": ["a", "c"],
    }
    assert list(found) == ["stage", "file"]


def test_the_worst_finding_gives_the_merit() -> None:
    merits: list[Merit] = ["good", "fair", "bad"]
    assert [worst_merit([finding(merit=m) for m in merits[: k + 1]]) for k in range(3)] == merits
    assert worst_merit([]) == "good" and sorted(RANK, key=RANK.__getitem__)[0] == "bad"


@pytest.mark.parametrize(
    ("findings", "words"),
    [
        ([], "This PSF is good by all."),
        (
            [finding()],
            "should not be used as it is: hot line. Hot line. Mend the hot line. What remains is good by all.",
        ),
        ([finding(merit="fair")], "can be used; worth a look: hot line."),
        ([finding(merit="good", repeat=3)], "is good but for 3 positions to record again: hot line."),
        ([finding("a"), finding("b")], "What remains should not be used: b."),
        ([finding("a"), finding("b", "fair")], "What remains is worth a look: b."),
        ([finding("a"), finding("b", "good")], "What remains is good but for b."),
        ([finding(name) for name in "abcde"], "as it is: a, b, c and 2 more."),
    ],
)
def test_the_verdict_says_what_is_wrong_and_what_remains(findings: list[Finding], words: str) -> None:
    assert words in verdict_of(findings, "good by all")


def test_metrics_become_findings_with_their_numbers() -> None:
    H = np.zeros((1, 3, 3, 9, 9))
    H[..., 3:6, 3:6] = np.arange(100, 109).reshape(1, 3, 3, 1, 1)
    H[0, 0, 1] = 0
    (one,) = [one for one in inspect(PSFMatrix(H)).findings if one.kind == "missing"]
    assert (one.subject, one.size, one.positions, one.repeat, one.merit) == ("frames", 1.0, ((0, 0, 1),), 1, "bad")
    assert one.size > one.limit and one.cost is not None and one.cost > 0 and one.remedy


@pytest.mark.parametrize("kind", LIMITS)
def test_frames_become_findings_beyond_their_limit(kind: str) -> None:
    assert alarm(kind, LIMITS[kind], "x: y") == []
    (one,) = alarm(kind, LIMITS[kind] + 1.0, "it moved: hold it")
    assert one.subject in SUBJECTS and (one.what, one.remedy, one.limit) == ("it moved", "hold it", LIMITS[kind])
    assert one.line.startswith(f"{kind}: ") and one.line.endswith(": it moved: hold it")


def test_a_camera_check_finds_what_differs() -> None:
    lines = [CheckLine(v, "1", "2", None if v == WRONG else 0.7, v) for v in (FITS, DIFFERS, WRONG)]
    found = CameraCheck(tuple(lines), None, None).findings
    assert [(one.kind, one.merit) for one in found] == [(DIFFERS, "fair"), (WRONG, "bad")]
    assert found[0].size == 0.7 and "2 where 1 is described" in found[0].sentence


def test_checks_of_files_find_what_is_damaged() -> None:
    whole = MatrixCheck(Path("H.h5"), 2, True, (), 0)
    assert not whole.findings and [one.kind for one in replace(whole, missing=3, deviations=("odd",)).findings] == [
        "deviation",
        "missing",
    ]
    session = SessionReport(Path("s"), (), (), ())
    assert not session.findings and [one.kind for one in replace(session, lacking=2).findings] == ["lacking"]


def test_doubts_about_a_frame_are_findings_with_their_flags() -> None:
    torn = Doubt.of(Suspicion.TORN, "rows: expected new content, got rows of (0, 0, 1); the camera mixes its buffers")
    both = torn | Doubt.of(Suspicion.LIGHT, "light: expected 5, got 9; check the lamp") | NO_DOUBT
    assert both and not NO_DOUBT and both.what == Suspicion.TORN | Suspicion.LIGHT and both.certain
    assert [(one.kind, one.subject, one.merit) for one in both.findings] == [
        ("torn", "frames", "bad"),
        ("light", "light", "fair"),
    ]
    assert both.findings[1].remedy == "check the lamp" and both.text.startswith(torn.text)
    assert torn.text.endswith("got rows of (0, 0, 1); the camera mixes its buffers")
