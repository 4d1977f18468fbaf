"""Tables of the site list every part of their registry, and pages name tables that exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs_build.tables import TABLES, commands, options_table, table
from lfcal.accuracy import PARTS
from lfcal.devices.registry import BACKENDS
from lfcal.fit import GROUPS
from lfcal.judge import FAULTS
from lfcal.judge.quality import METRICS
from lfcal.reconstruct import SOLVERS
from lfcal.simulate.effects import CATALOGUE

DOCS = Path(__file__).parents[2] / "docs"


def first_column(name: str, column: int = 0) -> list[str]:
    rows = TABLES[name]().splitlines()[2:]
    return [row.strip("| ").split(" | ")[column].strip("`") for row in rows]


@pytest.mark.parametrize(
    ("name", "column", "wanted"),
    [
        ("faults", 1, [fault.name for fault in FAULTS]),
        ("solvers", 0, [solver.name for solver in SOLVERS]),
        ("effects", 1, [effect.name for effect in CATALOGUE]),
        ("unknowns", 0, [group.name for group in GROUPS]),
        ("devices", 0, [backend.name for backend in BACKENDS]),
        ("parts", 0, list(PARTS.names())),
    ],
)
def test_a_table_lists_every_part_in_its_order(name: str, column: int, wanted: list[str]) -> None:
    assert first_column(name, column) == wanted


def test_metrics_are_listed_with_limits_and_cost() -> None:
    rows = TABLES["metrics"]().splitlines()[2:]
    assert len(rows) == len(list(METRICS))
    spec = METRICS.get("snr")
    (row,) = (row for row in rows if row.startswith(f"| {spec.title} |"))
    assert f"| ≥ {spec.limits.good:g} | < {spec.limits.bad:g} | {spec.cost.at_bad:g} | {spec.meaning}" in row


def test_every_command_is_listed_with_its_options() -> None:
    names = [name for name, _ in commands()]
    assert {"lfcal plan fit", "lfcal fit check", "lfcal multiplex views", "lfcal assemble"} <= set(names)
    page = options_table()
    for name, command in commands():
        assert f"### {name} {{ #{name.replace(' ', '-')} }}" in page
        section = page.partition(f"### {name} {{")[2].partition("\n### ")[0]
        for option in command.params:
            assert f"`{option.opts[0]}`" in section or f"`{option.name.upper()}`" in section, (name, option.name)


def test_the_option_of_a_flag_that_is_on_states_what_it_turns_off() -> None:
    assert "| `--no-pack` |  | Do not compress the finished recording. |" in options_table()


def test_cells_are_kept_whole() -> None:
    assert table(("a", "b"), [("x | y", "two\nlines")]) == "| a | b |\n| --- | --- |\n| x \\| y | two lines |"


def test_pages_name_tables_that_exist_and_use_each_once() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md"))
    assert sorted(re.findall(r"<!-- table: (\w+) -->", pages)) == sorted(TABLES)
    # readers of the page itself, in the window or a repository, see where else the table is
    assert pages.count("<!-- table: ") == pages.count(" -->\n*The site shows a table here; ")
