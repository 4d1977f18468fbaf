"""Mutants are made of code alone, the same ones for a seed, and stand in the table of the site as they were judged."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest

from tests.mutants.choosing import CORE, ROOT, Mutant, choose, core_files, mirror_of
from tests.mutants.operators import KINDS, Mutation, mutated, mutations
from tests.mutants.page import JUDGED, page
from tests.mutants.running import Verdict

SOURCE = b'''
"""Docstring of 1 < 2."""
LIMIT = 3 < 4
def f(y: Literal[5], x: int = 6) -> Array[7]:
    """Return 8 < 9."""
    if y < x and not y:
        raise InputError(f"{x + 1} < 2", x - 1)
    total = -y * 2.5
    total += sum(values[1:x], axis=1)
    for k in range(x):
        store.append(k)
    return min(y, x), (y, x)
'''


def changed() -> dict[tuple[str, str], str]:
    return {(one.kind, one.before): one.after for one in mutations(SOURCE)}


def test_every_kind_of_mistake_is_found_where_it_can_be_made() -> None:
    found = changed()
    assert found[("comparison", "<")] == "<=" and found[("arithmetic", "*")] == "/"
    assert found[("constant", "2.5")] == "5.0" and found[("constant", "6")] == "7"
    assert found[("sign", "-y")] == "y" and found[("axes", "1")] == "0" and found[("axes", "y, x")] == "x, y"
    assert found[("off by one", "x")] in ("x + 1", "(x) - 1") and found[("call", "min")] == "max"
    assert found[("condition", "not y")] == "(y)" and found[("condition", "and")] == "or"
    assert found[("dropped", "store.append(k)")] == "pass"
    assert {kind for kind, _ in found} == set(KINDS)


def test_what_only_people_read_is_left_alone() -> None:
    places = {one.line for one in mutations(SOURCE)}
    assert places.isdisjoint({2, 3, 5, 7}), "docstrings, the module's own values, messages"
    assert not {before for _, before in changed()} & {"5", "7"}, "types"


def test_a_mutant_differs_in_one_place_and_is_a_program() -> None:
    for one in mutations(SOURCE):
        after = mutated(SOURCE, one)
        assert after != SOURCE and after.count(b"\n") == SOURCE.count(b"\n")
        ast.parse(after)


def test_the_choice_is_that_of_its_seed_and_spread() -> None:
    first, again, other = choose(20, 1), choose(20, 1), choose(20, 2)
    assert first == again != other and len(set(first)) == 20
    assert len({one.file.split("/")[1] for one in first}) == len(CORE)
    assert len({one.mutation.kind for one in first}) == len(KINDS)
    for mutant in first:
        assert (ROOT / mutant.tests).is_file() and Path(
            mutant.tests
        ).stem == f"test_{Path(mutant.file).stem.removeprefix('_')}"
        source = (ROOT / mutant.file).read_bytes()
        assert source[mutant.mutation.start : mutant.mutation.stop].decode() == mutant.mutation.before


def test_files_without_tests_of_their_own_are_left_out() -> None:
    assert mirror_of(ROOT / "lfcal" / "psf" / "__init__.py") is None
    assert ROOT / "lfcal" / "psf" / "_transpose.py" in core_files()["psf"]


def mutant(before: str, after: str) -> Mutant:
    return Mutant("lfcal/psf/cutout.py", "tests/psf/test_cutout.py", Mutation("sign", "f", 7, 0, 1, before, after))


@pytest.mark.parametrize("reason", ["", "it is symmetric"])
def test_the_page_tells_what_became_of_each(reason: str) -> None:
    judged = {mutant("c", "d").name: reason} if reason else {}
    text = page(
        [
            (mutant("a | b", "b"), Verdict("killed", 1.0, "test_seen")),
            (mutant("x", "y"), Verdict("hangs", 1.0)),
            (mutant("c", "d"), Verdict("survived", 1.0)),
        ],
        seed=5,
        judged=judged,
    )
    assert "| `psf/cutout.py:7` | sign | `a \\| b` → `b` | killed by `test_seen` |" in text
    assert f"**survives**: {reason or 'a test is missing'} |" in text
    assert "**2 of 3 are killed (67 %)**, 1 of them\nbecause the test hangs" in text and "seed 5" in text
    assert f"1 survive. No test can detect {len(judged)} of these" in text


def test_what_was_judged_is_said_in_words() -> None:
    judged = json.loads(JUDGED.read_text(encoding="utf-8"))
    assert all(name.startswith("lfcal/") and " -> " in name and len(why) > 15 for name, why in judged.items())
