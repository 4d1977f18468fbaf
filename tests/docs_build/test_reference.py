"""The reference has every public name of the library, on the page of its package."""

from __future__ import annotations

import types
from functools import cache
from pathlib import Path

import pytest

import lfcal.camera
import lfcal.psf
from docs_build.reference import Package, packages, page_of

ROOT = Path(__file__).parents[2]


@cache
def found() -> dict[str, Package]:
    """Return the packages by name: not while tests are collected, which every worker does."""
    return {one.name: one for one in packages(ROOT)}


def test_every_public_name_is_on_a_page() -> None:
    shown = {name for one in found().values() for module in one.modules for name in module.public}
    for package in (lfcal.camera, lfcal.psf):
        values = {name: getattr(package, name) for name in package.__all__}
        assert not {name for name, value in values.items() if isinstance(value, type | types.FunctionType)} - shown


def test_a_name_is_on_one_page() -> None:
    shown = [f"{module.name}.{name}" for one in found().values() for module in one.modules for name in module.public]
    assert len(shown) == len(set(shown))


def test_what_a_package_exports_is_documented_where_it_is_defined() -> None:
    for package in (lfcal.camera, lfcal.psf):
        for name in package.__all__:
            value = getattr(package, name)
            if isinstance(value, type | types.FunctionType):
                places = [m for one in found().values() for m in one.modules if m.name == value.__module__]
                assert any(name in module.public for module in places), (value.__module__, name)


def test_a_page_names_modules_and_what_they_make_public() -> None:
    page = page_of(found()["lfcal.psf"])
    assert page.startswith("# lfcal.psf\n") and "::: lfcal.psf._transpose\n" in page
    assert '"transpose"' in page and "`open_psf`" in page and "PlaneSource" not in page
    assert found()["lfcal.psf"].page == "reference/lfcal.psf.md" and found()["lfcal.psf"].summary == "The PSF matrix H."


def test_derived_functions_are_public() -> None:
    module = next(m for m in found()["lfcal.fit"].modules if m.name == "lfcal.fit.fit")
    assert {"fit_camera", "iter_fit_camera"} <= set(module.public)


def test_derived_functions_are_shown_as_functions(tmp_path: Path) -> None:
    griffe = pytest.importorskip("griffe", reason="the group of packages that build the documentation is not installed")
    (tmp_path / "adding").mkdir()
    (tmp_path / "adding" / "__init__.py").write_text(SOURCE, encoding="utf-8")
    extensions = griffe.load_extensions("dataclasses", str(ROOT / "docs_build" / "drained.py"))
    made = griffe.load("adding", search_paths=[tmp_path], extensions=extensions, docstring_parser="numpy")
    add, count = made["add"], made["count"]
    assert [(one.name, one.default) for one in add.parameters] == [
        ("a", None),
        ("b", "1"),
        ("on_progress", "None"),
    ]
    assert (str(add.returns), str(count.returns)) == ("int", "list[int]")
    assert [(one.name, one.default) for one in made["solve"].parameters] == [
        ("P", None),
        ("image", None),
        ("iterations", "20"),
        ("weights", "None"),
        ("on_progress", "None"),
    ]
    assert [section.kind.value for section in add.docstring.parsed] == ["text", "raises", "examples"]


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


def test_a_function_with_the_fields_of_a_record_is_shown_with_their_help() -> None:
    griffe = pytest.importorskip("griffe", reason="the group of packages that build the documentation is not installed")
    extensions = griffe.load_extensions("dataclasses", str(ROOT / "docs_build" / "drained.py"))
    made = griffe.load("lfcal.tasks", search_paths=[ROOT], extensions=extensions, docstring_parser="numpy")
    function = made["assembly.assemble"]
    section = next(one for one in function.docstring.parsed if one.kind.value == "parameters")
    assert {one.name for one in section.value} == {one.name for one in function.parameters}


def test_fields_of_records_are_shown_with_their_help(tmp_path: Path) -> None:
    griffe = pytest.importorskip("griffe", reason="the group of packages that build the documentation is not installed")
    (tmp_path / "given").mkdir()
    (tmp_path / "given" / "__init__.py").write_text(RECORD, encoding="utf-8")
    extensions = griffe.load_extensions("dataclasses", str(ROOT / "docs_build" / "drained.py"))
    made = griffe.load("given", search_paths=[tmp_path], extensions=extensions, docstring_parser="numpy")
    found = {name: (str(one.value), one.docstring.value) for name, one in made["Outer"].members.items()}
    assert found == {"frames": ("None", "The frames. (px; required)"), "inner": ("Inner()", "Storage")}
    assert made["Inner.share"].docstring.value == "A share. (> 0; < 1)" and str(made["Inner.share"].value) == "0.5"
