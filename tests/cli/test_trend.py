"""``lfcal trend``: fits of a camera over months, and what got worse from inspection to inspection."""

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
from tests.cli.conftest import Lfcal
from tests.judge.plain_report import undrawn
from tests.judge.test_report import matrix as reported_matrix
from tests.judge.test_trend import months, write_fit


def test_what_has_not_moved_ends_with_0_and_what_has_with_1(lfcal: Lfcal, tmp_path: Path) -> None:
    months(tmp_path / "still")
    still = lfcal("trend", tmp_path / "still")
    assert (
        still.code == 0 and "no parameter has changed" in still.out and "6 fits, 2026-01-01 to 2026-06-02" in still.out
    )
    folders = months(tmp_path / "jumped", jump=2.0)
    jumped = lfcal("trend", *folders, "-o", tmp_path / "trend.png")
    assert jumped.code == 1 and "moved: gap_um" in jumped.out and "from fit2 to fit3" in jumped.out
    assert (tmp_path / "trend.png").read_bytes()[:4] == b"\x89PNG"
    lfcal("trend", *folders, "--out", tmp_path / "trend.png").refused("exists; add --force")
    lfcal("trend", *folders, "-o", tmp_path / "trend.png", "--force", "--sigmas", 100).ok()


def test_json_has_every_value(lfcal: Lfcal, tmp_path: Path) -> None:
    months(tmp_path / "all", jump=2.0)
    run = lfcal("trend", tmp_path / "all", "--json")
    assert run.code == 1 and run.json["format"] == "lfcal-trend" and run.json["moved"] == ["gap_um"]
    gap = next(one for one in run.json["parameters"] if one["name"] == "gap_um")
    assert len(gap["points"]) == 6 and gap["points"][0]["when"].startswith("2026-01-01") and gap["jumps"]
    write_fit(tmp_path / "other", 400, groups=["geometry"])
    one = lfcal("trend", tmp_path / "all", tmp_path / "other", "--json").json
    assert one["parameters"][0]["per_month"] is None, "nothing to compare it with"


def test_fits_of_one_day_have_no_rate_and_folders_of_one_name_are_distinguished(lfcal: Lfcal, tmp_path: Path) -> None:
    for name, day, gap in (("day/a", 0, 400.0), ("day/b", 0.25, 402.0), ("may/fit", 0, 400.0), ("june/fit", 30, 430.0)):
        write_fit(tmp_path / name, day, {"gap_um": gap})
    run = lfcal("trend", tmp_path / "day")
    assert run.code == 1 and "within 6 h 00 min" in run.out and "2 fits, 2026-01-01 " in run.out
    assert "a change per month is not estimated from less than a week" in run.err
    run = lfcal("trend", tmp_path / "may" / "fit", tmp_path / "june")
    assert run.code == 1 and "from may/fit to june/fit" in run.out
    # the same one twice is one
    lfcal("trend", tmp_path / "may", tmp_path / "may" / "fit").refused()


def test_other_folders_end_in_one_line(lfcal: Lfcal, tmp_path: Path) -> None:
    cases: tuple[tuple[Callable[[Path], object], str], ...] = (
        (shutil.rmtree, "expected fit.json, written by lfcal fit, got no such folder"),
        (lambda folder: (folder / "fit.json").unlink(), "expected fit.json, written by lfcal fit, got none"),
        (lambda folder: (folder / "fit.json").write_bytes(b""), "fit.json"),
        (lambda folder: (folder / "camera.json").unlink(), "camera.json"),
        (lambda folder: (folder / "camera.json").write_text("{}"), "camera.json"),
        (lambda folder: (folder / "fit.json").write_bytes(b"\xff\xfe\x00"), "fit.json"),
    )
    for k, (spoil, said) in enumerate(cases):
        one, two = months(tmp_path / f"all{k}", 2)
        spoil(two)
        lfcal("trend", one, two).refused(said)


@pytest.fixture(scope="module")
def record() -> dict[str, Any]:
    """Return an inspection as its file holds it."""
    found = json.loads(json.dumps(plain(inspect(reported_matrix()).to_dict())))
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
    lfcal("trend", "--quality", tmp_path / "reports", "-o", tmp_path / "trend.png").refused("exists; add --force")
    told = lfcal("trend", "--quality", tmp_path / "reports", "--json").json
    assert told["worse"] == ["ghost image", "lamp"]
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


def test_no_change_per_month_is_estimated_from_less_than_a_week(
    lfcal: Lfcal, record: dict[str, Any], tmp_path: Path
) -> None:
    write(tmp_path / "a", record, 5, (1.0, "good"))
    b = write(tmp_path / "b", record, 6, (3.5, "fair"))
    for when, told in (
        ("2026-05-01T00:00:04+00:00", "within 4.0 s"),
        ("2026-05-03T06:00:00+00:00", "within 2.2 days"),
        ("2026-05-31T10:30:00+00:00", "+2.5"),
    ):
        words = ("trend", "--quality", tmp_path / "a", dated(b, when))
        run = lfcal(*words)
        assert run.code == 1 and told in run.out, "it got worse all the same"
        assert ("a change per month is not estimated" in run.err) == told.startswith("within")
        lamp = next(one for one in lfcal(*words, "--json").json["metrics"] if one["key"] == "lamp")
        assert (lamp["per_month"] is None) == told.startswith("within") and lamp["span_s"] > 0


def test_sessions_of_one_time_or_of_another_array_are_named(
    lfcal: Lfcal, record: dict[str, Any], tmp_path: Path
) -> None:
    nz, ny, nx, nt, ns = record["shape"]
    dated(write(tmp_path / "a", record, 5, (1.0, "good")), "2026-05-01T00:00:00Z", shape=[nz, ny + 1, nx, nt, ns])
    write(tmp_path / "b", record, 5, (1.0, "good"))
    run = lfcal("trend", "--quality", tmp_path / "a", tmp_path / "b")
    assert run.code == 0 and "2 sessions, 2026-05-01 " in run.out and " to " not in run.out.splitlines()[0]
    assert "a and b have the same time" in run.err
    assert f"a: a period of {ny + 1} × {nx} positions" in run.err and "another camera" in run.err


def test_merits_without_a_number_or_unknown(lfcal: Lfcal, record: dict[str, Any], tmp_path: Path) -> None:
    """A signal without noise is infinite, and infinity is not a number of a file; unknown is not known to be worse."""
    for k, lamp in enumerate([(None, "fair"), (None, "good"), (1.0, "good"), (9.0, "unknown"), (9.0, "bad")]):
        write(tmp_path / f"m{k}", record, 1 + k, lamp)  # type: ignore[arg-type]
    words = ("trend", "--quality")
    run = lfcal(*words, tmp_path / "m0", tmp_path / "m1").ok()
    assert "better" in run.out and "nan" not in run.out
    lfcal(*words, tmp_path / "m2", tmp_path / "m3").ok()
    assert lfcal(*words, *(tmp_path / f"m{k}" for k in (2, 3, 4))).code == 1, "compared with the last known"


def test_h_files_are_measured(lfcal: Lfcal, tmp_path: Path) -> None:
    good = reported_matrix()
    save(good, tmp_path / "may.h5")
    dark = np.asarray(good[:]).copy()
    dark[1] = 0
    save(PSFMatrix(dark, depths=good.depths, camera=good.camera), tmp_path / "june.h5")
    run = lfcal("trend", "--quality", tmp_path / "may.h5", tmp_path / "june.h5", "--json")
    told = run.json
    assert run.code == 1 and [one["label"] for one in told["sessions"]] == ["may.h5", "june.h5"]
    assert "planes_lit" in told["worse"] and "time of the file" in told["notes"][0]


def test_a_report_states_its_date(lfcal: Lfcal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undrawn(monkeypatch)
    save(reported_matrix(), tmp_path / "H.h5")
    lfcal("inspect", tmp_path / "H.h5", "--seconds", 0, "--report", tmp_path / "a").ok()
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    run = lfcal("trend", "--quality", tmp_path / "a", tmp_path / "b")
    assert run.code == 0 and "no date" not in run.err and "nothing got worse" in run.out


def test_what_is_not_an_inspection_is_one_line(lfcal: Lfcal, record: dict[str, Any], tmp_path: Path) -> None:
    one = tmp_path / "one"
    lfcal("trend", "--quality", one, one).refused("no such folder")
    one.mkdir()
    for content, said in (
        ("", "quality.json"),
        ("{}", 'got a file without the entry "format"'),
        ('{"format": "lfcal-quality"}', "damaged"),
    ):
        (one / "quality.json").write_text(content)
        lfcal("trend", "--quality", one, one).refused(said)
    write(tmp_path / "single", record, 1, (1.0, "good"))
    lfcal("trend", "--quality", tmp_path / "single").refused("at least two")
