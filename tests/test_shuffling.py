"""The same seed gives the same order, and variants of a test stay together."""

from __future__ import annotations

import itertools

import pytest

from tests.shuffling import header, shuffled

NAMES = [f"m{m}::t{t}[{v}]" for m in range(6) for t in range(5) for v in range(3)]


def module(name: str) -> str:
    return name.partition("::")[0]


def function(name: str) -> str:
    return name.partition("[")[0]


def runs(values: list[str]) -> int:
    return 1 + sum(a != b for a, b in itertools.pairwise(values))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_modules_and_tests_are_dealt_and_stay_whole(seed: int) -> None:
    order = shuffled(NAMES, seed, module, function)
    assert order == shuffled(NAMES, seed, module, function) != NAMES
    assert sorted(order) == sorted(NAMES)
    assert runs([module(name) for name in order]) == 6 and runs([function(name) for name in order]) == 30
    assert [name[-2] for name in order] == ["0", "1", "2"] * 30, "variants keep their order"
    within = {tuple(function(n)[-1] for n in order if module(n) == f"m{m}")[::3] for m in range(6)}
    assert len(within) > 1, "modules are dealt each in its own way"


def test_seeds_differ() -> None:
    assert shuffled(NAMES, 1, module, function) != shuffled(NAMES, 2, module, function)


def test_the_seed_is_said() -> None:
    assert header(7) == ["order: --shuffle 7"] and header(None) == []
