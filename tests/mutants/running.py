"""A copy of the tree that contains one mutant at a time while its tests run."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.choosing import ROOT, Mutant
from tests.mutants.operators import mutated

__all__ = ["Tree", "Verdict"]

COPIED = ("lfcal", "gui", "benchmarks", "tests", "sample_data", "docs", "docs_build", "packaging", ".ci")
PATIENCE, LEAST_S = 4.0, 180.0
"""A mutant hangs if its tests take longer than this many times the time without it, and longer than this time (s)."""

LONG_S = 3600.0
"""Limit (s) with the long tests, which are run if the quick ones pass."""


@dataclass(frozen=True)
class Verdict:
    """Outcome of a mutant: ``how`` is ``"killed"``, ``"hangs"`` or ``"survived"``; ``by`` is the test that failed."""

    how: str
    seconds: float
    by: str = ""


class Tree:
    """The copy: sources, tests, and the kernels that are already compiled."""

    def __init__(self, place: Path, root: Path = ROOT) -> None:
        self.root = place
        place.mkdir(parents=True, exist_ok=True)
        for name in COPIED:
            if (root / name).is_dir():
                shutil.copytree(root / name, place / name, dirs_exist_ok=True)
        for path in root.glob("*.*"):
            if path.is_file() and path.suffix != ".lock":
                shutil.copy2(path, place / path.name)
        self._base: dict[tuple[str, ...], float] = {}

    def seconds_of(self, tests: tuple[str, ...]) -> float:
        """Return the time (s) of test files without a mutant; they must pass."""
        if tests not in self._base:
            start = time.monotonic()
            code, said = self._run(tests, 3600)
            if code:
                raise RuntimeError(f"{' '.join(tests)}: fails without a mutant: {said[-2000:]}")
            self._base[tests] = time.monotonic() - start
        return self._base[tests]

    def judge(self, mutant: Mutant) -> Verdict:
        """Return the outcome of a mutant."""
        limit = max(LEAST_S, PATIENCE * self.seconds_of(mutant.tests))
        with self._living(mutant):
            start = time.monotonic()
            try:
                code, said = self._run(mutant.tests, limit)
                if code == 0:
                    code, said = self._run(mutant.tests, LONG_S, "--long")
            except subprocess.TimeoutExpired:
                return Verdict("hangs", time.monotonic() - start)
        seconds = time.monotonic() - start
        if code == 0:
            return Verdict("survived", seconds)
        if code not in (1, 2):  # of pytest: a test failed, or the tests could not be imported
            raise RuntimeError(f"{mutant.name}: pytest ended with {code}: {said[-2000:]}")
        failed = [line.split(" - ")[0] for line in said.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return Verdict("killed", seconds, failed[0].rpartition("::")[2] if failed else "import")

    def _run(self, tests: tuple[str, ...], limit: float, *more: str) -> tuple[int, str]:
        words = [sys.executable, "-m", "pytest", "-x", "-n", "0", "-p", "no:randomly", "--tb=no", "-rfE", *more, *tests]
        env = {**os.environ, "PYTHONPATH": str(self.root), "QT_QPA_PLATFORM": "offscreen", "COLUMNS": "300"}
        with tempfile.TemporaryDirectory(prefix="lfcal-mutant-") as scratch:
            done = subprocess.run(
                [*words, f"--basetemp={scratch}/t"],
                cwd=self.root,
                env=env,
                capture_output=True,
                text=True,
                timeout=limit,
            )
        return done.returncode, done.stdout + done.stderr

    @contextmanager
    def _living(self, mutant: Mutant) -> Iterator[None]:
        path = self.root / mutant.file
        source, state = path.read_bytes(), path.stat()
        kept = [(file, file.read_bytes()) for module in self._compiled_with(path) for file in _kernels_of(module)]
        for file, _ in kept:
            file.unlink()
        path.write_bytes(mutated(source, mutant.mutation))
        try:
            yield
        finally:
            path.write_bytes(source)
            os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
            for module in self._compiled_with(path):
                for file in _kernels_of(module):
                    file.unlink()
            for file, content in kept:
                file.write_bytes(content)

    def _compiled_with(self, path: Path) -> set[Path]:
        """Return a file and those that import it, also indirectly, whose compiled kernels may contain its code."""
        imports = {file: _imports(file) for file in (self.root / "lfcal").rglob("*.py")}
        names = {file: ".".join(file.relative_to(self.root).with_suffix("").parts) for file in imports}
        found, new = {path}, {path}
        while new:
            wanted = {names[file] for file in new}
            new = {file for file, imported in imports.items() if imported & wanted} - found
            found |= new
        return found


def _imports(file: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def _kernels_of(module: Path) -> list[Path]:
    return list((module.parent / "__pycache__").glob(f"{module.stem}.*.nb[ic]"))
