"""Spoilt files of every kind, given to every command that reads them: one line each, and nothing left behind."""

from __future__ import annotations

import os
import shutil
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.fuzz import corpus, seeds
from tests.fuzz.attack import Workplace, spoil
from tests.fuzz.guard import Guard
from tests.fuzz.mutators import FAMILIES
from tests.fuzz.targets import TARGETS

pytestmark = pytest.mark.skipif(os.name == "nt", reason="processor time and memory are limited by Unix calls")

LONG_INPUTS = 10_000
"""Taken with --long, for all targets; every run takes one for each fifth target, and the corpus."""

FIRST = int(os.environ.get("LFCAL_FUZZ_FIRST", "0"))
"""Number of the first of them: each number is another input."""

FIFTH = 5
PARTS = 9
"""Of the good files, and of the inputs that failed once: the first part is taken without --long."""
EVERY_PART = [0, *(pytest.param(part, marks=pytest.mark.long) for part in range(1, PARTS))]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("good")
    seeds.make(folder)
    return folder


@pytest.fixture(scope="module")
def workplace(good: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workplace]:
    with _workplace(good, tmp_path_factory.mktemp("work")) as place:
        yield place


class _workplace:
    def __init__(self, good: Path, folder: Path) -> None:
        shutil.copytree(good, folder / "files")
        self._guard = Guard(folder)
        self.place = Workplace(good, folder / "files", self._guard)

    def __enter__(self) -> Workplace:
        return self.place

    def __exit__(self, *_: object) -> None:
        self._guard.__exit__(None, None, None)


@pytest.mark.parametrize("part", EVERY_PART)
def test_good_files_are_accepted(workplace: Workplace, part: int) -> None:
    """One command for each kind of file; else a command that refuses everything would pass."""
    # an inspection, which takes longest, only of what no other command reads
    quick = {target.kind: target for target in TARGETS if target.arguments[0] != "inspect"}
    for target in list(({target.kind: target for target in TARGETS} | quick).values())[part::PARTS]:
        wrong, outcome = workplace.verdict(target, (workplace.good / target.file).read_bytes())
        refused = target.kind == "npz"  # an archive of several arrays is no stack of frames
        assert not wrong and outcome.code == (2 if refused else 0), (target.name, wrong, outcome)


def test_an_input_of_every_fifth_target(workplace: Workplace) -> None:
    found = {}
    for number, target in enumerate(TARGETS[::FIFTH]):
        wrong, outcome = workplace.verdict(target, spoil(target, 0, workplace.good), old=number % 2 == 0)
        if wrong:
            found[target.name] = wrong, outcome.said[:300]
    assert not found


@pytest.mark.parametrize("part", EVERY_PART)
def test_inputs_that_failed_once(workplace: Workplace, part: int) -> None:
    """Each ended in a traceback, a hang, a crash, several lines, or a line of thousands of characters."""
    found = {}
    for name, target, data in list(corpus.cases())[part::PARTS]:
        wrong, outcome = workplace.verdict(target, data, old=True)
        if wrong:
            found[name] = wrong, outcome.said[:300]
    assert not found


def test_there_is_a_corpus_and_it_is_small() -> None:
    assert len({target.kind for _, target, _ in corpus.cases()}) >= 20
    assert sum(path.stat().st_size for path in corpus.FOLDER.rglob("*")) < 300_000


@pytest.mark.parametrize("step", [FIFTH, pytest.param(1, marks=pytest.mark.long)])
def test_names_and_inputs_are_the_same_every_time(good: Path, step: int) -> None:
    assert max(Counter(target.name for target in TARGETS).values()) == 1
    for target in TARGETS[::step]:
        assert target.family in FAMILIES
        assert spoil(target, 3, good) == spoil(target, 3, good)
        assert len({spoil(target, number, good) for number in range(20)}) > 10


@pytest.mark.long
def test_ten_thousand_inputs(good: Path, tmp_path: Path) -> None:
    """Two processes at a time; the counts by kind are printed."""
    each = -(-LONG_INPUTS // len(TARGETS))
    ends: dict[str, Counter[str]] = defaultdict(Counter)
    found = []

    def half(which: int) -> None:
        (tmp_path / str(which)).mkdir()
        with _workplace(good, tmp_path / str(which)) as place:
            for target in TARGETS[which::2]:
                for number in range(FIRST, FIRST + each):
                    wrong, outcome = place.verdict(target, spoil(target, number, good), old=number % 2 == 0)
                    ends[target.kind][f"code {outcome.code}" if not wrong else "wrong"] += 1
                    if wrong:
                        found.append((target.name, number, wrong, outcome.said[:300]))

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(half, range(2)))
    for kind, counts in ends.items():
        print(f"{kind:22s} {dict(sorted(counts.items()))}")
    assert sum(sum(counts.values()) for counts in ends.values()) >= LONG_INPUTS
    assert not found, f"{len(found)} wrong, first {found[:5]}"
