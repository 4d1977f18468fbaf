"""``lfcal trend``: fits of a camera over months on the command line."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Run
from tests.judge.test_trend import months, write_fit

Lfcal = Callable[..., Run]


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
    again = lfcal("trend", *folders, "--out", tmp_path / "trend.png")
    assert again.code == 2 and "exists; add --force" in again.err
    assert lfcal("trend", *folders, "-o", tmp_path / "trend.png", "--force", "--sigmas", 100).code == 0


def test_json_has_every_value(lfcal: Lfcal, tmp_path: Path) -> None:
    months(tmp_path / "all", jump=2.0)
    run = lfcal("trend", tmp_path / "all", "--json")
    found = run.json
    assert (
        run.code == 1 and isinstance(found, dict) and found["format"] == "lfcal-trend" and found["moved"] == ["gap_um"]
    )
    gap = next(one for one in found["parameters"] if one["name"] == "gap_um")
    assert len(gap["points"]) == 6 and gap["points"][0]["when"].startswith("2026-01-01") and gap["jumps"]
    write_fit(tmp_path / "other", 400, groups=["geometry"])
    one = lfcal("trend", tmp_path / "all", tmp_path / "other", "--json").json
    assert isinstance(one, dict) and one["parameters"][0]["per_month"] is None, "nothing to compare it with"


def test_fits_of_one_day_tell_their_span_in_place_of_a_rate(lfcal: Lfcal, tmp_path: Path) -> None:
    for name, day, gap in (("a", 0, 400.0), ("b", 0.25, 402.0)):
        write_fit(tmp_path / name, day, {"gap_um": gap})
    run = lfcal("trend", tmp_path)
    assert run.code == 1 and "within 6 h 00 min" in run.out and "2 fits, 2026-01-01 " in run.out
    assert "a change per month is not estimated from less than a week" in run.err


def test_folders_of_one_name_are_told_apart(lfcal: Lfcal, tmp_path: Path) -> None:
    for name, day in (("may", 0), ("june", 30)):
        write_fit(tmp_path / name / "fit", day, {"gap_um": 400.0 + day})
    run = lfcal("trend", tmp_path / "may" / "fit", tmp_path / "june")
    assert run.code == 1 and "from may/fit to june/fit" in run.out
    # the same one twice is one
    assert lfcal("trend", tmp_path / "may", tmp_path / "may" / "fit").code == 2


@pytest.mark.parametrize(
    ("spoil", "what"),
    [
        (lambda folder: shutil.rmtree(folder), "expected fit.json, written by lfcal fit, got no such folder"),
        (lambda folder: (folder / "fit.json").unlink(), "expected fit.json, written by lfcal fit, got none"),
        (lambda folder: (folder / "fit.json").write_bytes(b""), "fit.json"),
        (lambda folder: (folder / "camera.json").unlink(), "camera.json"),
        (lambda folder: (folder / "camera.json").write_text("{}"), "camera.json"),
        (lambda folder: (folder / "fit.json").write_bytes(b"\xff\xfe\x00"), "fit.json"),
    ],
)
def test_other_folders_end_in_one_line(
    lfcal: Lfcal, tmp_path: Path, spoil: Callable[[Path], object], what: str
) -> None:
    one, two = months(tmp_path / "all", 2)
    spoil(two)
    run = lfcal("trend", one, two)
    assert run.code == 2 and run.err.count("\n") == 1 and what in run.err, run.err
