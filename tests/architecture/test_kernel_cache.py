"""Compiled kernels on disk while other processes save theirs: nobody runs what is another's, or an earlier source's."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.architecture.test_kernels import run

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
