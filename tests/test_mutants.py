"""Mutants change code only, are the same for a seed, and are listed with their outcomes."""

from __future__ import annotations

import ast
import json

import pytest

from tests.mutants.choosing import CORE, ROOT, Mutant, choose, closest_tests, core_files
from tests.mutants.operators import KINDS, Mutation, mutated, mutations
from tests.mutants.page import JUDGED, Outcome, page
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


def test_every_kind_of_mistake_is_found() -> None:
    found = changed()
    assert found[("comparison", "<")] == "<=" and found[("arithmetic", "*")] == "/"
    assert found[("constant", "2.5")] == "5.0" and found[("constant", "6")] == "7"
    assert found[("sign", "-y")] == "y" and found[("axes", "1")] == "0" and found[("axes", "y, x")] == "x, y"
    assert found[("off by one", "x")] in ("x + 1", "(x) - 1") and found[("call", "min")] == "max"
    assert found[("condition", "not y")] == "(y)" and found[("condition", "and")] == "or"
    assert found[("dropped", "store.append(k)")] == "pass"
    assert {kind for kind, _ in found} == set(KINDS)


def test_texts_and_types_are_not_changed() -> None:
    places = {one.line for one in mutations(SOURCE)}
    assert places.isdisjoint({2, 3, 5, 7}), "docstrings, the module's own values, messages"
    assert not {before for _, before in changed()} & {"5", "7"}, "types"


def test_a_mutant_is_a_program_of_the_same_number_of_lines() -> None:
    for one in mutations(SOURCE):
        after = mutated(SOURCE, one)
        assert after != SOURCE and after.count(b"\n") == SOURCE.count(b"\n")
        ast.parse(after)


@pytest.mark.long
def test_the_choice_depends_on_the_seed_and_covers_all_packages_and_kinds() -> None:
    first, again, other = choose(20, 1), choose(20, 1), choose(20, 2)
    assert first == again != other and len(set(first)) == 20
    assert len({one.file.split("/")[1] for one in first}) == len(CORE)
    assert len({one.mutation.kind for one in first}) == len(KINDS)
    for mutant in first:
        assert mutant.tests and all((ROOT / file).is_file() for file in mutant.tests)
        source = (ROOT / mutant.file).read_bytes()
        assert source[mutant.mutation.start : mutant.mutation.stop].decode() == mutant.mutation.before


def test_the_closest_tests_a_module_mention_its_names_or_those_of_its_users() -> None:
    def named(file: str) -> list[str]:
        return [found.stem for found in closest_tests(ROOT / "lfcal" / file)]

    assert named("psf/aperture/shape.py")[0] == "test_aperture", "the file that mentions most of its names is first"
    assert "test_matrix" in named("psf/_travel.py"), "a private module is tested through the modules that use it"
    assert sum(map(len, core_files().values())) > 450, "nearly all modules have tests that belong to them"


def mutant(before: str, after: str) -> Mutant:
    return Mutant("lfcal/psf/cutout.py", ("tests/psf/test_cutout.py",), Mutation("sign", "f", 7, 0, 1, before, after))


@pytest.mark.parametrize("reason", ["", "it is symmetric"])
def test_the_page_lists_outcomes_and_counts_the_first_ones(reason: str) -> None:
    judged = {mutant("c", "d").name: reason} if reason else {}
    text = page(
        [
            Outcome(mutant("a | b", "b"), Verdict("survived", 1.0), Verdict("killed", 1.0, "test_seen")),
            Outcome(mutant("x", "y"), Verdict("hangs", 1.0), Verdict("hangs", 1.0)),
            Outcome(mutant("c", "d"), Verdict("survived", 1.0), Verdict("survived", 1.0)),
        ],
        seed=5,
        judged=judged,
    )
    assert "| `psf/cutout.py:7` | sign | `a \\| b` → `b` | killed by `test_seen` |" in text
    assert f"**survives**: {reason or 'a test is missing'} |" in text
    assert "killed 1 of 3 mutants (33 %) at the first run" in text and "--seed 5" in text
    assert "they kill 2" in text and f"No test can detect {len(judged)} of" in text


def test_equivalent_mutants_have_reasons() -> None:
    judged = json.loads(JUDGED.read_text(encoding="utf-8"))
    assert all(name.startswith("lfcal/") and " -> " in name and len(why) > 15 for name, why in judged.items())
