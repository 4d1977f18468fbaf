"""The reference: public names, tables of registries, and the picture of speeds."""

from __future__ import annotations

import re
import types
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import lfcal.camera
import lfcal.psf
from benchmarks import __path__ as benches
from docs_build.reference import Package, packages, page_of
from docs_build.speed import PAGE, PICTURE, draw, ratios_of, section, short
from docs_build.tables import TABLES, commands, options_table, table
from lfcal.accuracy import PARTS
from lfcal.devices.registry import BACKENDS
from lfcal.fit import GROUPS
from lfcal.judge import FAULTS
from lfcal.judge.quality import METRICS
from lfcal.reconstruct import SOLVERS
from lfcal.simulate.effects import CATALOGUE

ROOT = Path(__file__).parents[2]


@cache
def found() -> dict[str, Package]:
    """Return the packages by name."""
    return {one.name: one for one in packages(ROOT)}


def test_every_public_name_is_on_one_page_where_it_is_defined() -> None:
    modules = [module for one in found().values() for module in one.modules]
    shown = [f"{module.name}.{name}" for module in modules for name in module.public]
    assert len(shown) == len(set(shown))
    for package in (lfcal.camera, lfcal.psf):
        for name in package.__all__:
            value = getattr(package, name)
            if isinstance(value, type | types.FunctionType):
                assert f"{value.__module__}.{name}" in shown
    # functions that are derived from their work are public as well
    assert {"lfcal.fit.fit.fit_camera", "lfcal.fit.fit.iter_fit_camera"} <= set(shown)


def test_a_page_names_modules_and_what_they_make_public() -> None:
    page = page_of(found()["lfcal.psf"])
    assert page.startswith("# lfcal.psf\n") and "::: lfcal.psf._transpose\n" in page
    assert '"transpose"' in page and "`open_psf`" in page and "PlaneSource" not in page
    assert found()["lfcal.psf"].page == "reference/lfcal.psf.md" and found()["lfcal.psf"].summary == "The PSF matrix H."


SOURCE = '''
from collections.abc import Generator
from dataclasses import dataclass, field
from typing import Any
from lfcal.base.progress import Progress, Work, drained
from lfcal.reconstruct.solvers.solver import with_settings

Counting = Generator[Progress, None, list[int]]

def iter_add(a: int, b: int = 1) -> Work[int]:
    """Add.

    Yields
    ------
    Progress
        Once.

    Raises
    ------
    InputError
        If there is nothing to add.
    """

add = drained(
    iter_add,
    """
    Examples
    --------
    >>> add(2)
    3
    """,
)

def iter_count() -> Counting:
    """Count."""

count = drained(iter_count)

@dataclass
class Common:
    weights: Any = field(default=None, kw_only=True)

@dataclass
class Settings(Common):
    iterations: int = 20

@with_settings(Settings)
def iter_solve(P, image, settings: Settings) -> Work[int]:
    """Solve."""

solve = drained(iter_solve)
'''


@pytest.fixture
def load() -> Callable[..., Any]:
    """Return a function that loads a package as the reference does."""
    griffe = pytest.importorskip("griffe", reason="the group of packages that build the documentation is not installed")
    extensions = griffe.load_extensions("dataclasses", str(ROOT / "docs_build" / "drained.py"))

    def loaded(name: str, folder: Path, source: str = "") -> Any:
        if source:
            (folder / name).mkdir()
            (folder / name / "__init__.py").write_text(source, encoding="utf-8")
        return griffe.load(name, search_paths=[folder], extensions=extensions, docstring_parser="numpy")

    return loaded


def test_derived_functions_are_shown_as_functions(load: Callable[..., Any], tmp_path: Path) -> None:
    made = load("adding", tmp_path, SOURCE)
    add, count, solve = made["add"], made["count"], made["solve"]
    shown = [", ".join(f"{one.name}={one.default}" for one in function.parameters) for function in (add, solve)]
    assert shown == [
        "a=None, b=1, on_progress=None",
        "P=None, image=None, iterations=20, weights=None, on_progress=None",
    ]
    assert (str(add.returns), str(count.returns)) == ("int", "list[int]")
    assert [section.kind.value for section in add.docstring.parsed] == ["text", "raises", "examples"]


def test_fields_of_records_are_shown_with_their_help(load: Callable[..., Any], tmp_path: Path) -> None:
    function = load("lfcal.tasks", ROOT)["assembly.assemble"]
    section = next(one for one in function.docstring.parsed if one.kind.value == "parameters")
    assert {one.name for one in section.value} == {one.name for one in function.parameters}
    made = load("given", tmp_path, RECORD)
    fields = {name: (str(one.value), one.docstring.value) for name, one in made["Outer"].members.items()}
    assert fields == {"frames": ("None", "The frames. (px; required)"), "inner": ("Inner()", "Storage")}
    assert made["Inner.share"].docstring.value == "A share. (> 0; < 1)" and str(made["Inner.share"].value) == "0.5"


RECORD = '''
from lfcal.records import opt, panel, record, required

@record
class Inner:
    """Inner."""
    share: float = opt(0.5, "A share.", above=0, below=1)

@record
class Outer:
    """Outer."""
    frames: str = required("The frames.", unit="px")
    inner: Inner = panel(Inner(), "Storage")
'''


# -- tables ------------------------------------------------------------------------------------------------


def rows_of(name: str) -> list[list[str]]:
    """Return the cells of a table, without its head."""
    return [row.strip("| ").split(" | ") for row in TABLES[name]().splitlines()[2:]]


def test_a_table_lists_every_part_in_its_order() -> None:
    for name, column, wanted in (
        ("faults", 1, [fault.name for fault in FAULTS]),
        ("solvers", 0, [solver.name for solver in SOLVERS]),
        ("effects", 1, [effect.name for effect in CATALOGUE]),
        ("unknowns", 0, [group.name for group in GROUPS]),
        ("devices", 0, [backend.name for backend in BACKENDS]),
        ("parts", 0, list(PARTS.names())),
    ):
        assert [row[column].strip("`") for row in rows_of(name)] == wanted, name
    # a title may be followed by what it is counted in
    for row, metric in zip(rows_of("metrics"), METRICS, strict=True):
        assert row[0].startswith(metric.title)
    spec = METRICS.get("snr")
    (row,) = (line for line in TABLES["metrics"]().splitlines() if line.startswith(f"| {spec.title} |"))
    assert f"| ≥ {spec.limits.good:g} | < {spec.limits.bad:g} | {spec.cost.at_bad:g} | {spec.meaning}" in row
    assert table(("a", "b"), [("x | y", "two\nlines")]) == "| a | b |\n| --- | --- |\n| x \\| y | two lines |"


def test_every_command_is_listed_with_its_options() -> None:
    page, all_commands = options_table(), commands()
    names = {"lfcal plan fit", "lfcal fit check", "lfcal multiplex views", "lfcal assemble"}
    assert names <= {name for name, _ in all_commands}
    for name, command in all_commands:
        assert f"### {name} {{ #{name.replace(' ', '-')} }}" in page
        section = page.partition(f"### {name} {{")[2].partition("\n### ")[0]
        for option in command.params:
            assert f"`{option.opts[0]}`" in section or f"`{option.name.upper()}`" in section, (name, option.name)
    # the option of a flag that is on states what it turns off
    assert "| `--no-pack` |  | Do not compress the finished recording. |" in page


DOCS = Path(__file__).parents[2] / "docs"


def test_pages_name_tables_that_exist_and_use_each_once() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in DOCS.rglob("*.md"))
    assert sorted(re.findall(r"<!-- table: (\w+) -->", pages)) == sorted(TABLES)
    # readers of the page itself, in the window or a repository, see where else the table is
    assert pages.count("<!-- table: ") == pages.count(" -->\n*The site shows a table here; ")


# -- speeds ------------------------------------------------------------------------------------------------


def test_every_ratio_of_the_page_on_speed_is_drawn_and_has_a_command(tmp_path: Path) -> None:
    row = "| a, 2 px, 3 % error | 1 | one (scipy): 31 times slower; two: over 5,000 times slower, 9 % off | `x` |"
    ratios = [("a, 2 px, 3 % error", "one (scipy)", 31.0), ("a, 2 px, 3 % error", "two", 5000.0)]
    assert ratios_of(f"# Speed\n\n{row}\n| b | 1 | – | c |\n") == ratios
    assert short("a, 2 px, 3 % error") == "a, 3 % error"
    text = section(PAGE.read_text(encoding="utf-8"))
    assert len(ratios_of(text)) == text.count("times slower") >= 7
    names = {path.stem for path in Path(next(iter(benches))).glob("*.py")}
    for line in [line for line in text.splitlines() if line.startswith("|")][2:]:
        assert re.search(r"`python -m benchmarks (\S+?)[ `]", line)[1] in names, line  # type: ignore[index]
    draw(tmp_path / "speed.png")
    assert (tmp_path / "speed.png").stat().st_size > 10_000 and PICTURE.is_file()
