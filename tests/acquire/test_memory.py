"""Memory stays flat over 10,000 positions, measured in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

CODE = """
import json, os, sys
from pathlib import Path
from lfcal.acquire.live_quality import LiveQuality
from lfcal.acquire.preview import Preview
from lfcal.acquire.schedule import window_shape
from lfcal.acquire.session import iter_record
from tests.acquire.rigs import CAREFUL, rig_for, small_plan

page = os.sysconf("SC_PAGE_SIZE")
plan = small_plan((50, 50), 4, cutout=(41, 41), shape=(150, 150))
quality = LiveQuality(plan, window_shape(plan, CAREFUL))
found = []
for progress in iter_record(Path(sys.argv[1]) / "s", plan, rig_for(plan), CAREFUL, preview=Preview(),
                            observers=(quality,)):
    if progress.done % 250 == 0:
        resident = int(open("/proc/self/statm").read().split()[1]) * page
        found.append((progress.done, resident))
print(json.dumps(found))
"""


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident memory is read from /proc")
@pytest.mark.long
def test_memory_is_flat_over_ten_thousand_positions(tmp_path: Path) -> None:
    quick = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=quick if os.access(quick, os.W_OK) else tmp_path) as folder:
        child = subprocess.run(
            [sys.executable, "-c", CODE, folder],
            cwd=Path(__file__).parents[2],
            capture_output=True,
            text=True,
            timeout=300,
        )
    assert child.returncode == 0, child.stderr
    done, resident = np.array(json.loads(child.stdout), float).T
    assert done[-1] == 10_000
    later = done >= 1000  # after the first tables and buffers have been made
    slope = np.polyfit(done[later], resident[later], 1)[0] * 1000
    assert slope < 1e6, f"{slope / 1e6:.2f} MB per 1,000 positions"
