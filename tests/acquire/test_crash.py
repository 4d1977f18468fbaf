"""``kill -9`` and a power cut at random times; `tests.acquire.crash_figures` gives the full figures."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.acquire.crashing import equal_matrices, kill_and_resume, power_cuts, undisturbed, why_no_power_cut
from tests.acquire.rigs import small_plan

PLAN = small_plan((16, 20), 3, cutout=(65, 65), shape=(110, 110))


@pytest.mark.skipif(not hasattr(__import__("signal"), "SIGKILL"), reason="no kill -9 on this platform")
@pytest.mark.parametrize("kills", [1, pytest.param(3, marks=pytest.mark.long)])
def test_killed_and_resumed_equals_undisturbed(tmp_path: Path, kills: int) -> None:
    undisturbed(tmp_path / "calm", PLAN)
    tally = kill_and_resume(tmp_path / "killed", PLAN, kills, random.Random(3), 0.12)
    assert tally.crashes >= 1
    assert tally.lost == 0
    assert equal_matrices(tmp_path / "calm", tmp_path / "killed")


@pytest.mark.skipif(bool(why_no_power_cut()), reason=why_no_power_cut() or "possible")
def test_power_cut_loses_nothing_acknowledged(tmp_path: Path) -> None:
    tally = power_cuts(tmp_path, PLAN, 1, random.Random(4), 0.2, 64 << 20)
    assert tally.acknowledged > 0
    assert (tally.unreadable, tally.lost) == (0, 0)
