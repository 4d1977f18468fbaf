"""The full figures of crash safety: ``python -m tests.acquire.crash_figures [--kills 30] [--cuts 20]``.

Kills a recording program at random times, resuming after each, and compares H with that of an undisturbed
run; where root and loop devices exist, cuts a file system off while a session records into it.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import tempfile
from pathlib import Path

from tests.acquire.crashing import Tally, equal_matrices, kill_and_resume, power_cuts, undisturbed, why_no_power_cut
from tests.acquire.rigs import small_plan

PLAN = small_plan((40, 50), 6, cutout=(101, 101), shape=(200, 220))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--cuts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=None, help="where to work; a temporary folder by default")
    given = parser.parse_args()
    work = Path(tempfile.mkdtemp(prefix="crash-", dir=given.folder))
    rng = random.Random(given.seed)
    try:
        print(json.dumps(kills(work, given.kills, rng)), flush=True)
        reason = why_no_power_cut()
        print(json.dumps({"power cuts": reason} if reason else cuts(work, given.cuts, rng)), flush=True)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def kills(work: Path, count: int, rng: random.Random) -> dict[str, object]:
    undisturbed(work / "calm", PLAN)
    tally = kill_and_resume(work / "killed", PLAN, count, rng, 0.4)
    equal = equal_matrices(work / "calm", work / "killed")
    found = {"kill -9": tally.crashes, "positions": PLAN.n_positions, "H equal to that of an undisturbed run": equal}
    return {**found, **lost(tally)}


def cuts(work: Path, count: int, rng: random.Random) -> dict[str, object]:
    tally = power_cuts(work, PLAN, count, rng, 2.0, 600 << 20)
    return {"power cuts": tally.crashes, "files that open": tally.crashes - tally.unreadable, **lost(tally)}


def lost(tally: Tally) -> dict[str, object]:
    return {"frames acknowledged": tally.acknowledged, "acknowledged frames lost": tally.lost}


if __name__ == "__main__":
    main()
