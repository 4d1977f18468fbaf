"""The common ground: parts of the library loaded when asked for, kernels compiled at their first call, registries."""

from __future__ import annotations

import gc
import os
import pkgutil
import pydoc
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import lfcal
from lfcal.base import full_version
from lfcal.base.compiled import Kernel, kernel_input, njit, preparing_seconds
from lfcal.base.errors import InputError, LfcalError, StorageError
from lfcal.base.registry import Registry
from tests.distribution import install


def test_parts_are_loaded_when_they_are_asked_for() -> None:
    code = "import sys, lfcal; assert 'lfcal.psf' not in sys.modules; print(lfcal.psf.PSFMatrix.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "PSFMatrix"
    assert {"camera", "frames", "psf", "simulate", "acquire"} <= set(dir(lfcal))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = lfcal.nothing


def test_the_top_level_has_the_ten_names_and_says_what_each_package_is_for() -> None:
    names = (
        "Projector ScanPlan assemble fit_camera inspect open_frames open_psf preset read_camera simulate_psf".split()
    )
    packages = {part.name for part in pkgutil.iter_modules(lfcal.__path__) if part.ispkg}
    assert lfcal.__all__ == names and set(dir(lfcal)) == {*names, *packages, "__version__"}
    assert all(callable(getattr(lfcal, name)) for name in names)
    shown = pydoc.render_doc(lfcal, renderer=pydoc.plaintext)
    assert not [name for name in (*names, *packages) if f"``{name}``" not in str(lfcal.__doc__)]
    assert all(f"class {name}" in shown or f"{name}(" in shown for name in names)


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run([sys.executable, "-m", "lfcal", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"lfcal {full_version()}"


@njit()
def _square(x: float) -> float:
    return x * x


@njit()
def sum_of_squares(values: np.ndarray) -> float:
    """Add the squares."""
    total = 0.0
    for v in values:
        total += _square(v)
    return total


def test_kernels_compile_at_their_first_call_and_call_each_other() -> None:
    kernel = sum_of_squares
    assert isinstance(kernel, Kernel) and kernel.__doc__ == "Add the squares."
    assert kernel(np.arange(4.0)) == 14.0
    assert kernel.compiled().nopython_signatures, "it was compiled, not interpreted"


RECORDED = """
from typing import NamedTuple
import numpy as np
from lfcal.base import full_version
from lfcal.base.compiled import njit
class {name}(NamedTuple):
    first: float
    second: float
@njit()
def ratio(record):
    return record.first / record.second
print(ratio({name}(6.0, 3.0)))
"""


@pytest.mark.long
def test_a_cache_of_an_earlier_version_is_made_anew(tmp_path: Path) -> None:
    """A record that was renamed since must not end every call, as numba alone would let it."""
    module = tmp_path / "kernels_of_a_version.py"

    def run(name: str) -> subprocess.CompletedProcess[str]:
        module.write_text(RECORDED.format(name=name))
        # -B: Python's own cache takes a file that changed within a second, and not in size, for the one it was
        code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import kernels_of_a_version"
        return subprocess.run([sys.executable, "-B", "-c", code], capture_output=True, text=True)

    assert run("Pair").stdout.strip() == "2.0"
    assert list(tmp_path.rglob("*.nbi")), "the kernel was cached"
    again = run("Twin")
    assert again.returncode == 0 and again.stdout.strip() == "2.0", again.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no limits on file sizes")
def test_a_kernel_runs_where_its_cache_cannot_be_written(tmp_path: Path) -> None:
    """The disk of the program is full: the user's own may have room."""
    (tmp_path / "kernels_without_cache.py").write_text(RECORDED.format(name="Pair"))
    code = f"""
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
sys.path.insert(0, {str(tmp_path)!r})
import kernels_without_cache
"""
    # -B: a compiled module cut short by the limit would end every program that loads it from then on
    done = subprocess.run([sys.executable, "-B", "-c", code], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.strip() == "2.0", done.stderr
    assert not list(tmp_path.rglob("*.nb?"))


def test_errors_say_what_was_expected() -> None:
    error = InputError.expected("gap", "a length", -3, "correct it")
    assert str(error) == "gap: expected a length, got -3; correct it"
    assert isinstance(error, InputError) and isinstance(StorageError.expected("a", "b", "c", "d"), LfcalError)


@dataclass(frozen=True)
class Part:
    name: str
    rank: int = 0


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    name = "kinds_" + "".join(c for c in tmp_path.name if c.isalnum())  # modules are loaded once in a process
    folder = tmp_path / name
    folder.mkdir()
    (folder / "__init__.py").write_text("PART = 'not searched'\n")
    head = "from tests.architecture.test_ground import Part\n"
    (folder / "one.py").write_text(f"{head}PART = Part('one', 2)\n")
    (folder / "more.py").write_text(f"{head}PART = (Part('two', 1), Part('three', 3))\n")
    (folder / "_private.py").write_text(f"{head}PART = Part('hidden')\n")
    (folder / "nothing.py").write_text("X = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    return name


def test_parts_are_found_in_modules_and_distributions(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = (
        "from tests.architecture.test_ground import Part\nGOOD = Part('four')\nCLASH = Part('one', 9)\nBAD = object()\n"
    )
    point = "four = others:GOOD\nclash = others:CLASH\nbad = others:BAD\ngone = others:MISSING"
    install(monkeypatch, tmp_path, "others", source, {"lfcal.kinds": point})
    found: Registry[Part] = Registry("kind", package, "PART", "lfcal.kinds", order=lambda part: part.rank)
    assert found.names() == ("four", "two", "one", "three"), "in order; private modules are not searched"
    assert found.get("one").rank == 2, "others cannot hide lfcal's own"
    assert set(found.failures()) == {"bad", "gone"} and "expected a part with a name" in found.failures()["bad"]
    assert "two" in found and len(found) == 4 and [part.name for part in found][1] == "two"
    with pytest.raises(InputError, match="kind: expected four, two, one or three, got 'five'; choose one of these"):
        found.get("five")


def test_two_parts_of_one_name_are_a_mistake_of_ours(package: str, tmp_path: Path) -> None:
    (tmp_path / package / "again.py").write_text(
        "from tests.architecture.test_ground import Part\nPART = Part('one')\n"
    )
    with pytest.raises(ValueError, match="two kinds are called 'one'"):
        Registry("kind", package, "PART", "lfcal.kinds").names()


def test_time_for_kernels_is_counted_once() -> None:
    """Of a kernel and one that it calls: no more than the thread's own time, and nothing once they are there."""
    start, before = time.thread_time(), preparing_seconds()
    assert outer(3.0) == 10.0
    spent, taken = preparing_seconds() - before, time.thread_time() - start
    assert 0 < spent <= taken
    again = preparing_seconds()
    assert outer(4.0) == 17.0
    assert preparing_seconds() == again
    assert outer(4) == 17  # another kind of arguments is compiled anew
    assert preparing_seconds() > again


@njit(cache=False)
def inner(x: float) -> float:
    return x * x


@njit(cache=False)
def outer(x: float) -> float:
    return inner(x) + 1


@njit(cache=False)
def added(values: NDArray[np.float64]) -> float:
    total = 0.0
    for value in values:
        total += value
    return total


def test_a_kernel_is_compiled_once_for_arrays_of_every_kind() -> None:
    """Frozen, transposed, a part of another array: each is a separate type for numba."""
    frozen = np.arange(6.0)
    frozen.setflags(write=False)
    for array in (np.arange(6.0), frozen, np.arange(12.0)[::2] / 2):
        assert added(kernel_input(array)) == 15.0
    assert len(added.compiled().signatures) == 1
    own = np.arange(6.0)
    assert np.shares_memory(own, kernel_input(own)) and own.flags.writeable, "neither copied nor frozen"


def test_no_garbage_is_collected_while_a_kernel_is_compiled() -> None:
    from numba.core import event
    from numba.core.errors import TypingError

    @njit(cache=False)
    def doubled(x: float) -> float:
        return 2 * x

    found = []

    class Listener(event.Listener):
        def on_start(self, _: object) -> None:
            found.append(gc.isenabled())

        def on_end(self, _: object) -> None:
            pass

    assert gc.isenabled()
    with event.install_listener("numba:compile", Listener()):
        assert doubled(2.0) == 4.0
        assert gc.isenabled()
        with pytest.raises(TypingError):
            doubled(None)  # type: ignore[arg-type]
    assert found == [False, False] and gc.isenabled(), "after a failure, too"
