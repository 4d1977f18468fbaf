"""Compiled kernels on disk while other processes save theirs: nobody runs what is another's, or an earlier source's."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lfcal.base import compiled, notes_to
from tests.architecture.test_kernels import ROOT, run

KERNEL = "from lfcal.base.compiled import njit\n\n@njit()\ndef first(a):\n    return a[0] + 1\n"

TOGETHER = """
import numpy as np, m
from lfcal.base.compiled import Kernel
whole, half = np.array([7]), np.array([0.5])
one, two, other = (Kernel(m.first.function, {"cache": True, "nogil": True}) for _ in range(3))
file = two.compiled()._cache._cache_file
load, save = file._load_index, file._save_data
seen, read = [], []
def loaded():
    found = load()
    read.append(found)
    if len(read) == 2:  # to save: another process saves its own after the index was read
        seen.append(one(whole))
    return found
def saved(name, data):
    seen.append(other(half))  # a third one needs it before the code is there
    save(name, data)
file._load_index, file._save_data = loaded, saved
seen.append(two(half))
print(*seen)
"""

ORDER = """
import os, m, numpy as np
file = m.first.compiled()._cache._cache_file
keep = file._save_index
def saved(entries):
    print(all(os.path.exists(file._data_path(name)) for name in entries.values()))
    keep(entries)
file._save_index = saved
m.first(np.array([7])); m.first(np.array([0.5]))
"""


BOTH = "import m, numpy as np; print(m.first(np.array([7])), m.first(np.array([0.5])))"
HITS = "; print(sum(m.first.compiled().stats.cache_hits.values()))"


@pytest.mark.long
def test_damaged_code_on_disk_is_compiled_again(tmp_path: Path) -> None:
    """Tests that fixed random numbers once gave two kernels one file: from then on no session could be recorded."""
    (tmp_path / "m.py").write_text(KERNEL, encoding="utf-8")
    fixed = "import uuid, random; one = uuid.UUID(int=7); uuid.uuid4 = lambda: one; random.seed(1)\n"
    assert run(tmp_path, fixed + BOTH) == "8 1.5"
    codes = sorted((tmp_path / "__pycache__").glob("*.nbc"))
    assert len(codes) == 2
    # the code of the one under the name of the other, and both unreadable
    data = [path.read_bytes() for path in codes]
    for path, other in zip(codes, reversed(data), strict=True):
        path.write_bytes(other)
    assert run(tmp_path, BOTH) == "8 1.5"
    assert run(tmp_path, BOTH + HITS) == "8 1.5\n2", "what was compiled again is kept"
    for path in (tmp_path / "__pycache__").glob("*.nbc"):
        path.write_bytes(b"damaged")
    assert run(tmp_path, BOTH) == "8 1.5"


@pytest.mark.long
def test_nobody_runs_code_of_other_arguments(tmp_path: Path) -> None:
    (tmp_path / "m.py").write_text(KERNEL, encoding="utf-8")
    assert run(tmp_path, TOGETHER) == "1.5 8 1.5"
    assert run(tmp_path, BOTH) == "8 1.5"


@pytest.mark.long
def test_an_index_names_only_what_is_there_and_nothing_old_stays(tmp_path: Path) -> None:
    source = tmp_path / "m.py"
    for text in (KERNEL, KERNEL.replace("+ 1", "+ 12"), KERNEL.replace("+ 1", "+ 123")):
        source.write_text(text, encoding="utf-8")
        assert run(tmp_path, ORDER) == "True\nTrue"
        assert len(list(tmp_path.rglob("*.nbc"))) == 2, "of the present source alone"


FOLDERS = """
import numpy, m
from numba.core import caching
from lfcal.cli.doctor import _numba_cache
unusable = UNUSABLE
check = caching._CacheLocator.ensure_cache_path
def checked(self):
    if type(self).__name__ in unusable:
        raise PermissionError
    check(self)
caching._CacheLocator.ensure_cache_path = checked
print(m.first(numpy.array([7])), m.first.compiled().stats.cache_path, _numba_cache(), sep="|")
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("unusable", "kept"), [("InTreeCacheLocator", True), ("InTreeCacheLocator UserWideCacheLocator", False)]
)
def test_kernels_run_where_the_package_cannot_be_written(tmp_path: Path, unusable: str, kept: bool) -> None:
    """Without any writable folder, numba refused to make a kernel."""
    (tmp_path / "m.py").write_text(KERNEL, encoding="utf-8")
    code = FOLDERS.replace("UNUSABLE", repr(unusable.split()))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    environment |= dict.fromkeys(("XDG_CACHE_HOME", "HOME", "LOCALAPPDATA"), str(tmp_path / "home"))
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run([sys.executable, "-B", "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    value, folder, said = done.stdout.strip().split("|")
    assert value == "8"
    assert bool(list((tmp_path / "home").rglob("*.nbc"))) == kept
    assert (str(tmp_path / "home") in folder and str(tmp_path / "home") in said) == kept
    assert ("no folder is writable; set NUMBA_CACHE_DIR" in said) != kept


@pytest.mark.parametrize(("terminal", "lines"), [(True, 1), (False, 0)])
def test_a_person_at_a_terminal_reads_once_why_a_first_run_takes_longer(
    terminal: bool, lines: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    monkeypatch.setattr(compiled, "NOTED_AFTER", 0.0)

    def added(a: int) -> int:
        return a + 1

    said: list[str] = []
    with notes_to(said.append):
        for kind in (1, 1.5, 1):
            kernel = compiled.Kernel(added, {"no_cfunc_wrapper": True})
            assert kernel(kind) == kind + 1
    assert len(said) == lines and all("compiling numerical kernels; they are cached" in line for line in said)
