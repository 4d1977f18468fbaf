"""Which mutants are made, and which tests belong to a source file; packages and kinds of mistakes take turns."""

from __future__ import annotations

import ast
import random
import re
from collections import defaultdict
from dataclasses import dataclass
from functools import cache
from itertools import cycle, islice
from pathlib import Path

from tests.mutants.operators import KINDS, Mutation, mutations

__all__ = ["CORE", "ROOT", "Mutant", "choose", "closest_tests", "core_files"]

ROOT = Path(__file__).resolve().parents[2]

CORE = ("psf", "frames", "simulate", "lattice", "camera", "reconstruct", "multiplex", "campaign", "fit", "targets")
"""Packages that compute numbers."""

PER_FILE = 2
"""Largest number of mutants of a file."""

MOST_TESTS = 6
"""Largest number of test files that are run for a mutant."""


@dataclass(frozen=True)
class Mutant:
    """A mistake in a file (path below the root), and the test files that belong to this file."""

    file: str
    tests: tuple[str, ...]
    mutation: Mutation

    @property
    def name(self) -> str:
        """Name in the table and in the list of equivalent mutants; it stays the same while the function does."""
        one = self.mutation
        shorten = " ".join
        return f"{self.file} {one.function}: {shorten(one.before.split())} -> {shorten(one.after.split())}"


@cache
def closest_tests(path: Path, root: Path = ROOT) -> tuple[Path, ...]:
    """Return the test files that belong to a file of the library, the closest first; empty: none.

    They are those in ``tests/PACKAGE`` that mention the module or one of its public names. If none does, they are those
    of the modules of its package that import it. A name weighs more in the order if fewer files mention it.
    """
    package = root / "lfcal" / path.relative_to(root / "lfcal").parts[0]
    tests = _files_by_word(root / "tests" / package.name)
    wanted, seen = {path}, {path}
    while wanted:
        weights: dict[Path, float] = defaultdict(float)
        for name in {name for file in wanted for name in _public_names(file)}:
            for file in tests.get(name, ()):
                weights[file] += 1 / len(tests[name])
        if weights:
            return tuple(sorted(weights, key=lambda file: (-weights[file], file)))[:MOST_TESTS]
        modules = {_module(file, root) for file in wanted}
        wanted = {
            file for file in package.rglob("*.py") if file.stem != "__init__" and _imported(file) & modules
        } - seen
        seen |= wanted
    return ()


def core_files(root: Path = ROOT) -> dict[str, list[Path]]:
    """Return the files of each core package that tests belong to."""
    found = {
        package: [path for path in sorted((root / "lfcal" / package).rglob("*.py")) if closest_tests(path, root)]
        for package in CORE
    }
    return {package: paths for package, paths in found.items() if paths}


@cache
def _sources(package: Path) -> list[Path]:
    return [file for file in package.rglob("*.py") if file.stem != "__init__"]


def _module(path: Path, root: Path) -> str:
    return ".".join(path.relative_to(root).with_suffix("").parts)


@cache
def _files_by_word(folder: Path) -> dict[str, list[Path]]:
    """Return the test files of a folder that contain a word, also in their names."""
    found = defaultdict(list)
    for file in sorted(folder.rglob("test_*.py")):
        for word in {file.stem.removeprefix("test_"), *re.findall(r"\w+", file.read_text(encoding="utf-8"))}:
            found[word].append(file)
    return dict(found)


@cache
def _public_names(path: Path) -> frozenset[str]:
    """Return the name of a module and those in its ``__all__``."""
    found = {path.stem.removeprefix("_")}
    for node in ast.parse(path.read_bytes()).body:
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            found |= set(ast.literal_eval(node.value))
    return frozenset(found)


@cache
def _imported(path: Path) -> frozenset[str]:
    """Return the modules that a file imports, and the names that it imports from them as modules."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(found)


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
                tests = tuple(file.relative_to(root).as_posix() for file in closest_tests(path, root))
                mutant = Mutant(name, tests, rng.choice(possible))
                if mutant not in chosen:
                    chosen.append(mutant)
                    files[package].append(files[package].pop(files[package].index(path)))
                    break
    return chosen
