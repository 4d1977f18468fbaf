"""``lfcal trend --quality``: what got worse from inspection to inspection, and which faults are new."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base._plain import plain
from lfcal.judge.quality import inspect
from lfcal.psf import PSFMatrix, save
from tests.cli.conftest import Run
from tests.judge.plain_report import undrawn
from tests.judge.test_report import matrix

Lfcal = Callable[..., Run]


@pytest.fixture(scope="module")
def record() -> dict[str, Any]:
    """Return an inspection as its file holds it."""
    found = json.loads(json.dumps(plain(inspect(matrix()).to_dict())))
    assert isinstance(found, dict)
    return found


def write(
    folder: Path, record: dict[str, Any], month: int, lamp: tuple[float, str], faults: dict[str, float] | None = None
) -> Path:
    """Write an inspection of the first of a month: the lamp's drift with its merit, and faults by their shares."""
    metrics = [
        one | ({"value": lamp[0], "merit": lamp[1]} if one["key"] == "lamp" else {"value": 0.0, "merit": "good"})
        for one in record["metrics"]
    ]
    data = record | {"metrics": metrics, "inspected": f"2026-{month:02d}-01T00:00:00+00:00"}
    if faults is not None:
        data["model"] = {"compared": 60, "faults": [{"title": k, "share": v} for k, v in faults.items()]}
    folder.mkdir(parents=True)
    (folder / "quality.json").write_text(json.dumps(data))
    return folder


def test_what_got_worse_ends_with_1(lfcal: Lfcal, record: dict[str, Any], tmp_path: Path) -> None:
    lamps = [(1.0, "good"), (2.0, "good"), (3.5, "fair")]
    for k, lamp in enumerate(lamps):
        write(tmp_path / "reports" / f"m{k}", record, 1 + k, lamp, {"ghost image": 0.02} if k == 2 else {})
    run = lfcal("trend", "--quality", tmp_path / "reports", "--out", tmp_path / "trend.png")
    assert run.code == 1 and "3 sessions, 2026-01-01 to 2026-03-01" in run.out, run.err
    assert "worse than before: ghost image, Lamp drift" in run.out and "3.5 fair" in run.out
    assert (tmp_path / "trend.png").read_bytes()[:4] == b"\x89PNG"
    again = lfcal("trend", "--quality", tmp_path / "reports", "-o", tmp_path / "trend.png")
    assert again.code == 2 and "exists; add --force" in again.err
    told = lfcal("trend", "--quality", tmp_path / "reports", "--json").json
    assert isinstance(told, dict) and told["worse"] == ["ghost image", "lamp"]
    course = next(one for one in told["metrics"] if one["key"] == "lamp")
    assert course["values"] == [1.0, 2.0, 3.5] and course["per_month"] == pytest.approx(1.25, rel=0.05)
    assert told["faults"][0]["values"] == pytest.approx([0, 0, 2])


def test_what_got_better_or_stayed_ends_with_0(lfcal: Lfcal, record: dict[str, Any], tmp_path: Path) -> None:
    # named in another order than they were made
    june = write(tmp_path / "june", record, 6, (1.0, "good"))
    may = write(tmp_path / "may", record, 5, (9.0, "bad"))
    run = lfcal("trend", "--quality", june, may / "quality.json")
    assert run.code == 0 and "nothing got worse" in run.out and "better" in run.out
    assert "not compared with a camera" in run.err and run.out.index("may") < run.out.index("june")


def dated(folder: Path, when: str, **more: Any) -> Path:
    """Change when an inspection was made, and what else its file holds."""
    file = folder / "quality.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"inspected": when} | more))
    return folder


@pytest.mark.parametrize(
    ("when", "told"),
    [
        ("2026-05-01T00:00:04+00:00", "within 4.0 s"),
        ("2026-05-03T06:00:00+00:00", "within 2.2 days"),
        ("2026-05-31T10:30:00+00:00", "+2.5"),
    ],
)
def test_no_change_per_month_is_told_from_less_than_a_week(
    lfcal: Lfcal, record: dict[str, Any], tmp_path: Path, when: str, told: str
) -> None:
    write(tmp_path / "a", record, 5, (1.0, "good"))
    dated(write(tmp_path / "b", record, 6, (3.5, "fair")), when)
    run = lfcal("trend", "--quality", tmp_path / "a", tmp_path / "b")
    assert run.code == 1 and told in run.out, "it got worse all the same"
    assert ("a change per month is not estimated" in run.err) == told.startswith("within")
    found = lfcal("trend", "--quality", tmp_path / "a", tmp_path / "b", "--json").json
    assert isinstance(found, dict)
    lamp = next(one for one in found["metrics"] if one["key"] == "lamp")
    assert (lamp["per_month"] is None) == told.startswith("within") and lamp["span_s"] > 0


def test_sessions_of_one_time_or_of_another_array_are_said(
    lfcal: Lfcal, record: dict[str, Any], tmp_path: Path
) -> None:
    nz, ny, nx, nt, ns = record["shape"]
    dated(write(tmp_path / "a", record, 5, (1.0, "good")), "2026-05-01T00:00:00Z", shape=[nz, ny + 1, nx, nt, ns])
    write(tmp_path / "b", record, 5, (1.0, "good"))
    run = lfcal("trend", "--quality", tmp_path / "a", tmp_path / "b")
    assert run.code == 0 and "2 sessions, 2026-05-01 " in run.out and " to " not in run.out.splitlines()[0]
    assert "a and b have the same time" in run.err
    assert f"a: a period of {ny + 1} × {nx} positions" in run.err and "another camera" in run.err


def test_a_merit_without_a_number_is_told_by_itself(lfcal: Lfcal, record: dict[str, Any], tmp_path: Path) -> None:
    """A signal without noise is infinite, and infinity is no number of a file."""
    for k, merit in enumerate(("fair", "good")):
        write(tmp_path / f"m{k}", record, 5 + k, (None, merit))  # type: ignore[arg-type]
    run = lfcal("trend", "--quality", tmp_path / "m0", tmp_path / "m1")
    assert run.code == 0 and "better" in run.out and "nan" not in run.out


def test_an_unknown_value_is_neither_worse_nor_better(lfcal: Lfcal, record: dict[str, Any], tmp_path: Path) -> None:
    for k, lamp in enumerate([(1.0, "good"), (9.0, "unknown"), (9.0, "bad")]):
        write(tmp_path / f"m{k}", record, 1 + k, lamp)
    unknown = lfcal("trend", "--quality", tmp_path / "m0", tmp_path / "m1")
    assert unknown.code == 0, "it is not known to be worse"
    assert lfcal("trend", "--quality", *(tmp_path / f"m{k}" for k in range(3))).code == 1, "against the last known"


def test_h_files_are_measured(lfcal: Lfcal, tmp_path: Path) -> None:
    good = matrix()
    save(good, tmp_path / "may.h5")
    dark = np.asarray(good[:]).copy()
    dark[1] = 0
    save(PSFMatrix(dark, depths=good.depths, camera=good.camera), tmp_path / "june.h5")
    run = lfcal("trend", "--quality", tmp_path / "may.h5", tmp_path / "june.h5", "--json")
    told = run.json
    assert run.code == 1 and isinstance(told, dict)
    assert [one["label"] for one in told["sessions"]] == ["may.h5", "june.h5"]
    assert "planes_lit" in told["worse"] and "time of the file" in told["notes"][0]


def test_a_report_says_when_it_was_made(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    save(matrix(), tmp_path / "H.h5")
    assert lfcal("inspect", tmp_path / "H.h5", "--seconds", 0, "--report", tmp_path / "a").code == 0
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    run = lfcal("trend", "--quality", tmp_path / "a", tmp_path / "b")
    assert run.code == 0 and "no date" not in run.err and "nothing got worse" in run.out


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such folder"),
        ("", "quality.json"),
        ("{}", 'got a file without the entry "format"'),
        ('{"format": "lfcal-quality"}', "damaged"),
    ],
)
def test_what_is_no_inspection_is_one_line(lfcal: Lfcal, tmp_path: Path, content: str | None, words: str) -> None:
    if content is not None:
        (tmp_path / "one").mkdir()
        (tmp_path / "one" / "quality.json").write_text(content)
    run = lfcal("trend", "--quality", tmp_path / "one", tmp_path / "one")
    assert run.code == 2 and run.err.count("\n") == 1 and words in run.err, run.err


def test_one_is_no_trend(lfcal: Lfcal, record: dict[str, Any], tmp_path: Path) -> None:
    write(tmp_path / "one", record, 1, (1.0, "good"))
    run = lfcal("trend", "--quality", tmp_path / "one")
    assert run.code == 2 and "at least two" in run.err
