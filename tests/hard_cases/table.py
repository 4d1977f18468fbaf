"""Measure the hard cases and write their table, TABLE.md: ``python -m tests.hard_cases.table``."""

from __future__ import annotations

from pathlib import Path

from tests.hard_cases.record import HardCase, load_cases

__all__ = ["PAGE", "page", "row"]

PAGE = Path(__file__).with_name("TABLE.md")
HEAD = """# Hard cases

Each row is a test in `tests/hard_cases/`, which fails if the value exceeds the bound.
`python -m tests.hard_cases.table` measured the values and wrote this page. `tests/hard_cases/mutants.py` contains a
naive implementation for each row, whose value exceeds the bound.
"""
COLUMNS = ("case", "failure of simple code", "measured quantity", "value", "bound")


def row(case: HardCase, figure: float) -> str:
    """Return the row of a case in the table."""
    return f"| {case.name} | {case.wrong} | {case.measure} | {figure:.2g} | {case.bound:g} |"


def page(cases: dict[str, HardCase]) -> str:
    """Measure all values, and return the page."""
    parts = [HEAD]
    for module in sorted({case.module for case in cases.values()}):
        own = [case for case in cases.values() if case.module == module]
        lines = [row(case, float(case.figure())) for case in own]
        title = module.replace("_", " ").capitalize()
        head = [f"## {title}", "", f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|"]
        parts.append("\n".join([*head, *lines, ""]))
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(load_cases()), encoding="utf-8")
