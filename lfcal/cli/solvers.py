"""``lfcal solvers``: list solvers for volumes, including those from other packages."""

from __future__ import annotations

from lfcal.cli._console import print_result, report
from lfcal.cli._options import JsonOption


def command(*, json: JsonOption = False) -> None:
    """List the solvers of `lfcal reconstruct`, including those from other packages.

    Example: `lfcal solvers`
    """
    from lfcal.reconstruct import SOLVERS

    for reason in SOLVERS.failures().values():
        report(f"left out: {reason}")
    found = [{"name": solver.name, "title": solver.title} for solver in SOLVERS]
    print_result(found, ["solver", "what it does"], [list(one.values()) for one in found], json=json)
