"""Tests in another order: ``--shuffle SEED``, which is printed; the same seed gives the same order again."""

from __future__ import annotations

import random
from collections.abc import Callable, Hashable
from typing import TypeVar

import pytest

__all__ = ["header", "shuffle", "shuffled"]

T = TypeVar("T")


def header(seed: int | None) -> list[str]:
    """Return what a run says of its order."""
    return [] if seed is None else [f"order: --shuffle {seed}"]


def shuffle(items: list[pytest.Item], seed: int) -> None:
    """Deal the modules in another order, and in each the tests; variants of one test stay together.

    Variants share what a module prepares for them, which would be made anew for each.
    """
    items[:] = shuffled(items, seed, lambda item: item.nodeid.partition("::")[0], _function)


def _function(item: pytest.Item) -> str:
    return item.nodeid.partition("[")[0]


def shuffled(items: list[T], seed: int, *levels: Callable[[T], Hashable]) -> list[T]:
    """Return ``items`` with the groups of each level in another order, within those of the level before."""
    if not levels:
        return items
    level, *finer = levels
    groups: dict[Hashable, list[T]] = {}
    for item in items:
        groups.setdefault(level(item), []).append(item)
    keys = list(groups)
    # of the names as well: two modules with as many tests are not dealt alike
    random.Random(f"{seed} {keys}").shuffle(keys)
    return [item for key in keys for item in shuffled(groups[key], seed, *finer)]
