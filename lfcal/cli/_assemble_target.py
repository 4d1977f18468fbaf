"""H of a target that was just recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

__all__ = ["finish_target"]


def finish_target(out: Path, assemble: Path | None, pack: bool, quiet: bool) -> dict[str, Any]:
    """Assemble H of the points that show positions, and pack the recording, as asked for; return what came of it."""
    from lfcal.cli._acquire_outcome import finish
    from lfcal.cli._console import run_work
    from lfcal.tasks import AssembleTarget

    result: dict[str, Any] = {}
    if assemble is not None:
        # holes that are missing, or beside their places, leave positions that nothing showed: not strict
        (made,) = run_work(AssembleTarget(frames=out, out=assemble).work(), quiet=quiet)
        with made.report.matrix as matrix:
            saturated = made.report.saturated
            result = {"H": assemble, "shape": matrix.shape, "saturated_positions": saturated, "target": made.facts}
    return result | finish(out, None, pack, quiet)
