"""Record a session and print each acknowledged position on standard output; run by the crash tests as a program.

``python -m tests.acquire.crash_child FOLDER [resume]``; the plan is next to the folder, as ``FOLDER.plan.json``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from lfcal.acquire.options import Options
from lfcal.acquire.recording.records import Kind, Note
from lfcal.acquire.schedule import ScheduledFrame
from lfcal.acquire.session import record
from lfcal.camera import ScanPlan
from lfcal.devices.simulated.backend import simulated_rig


def main() -> None:
    folder = Path(sys.argv[1])
    plan = ScanPlan.from_json(Path(f"{folder}.plan.json").read_text())

    def acknowledge(step: ScheduledFrame, _note: Note, _frame: Any) -> None:
        if step.kind is Kind.POSITION:
            os.write(1, b"%d\n" % step.flat)

    options = Options(darks=0, reference_every=200, keep_free_bytes=0)
    record(folder, plan, simulated_rig(plan), options, resume="resume" in sys.argv[2:], observers=(acknowledge,))


if __name__ == "__main__":
    main()
