"""Findings: one form for everything that is wrong with data, and a verdict that agrees with them."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

from lfcal.acquire.guard.doubts import NO_DOUBT, Doubt
from lfcal.acquire.live_quality import LIMITS, QualityState, alarm
from lfcal.acquire.recording import DamagedFrame, SessionReport, Suspicion
from lfcal.acquire.recording._verify import FileReport
from lfcal.base import RANK, SUBJECTS, Finding, Judgement, Merit
from lfcal.camera import preset
from lfcal.campaign.points import Points
from lfcal.frames import ArraySource, Position
from lfcal.judge import FINDING_SOURCES, FindingSource, Inspection, judgement_of
from lfcal.judge.fault import FAULTS, FoundFault
from lfcal.judge.inspection import BAD, BAD_SHARE, FAIR, FAIR_SHARE
from lfcal.judge.quality import METRICS, QualityReport, inspect
from lfcal.judge.telling import compared_words
from lfcal.lattice import CameraCheck
from lfcal.lattice.camera_check import DIFFERS, FITS, WRONG, CheckLine
from lfcal.psf import Cutout, MatrixCheck, PSFMatrix, assemble
from lfcal.psf._verify import DamagedPlane
from lfcal.targets.finding import FoundPoints


def finding(what: str = "hot line", merit: Merit = "bad", subject: str = "sensor", **more: int) -> Finding:
    return Finding(kind=what, what=what, subject=subject, remedy=f"Fix the {what}.", merit=merit, **more)


def test_every_metric_and_fault_has_a_subject() -> None:
    for source in (*METRICS, *FAULTS):
        assert source.subject in SUBJECTS and source.subject != "other", source.name


def classes_of_lfcal() -> dict[str, type]:
    """Return what the packages of lfcal show, by name."""
    found: dict[str, type] = {"Points": Points}
    for part in ("acquire", "campaign", "judge", "lattice", "psf", "targets"):
        package = importlib.import_module(f"lfcal.{part}")
        found |= {name: getattr(package, name) for name in dir(package) if isinstance(getattr(package, name), type)}
    return found


def test_every_source_judges_existing_classes() -> None:
    """A source names classes, which must exist, and be what `judgement_of` takes."""
    known = classes_of_lfcal()
    for source in FINDING_SOURCES:
        for name in source.of:
            assert {"data", "known"} <= set(dir(known[name])), (source.name, name)


def test_findings_are_made_by_sources_alone() -> None:
    """A class that judges data has a source; nothing would read its own property."""
    own = {name for name, one in classes_of_lfcal().items() if isinstance(vars(one).get("findings"), property)}
    assert own == set()
    assert {get_args(get_type_hints(one)[name])[0] for one, name in MADE} == {Finding}


MADE = ((Doubt, "findings"), (Judgement, "findings"), (QualityState, "alarms"), (FoundPoints, "mistakes"))
"""What keeps findings: a judgement, and what lies below `lfcal.judge` and finds them while frames come."""


def test_a_source_of_another_package_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Findings of another package are in the verdict with those of lfcal."""
    short = FindingSource("short names", ("MatrixCheck",), lambda check: [finding(f"short name {check.path.name}")])
    monkeypatch.setattr(FINDING_SOURCES, "_parts", {**{one.name: one for one in FINDING_SOURCES}, short.name: short})
    check = MatrixCheck(Path("H.h5"), 2, True, (), 0)
    assert judgement_of(check).verdict.startswith("This H file should not be used as it is: short name H.h5.")


def judged(*findings: Finding, known: str = "good by all") -> Judgement:
    return Judgement.of("H", findings, known)


def test_findings_are_grouped_in_the_order_of_a_report() -> None:
    found = judged(finding("a", subject="file"), finding("b", subject="stage"), finding("c", subject="file"))
    groups = {subject: [one.what for one in group] for subject, group in found.by_subject().items()}
    assert groups == {"stage": ["b"], "file": ["a", "c"]} and list(groups) == ["stage", "file"]
    assert found.to_dict()["subjects"] == {"stage": "bad", "file": "bad"}


def test_the_worst_finding_gives_the_merit() -> None:
    merits: list[Merit] = ["good", "fair", "unknown", "bad"]
    assert [judged(*(finding(merit=m) for m in merits[: k + 1])).merit for k in range(4)] == merits
    assert judged().merit == "good" and judged(known="").merit == "unknown"
    assert judged(known="").verdict.startswith("Nothing could be measured")
    assert sorted(RANK, key=RANK.__getitem__)[0] == "bad"


@pytest.mark.parametrize(
    ("findings", "words"),
    [
        ([], "This H is good by all."),
        (
            [finding()],
            "should not be used as it is: hot line. Hot line. Fix the hot line. What remains is good by all.",
        ),
        ([finding(merit="fair")], "is usable, but should be checked: hot line."),
        ([finding(merit="good", repeat=3)], "is good but for 3 positions to record again: hot line."),
        ([finding("a"), finding("b")], "What remains should not be used: b."),
        ([finding("a"), finding("b", "fair")], "What remains should be checked: b."),
        ([finding("a"), finding("b", "good")], "What remains is good but for b."),
        ([finding(name) for name in "abcde"], "as it is: a, b, c and 2 more."),
        (
            [finding(merit="unknown")],
            "is not fully judged: hot line. Hot line. Fix the hot line. What remains is good",
        ),
        ([finding("a", "unknown"), finding("b", "fair")], "What remains should be checked: b."),
        (
            [finding("a"), finding("b"), finding("c", "unknown")],
            "What remains should not be used: b, and is not fully judged: c. C. Fix the c.",
        ),
    ],
)
def test_the_verdict_says_what_is_wrong_and_what_remains(findings: list[Finding], words: str) -> None:
    assert words in judged(*findings).verdict


def test_metrics_become_findings_with_their_numbers() -> None:
    H = np.zeros((1, 3, 3, 9, 9))
    H[..., 3:6, 3:6] = np.arange(100, 109).reshape(1, 3, 3, 1, 1)
    H[0, 0, 1] = 0
    (one,) = [one for one in judgement_of(inspect(PSFMatrix(H))).findings if one.kind == "missing"]
    assert (one.subject, one.size, one.positions, one.repeat, one.merit) == ("frames", 1.0, ((0, 0, 1),), 1, "bad")
    assert one.size > one.limit and one.cost is not None and one.cost > 0 and one.remedy


def test_frames_become_findings_beyond_their_limit() -> None:
    for kind in LIMITS:
        assert alarm(kind, LIMITS[kind], "x: y") == []
        (one,) = alarm(kind, LIMITS[kind] + 1.0, "it moved: hold it")
        assert one.subject in SUBJECTS and (one.what, one.remedy, one.limit) == ("it moved", "hold it", LIMITS[kind])
        assert one.line.startswith(f"{kind}: ") and one.line.endswith(": it moved: hold it")


def test_a_camera_check_finds_what_differs() -> None:
    lines = [CheckLine(v, "1", "2", None if v == WRONG else 0.7, v) for v in (FITS, DIFFERS, WRONG)]
    check = CameraCheck(tuple(lines), None, None)
    found = judgement_of(check)
    assert [(one.what, one.merit) for one in found.findings] == [(WRONG, "bad"), (DIFFERS, "fair")]
    assert found.findings[1].size == 0.7 and "2 in the white image, 1 in the camera" in found.findings[1].sentence
    fits = judgement_of(replace(check, lines=check.lines[:1]))
    assert fits.verdict == "This camera is confirmed by the white image in 1 of 1 value."


def test_a_check_of_an_h_file_finds_what_is_damaged() -> None:
    whole = MatrixCheck(Path("H.h5"), 4, True, (), 0)
    assert judgement_of(whole).verdict == "This H file is intact in 4 of 4 planes (compared with their checksums)."
    planes = tuple(DamagedPlane("", z, what, ((z, 0, 1),)) for z, what in enumerate(("damaged", "damaged", "changed")))
    found = judgement_of(replace(whole, missing=3, deviations=("odd",), damaged=planes))
    assert [(one.kind, one.merit) for one in found.findings] == [
        ("damaged", "bad"),
        ("changed", "bad"),
        ("deviation", "bad"),
        ("missing", "fair"),
    ]
    assert found.findings[0].positions == ((0, 0, 1), (1, 0, 1)) and "2 planes, plane 0, plane 1" in found.verdict
    assert found.merit == "bad" and list(found.by_subject()) == ["frames", "file"]


def test_a_session_is_bad_where_its_check_is_not_ok() -> None:
    """The exit code and the verdict of ``lfcal verify`` never contradict each other."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        files = (FileReport("recording.h5", 9, 9, 0, 0, "cut off" if rng.random() < 0.3 else ""),)
        damaged = tuple(
            DamagedFrame(
                "r.h5", k, ("position", "dark")[rng.integers(2)], Position(0, 0, k), "torn", rng.random() < 0.5
            )
            for k in range(rng.integers(4))
        )
        never = (Position(0, 1, 0),) * int(rng.integers(2))
        session = SessionReport(Path("s"), files, damaged, never, lacking=int(rng.random() < 0.3))
        found = judgement_of(session)
        assert (found.merit != "bad") == session.ok
        places = {place for one in found.findings if one.kind == "damaged" for place in one.positions}
        assert places == set(session.to_redo)
        assert session.ok or found.verdict.startswith("This session should not be used as it is")


def test_an_assembly_finds_what_its_frames_lack() -> None:
    frames = ArraySource(np.ones((2, 9, 9), np.uint16), [(0, 0, 0), (0, 0, 2)])
    report = assemble(frames, (1, 1, 3), Cutout((5, 5), anchor=(1, 4), outside="zero"))
    found = judgement_of(report)
    assert {one.kind for one in found.findings} >= {"missing", "padded", "unknown_saturation"}
    (missing,) = [one for one in found.findings if one.kind == "missing"]
    assert missing.positions == ((0, 0, 1),) and missing.repeat == 1 and found.merit == "fair"


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


# -- the verdict on an H, whatever its faults and metrics ------------------------------------------------
BAND: dict[Merit, tuple[tuple[float, float], tuple[float, float]]] = {
    "good": ((0.0, 0.99 * FAIR), (0.0, 0.99 * FAIR_SHARE)),
    "fair": ((FAIR, 0.99 * BAD), (FAIR_SHARE, 0.99 * BAD_SHARE)),
    "bad": ((BAD, 2.0), (BAD_SHARE, 1.0)),
}
"""Costs, and shares of the light where no cost was measured, of faults of each merit."""


@pytest.fixture(scope="module")
def quality() -> QualityReport:
    """Return the metrics of a small H, all of them good."""
    values = np.random.default_rng(0).random((2, 4, 6, 15, 15), np.float32)
    found = inspect(PSFMatrix(values, camera=preset("bench"), depths=(-20e3, -26e3)), workers=1)
    metrics = (m if m.merit == "unknown" else replace(m, merit="good", cost=0.0) for m in found.metrics)
    return replace(found, metrics=tuple(metrics))


def drawn(rng: np.random.Generator, merit: Merit) -> FoundFault:
    faults = list(FAULTS)
    costs, shares = BAND[merit]
    cost = float(rng.uniform(*costs)) if rng.random() < 0.6 else None
    share = float(rng.uniform(*shares) if cost is None else rng.random())
    return FoundFault(faults[rng.integers(len(faults))], "3 pixels", 12.0, share, cost=cost)


@pytest.mark.parametrize("seed", range(40))
def test_the_verdict_never_contradicts_faults_and_metrics(quality: QualityReport, seed: int) -> None:
    rng = np.random.default_rng(seed)
    merits: list[Merit] = [("good", "fair", "bad")[k] for k in rng.integers(1 + seed % 3, size=rng.integers(0, 8))]
    findings = tuple(drawn(rng, merit) for merit in merits)
    changed = {quality.metrics[k].key for k in rng.integers(len(quality.metrics), size=rng.integers(0, 6))}
    worse: tuple[Merit, ...] = ("fair", "bad")
    metrics = tuple(
        replace(m, merit=worse[rng.integers(1 + seed % 2)]) if m.key in changed else m for m in quality.metrics
    )
    compared = int(rng.integers(2)) * 60
    found = Inspection(replace(quality, metrics=metrics), findings, compared, 0.01, "" if compared else "why", 1.0)
    verdict = found.verdict

    assert not findings or "no fault" not in verdict, "next to a table of faults"
    assert not findings or "no fault" not in compared_words(found)
    standing = [m for m in metrics if found.settled(m) is None and not found.withdrawn(m)]
    every = {*merits, *(m.merit for m in standing if m.merit != "unknown")}
    worst = next(merit for merit in ("bad", "fair", "good") if merit in every)
    starts = {"bad": "should not be used", "fair": "is usable, but should be checked", "good": "is good"}
    assert verdict.startswith(f"This H {starts[worst]}") and found.merit == worst
    assert found.bad == (worst == "bad")
    # what decides is named, or counted among the others
    names = [f.title for f, merit in zip(findings, merits, strict=True) if merit == worst]
    names += [m.spec.title.lower() for m in standing if m.merit == worst and worst != "good"]
    missing = [name for name in names if name.lower() not in verdict.lower()]
    assert (
        not missing or f"and {len(names) - (3 if worst == 'bad' else 4)} more" in verdict or not (compared or findings)
    )
    if worst == "good" and compared:
        assert f"by {sum(m.merit == 'good' for m in metrics)} check" in verdict


def test_faults_without_a_cost_and_without_a_camera_are_counted(quality: QualityReport) -> None:
    for cost, many, words in (
        (0.01, 1, "show 1 fault that costs a reconstruction almost nothing"),
        (0.01, 2, "show 2 faults that cost a reconstruction almost nothing"),
        (None, 1, "show 1 fault that is too small to matter"),
        (None, 2, "show 2 faults that are too small to matter"),
    ):
        one = FoundFault(FAULTS.get("bad_pixels"), "2 pixels", 12.0, 0.001, cost=cost)
        found = Inspection(quality, (one,) * many, 60, 0.01, "", 1.0)
        assert words in found.verdict and "(bad pixels of the sensor" in found.verdict
    one = FoundFault(FAULTS.get("saturated"), "values end", 12.0, 0.2, cost=0.01)
    found = Inspection(quality, (one,), 0, 0.2, "its camera leaves 20 % of the light unexplained", 1.0)
    assert "its patterns show 1 fault that costs" in found.verdict and "saturated values" in found.verdict
    assert "the patterns alone show these faults" in compared_words(found)
