"""The committed table lists the hard cases as they are."""

from __future__ import annotations

from tests.hard_cases.record import load_cases
from tests.hard_cases.table import COLUMNS, PAGE


def test_the_page_lists_every_case_with_its_bound():
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    found = {cells[0]: cells for cells in ([c.strip() for c in line.strip("|").split("|")] for line in lines)}
    found.pop(COLUMNS[0])
    cases = load_cases()
    assert set(found) == set(cases), "run python -m tests.hard_cases.table"
    for name, case in cases.items():
        _, wrong, measure, figure, bound = found[name]
        assert (wrong, measure, bound) == (case.wrong, case.measure, f"{case.bound:g}")
        assert float(figure) <= case.bound
