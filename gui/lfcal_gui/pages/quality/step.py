"""Inspection as a command. No Qt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lfcal.tasks import Inspect
from lfcal_gui.models import CommandStep, ProjectState, needed_file, options_of, stated_order
from lfcal_gui.pages.quality.model import QualitySettings

__all__ = ["compared", "step"]


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how H is inspected; a fit that is in no folder is not known to a command."""
    psf, chosen = needed_file(project.psf, "H", "PSF"), QualitySettings.of(project)
    given: dict[str, Any] = {"seconds": chosen.seconds, "session": chosen.session or None}
    given["mat_order"] = stated_order(project, psf)
    if chosen.seconds:  # what else concerns the comparison with the camera alone
        given |= {"patterns": chosen.patterns, "fit": chosen.fit if chosen.camera == "saved" else None}
    return CommandStep.of(Inspect(source=Path(psf), report=Path(out or "report"), **given))


def compared(first: str, second: str, out: str = "", *, by_number: bool = False, mat_order: str = "") -> CommandStep:
    """Return how two H are compared; ``out`` is the folder of a report, if one is written."""
    pairs = (("--report", out), ("--by-number", by_number), ("--mat-order", mat_order))
    a, b = (_opened(path, mat_order) for path in (first, second))
    report = f"    drain(iter_compared_report(found, {out!r}))\n" if out else ""
    python = f"""
from lfcal.base.progress import drain
from lfcal.psf import open_psf
from lfcal.judge import compare
from lfcal.judge.report.two import iter_compared_report, verdict

with {a} as a, {b} as b:
    found = compare(a, b, by_number={by_number!r})
    print(verdict(found))
{report}"""
    return CommandStep(("compare", first, second, *options_of(pairs)), python)


def _opened(path: str, mat_order: str) -> str:
    order = f", mat_order={mat_order!r}" if mat_order and path.lower().endswith(".mat") else ""
    return f"open_psf({path!r}{order})"
