"""Which mutants are made: of files that have tests of their own, all packages and all kinds of mistakes in turn."""

from __future__ import annotations

import random
from dataclasses import dataclass
from functools import cache
from itertools import cycle, islice
from pathlib import Path

from tests.mutants.operators import KINDS, Mutation, mutations

__all__ = ["CORE", "ROOT", "Mutant", "choose", "core_files", "mirror_of"]

ROOT = Path(__file__).resolve().parents[2]

CORE = ("psf", "frames", "simulate", "lattice", "camera", "reconstruct", "multiplex", "campaign", "fit", "targets")
"""Packages that numbers come from."""

PER_FILE = 2
"""Mutants of one file at most."""


@dataclass(frozen=True)
class Mutant:
    """A mistake in a file (path below the root), and the tests that mirror the file."""

    file: str
    tests: str
    mutation: Mutation

    @property
    def name(self) -> str:
        """What it is called in the table, and by who judges it: it stays while the function stays as it is."""
        one = self.mutation
        shorten = " ".join
        return f"{self.file} {one.function}: {shorten(one.before.split())} -> {shorten(one.after.split())}"


def mirror_of(path: Path, root: Path = ROOT) -> Path | None:
    """Return the tests of a file of the library, None where it has none under its own name."""
    below = path.relative_to(root / "lfcal")
    found = root / "tests" / below.parent / f"test_{below.name.removeprefix('_')}"
    return found if found.is_file() else None


def core_files(root: Path = ROOT) -> dict[str, list[Path]]:
    """Return the files of each core package that have tests of their own."""
    found = {
        package: [path for path in sorted((root / "lfcal" / package).rglob("*.py")) if mirror_of(path, root)]
        for package in CORE
    }
    return {package: paths for package, paths in found.items() if paths}


@cache
def _in_file(path: Path) -> tuple[Mutation, ...]:
    return tuple(mutations(path.read_bytes()))


def choose(count: int, seed: int, root: Path = ROOT) -> list[Mutant]:
    """Return ``count`` mutants: packages and kinds take turns, files and places are drawn."""
    rng = random.Random(seed)
    files = core_files(root)
    for paths in files.values():
        rng.shuffle(paths)
    chosen: list[Mutant] = []
    # their numbers have no common factor, so that every package meets every kind
    turns = zip(cycle(files), cycle(KINDS), strict=False)
    for package, kind in islice(turns, 20 * count):
        if len(chosen) == count:
            break
        for path in files[package]:
            name = path.relative_to(root).as_posix()
            possible = [one for one in _in_file(path) if one.kind == kind]
            if possible and sum(one.file == name for one in chosen) < PER_FILE:
                tests = mirror_of(path, root)
                assert tests is not None
                mutant = Mutant(name, tests.relative_to(root).as_posix(), rng.choice(possible))
                if mutant not in chosen:
                    chosen.append(mutant)
                    files[package].append(files[package].pop(files[package].index(path)))
                    break
    return chosen
