"""Tests in random order: ``--shuffle SEED``. The seed is printed, and the same seed gives the same order."""

from __future__ import annotations

import random
from collections.abc import Callable, Hashable
from typing import TypeVar

import pytest

__all__ = ["header", "shuffle", "shuffled"]

T = TypeVar("T")


def header(seed: int | None) -> list[str]:
    """Return a line on the order of a run."""
    return [] if seed is None else [f"order: --shuffle {seed}"]


def shuffle(items: list[pytest.Item], seed: int) -> None:
    """Shuffle the modules, and the tests in each module; variants of one test stay together.

    Variants share the fixtures of a module, which would otherwise be made again for each.
    """
    items[:] = shuffled(items, seed, lambda item: item.nodeid.partition("::")[0], _function)


def _function(item: pytest.Item) -> str:
    return item.nodeid.partition("[")[0]


def shuffled(items: list[T], seed: int, *levels: Callable[[T], Hashable]) -> list[T]:
    """Return ``items`` with the groups of each level shuffled within the groups of the level above."""
    if not levels:
        return items
    level, *finer = levels
    groups: dict[Hashable, list[T]] = {}
    for item in items:
        groups.setdefault(level(item), []).append(item)
    keys = list(groups)
    # the seed includes the names, so that modules with equal numbers of tests have different orders
    random.Random(f"{seed} {keys}").shuffle(keys)
    return [item for key in keys for item in shuffled(groups[key], seed, *finer)]
