"""Every fault that inspection knows stands in the atlas of the documentation, with its picture and its remedy."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from lfcal.judge import FAULTS
from tests.judge.atlas import DOCS, IMAGES, INJECTIONS, PAGE, found_of, parts

REMEDY = "make it with python -m tests.judge.atlas"
LARGEST = 40_000


@pytest.fixture(scope="module")
def page() -> str:
    return (DOCS / PAGE).read_text(encoding="utf-8")


def test_every_fault_is_put_in() -> None:
    assert set(INJECTIONS) == {fault.name for fault in FAULTS}, "add it to tests/inspect/injections.py"


@pytest.mark.parametrize("name", INJECTIONS)
def test_a_fault_s_chapter_is_up_to_date(page: str, name: str) -> None:
    chapters = re.split(r"\n(?=## )", page)
    own = [text for text in chapters if f"`{name}`." in text]
    assert len(own) == 1, REMEDY
    for line in parts(FAULTS.get(name)):
        assert line in own[0], REMEDY
    assert "**Report:**" in own[0] and f"({IMAGES}/{name}.png)" in own[0]


def test_every_chapter_is_that_of_a_fault_in_the_order_of_the_search(page: str) -> None:
    named = re.findall(r"^`(\w+)`\. ", page, re.MULTILINE)
    assert named == [fault.name for fault in FAULTS], REMEDY


def test_every_picture_is_small_and_shown(page: str) -> None:
    pictures = {path.stem: path for path in (DOCS / IMAGES).glob("*")}
    assert set(pictures) == set(INJECTIONS), REMEDY
    assert all(path.suffix == ".png" and 2000 < path.stat().st_size < LARGEST for path in pictures.values())


@pytest.mark.long
@pytest.mark.parametrize("name", ["hot_line", "ghost"])
def test_what_is_put_in_is_found(name: str) -> None:
    found, evidence = found_of(name)
    assert found.name == name and found.picture is not None and len(evidence) == 60


def test_the_documentation_leads_to_it() -> None:
    assert f"({PAGE})" in (Path(DOCS) / "quality.md").read_text(encoding="utf-8")
