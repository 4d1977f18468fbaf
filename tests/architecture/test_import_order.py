"""Any module can be the first one that is imported, and several threads can import different ones at once."""

from __future__ import annotations

import os
import random
import subprocess
import sys

import pytest

from tests.architecture.sources import MODULES, ROOT
from tests.architecture.test_house import circles, runtime_imports

PARTS = 120
OUTSIDE = ("lfcal.__main__", "lfcal.cli", "lfcal.napari", "lfcal_gui")
"""Modules of the command line, of other programs and of Qt, which other libraries let only one thread import."""

FIRST = """
import importlib, os, sys
import numpy.typing, scipy.optimize, scipy.ndimage, h5py
failed = 0
for name in sys.argv[1:]:
    process = os.fork()
    if not process:
        try:
            importlib.import_module(name)
        except BaseException as error:
            print(f"{name}: {error!r}", flush=True)
            os._exit(1)
        os._exit(0)
    failed |= os.waitpid(process, 0)[1]
sys.exit(failed != 0)
"""

AT_ONCE = """
import importlib, sys, threading
sys.setswitchinterval(1e-5)
start, failed = threading.Barrier(len(sys.argv) - 1), []
def load(name):
    start.wait()
    try:
        importlib.import_module(name)
    except BaseException as error:
        failed.append(f"{name}: {error!r}")
threads = [threading.Thread(target=load, args=(name,)) for name in sys.argv[1:]]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(*failed, sep="\\n")
sys.exit(bool(failed))
"""


def run(code: str, names: list[str]) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    return subprocess.run(
        [sys.executable, "-c", code, *names], capture_output=True, text=True, cwd=ROOT, env=environment
    )


def test_no_cycle_when_modules_are_imported() -> None:
    """Packages and their faces included: a cycle is a deadlock as soon as two threads enter it at different places."""
    assert circles({name: runtime_imports(name) for name in MODULES}) == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_any_module_can_be_the_first(part: int) -> None:
    names = sorted(name for name in MODULES if not name.endswith("__main__"))
    random.Random(0).shuffle(names)
    done = run(FIRST, names[part::PARTS])
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(60))
def test_eight_threads_import_at_once(seed: int) -> None:
    rng = random.Random(seed)
    package = ("lfcal.simulate", "lfcal.psf", "lfcal.frames", "lfcal.fit", "lfcal.reconstruct", "lfcal.")[seed % 6]
    names = sorted(name for name in MODULES if name.startswith(package) and not name.startswith(OUTSIDE))
    done = run(AT_ONCE, rng.sample(names, 8))
    assert done.returncode == 0, done.stdout + done.stderr
