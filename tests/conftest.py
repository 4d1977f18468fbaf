"""Options and fixtures of all test runs."""

from __future__ import annotations

import gc
import os
import sys
import zlib
from collections import defaultdict
from collections.abc import Iterator

import pytest

from tests.importing import begin_at_the_end
from tests.shuffling import header, shuffle

# Workers and the programs that tests start use compiled modules on disk. Without these, each would compile numba and
# scipy again, which takes longer than all of its other work.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Forecasts of tests, and of the programs that they start, neither read nor write the user's cache.
os.environ["LFCAL_CACHE"] = ""

# With several workers, more threads of BLAS only wait for each other in busy loops: a fit takes an eighth longer.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run the tests that take minutes, and every variant of others")
    parser.addoption("--part", metavar="K/N", help="only part K of N of the tests that --long adds (K from 0)")
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run modules, and the tests in each, in another order")


def pytest_report_header(config: pytest.Config) -> list[str]:
    return header(config.getoption("--shuffle"))


def pytest_cmdline_main(config: pytest.Config) -> None:
    """Assign consecutive tests, which share the fixtures of a module, to each worker; idle workers take over others.

    By default, pytest-xdist distributes tests in turn, and every worker prepares all fixtures.
    """
    asked = any(str(one).startswith("--dist") for one in config.invocation_params.args)
    if getattr(config.option, "dist", "no") == "load" and not asked:
        config.option.dist = "worksteal"


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    gc.disable()  # until `pytest_collection_finish`, because imports produce almost no garbage
    begin_at_the_end(session.config)


def pytest_collection_finish() -> None:
    """Exclude the half million objects of modules and tests, which exist until the end, from garbage collection.

    Objects of tests are also collected less often than by default, where this takes 3 % of the time.
    """
    gc.enable()
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)


@pytest.fixture(scope="session", autouse=True)
def _same_speeds() -> Iterator[None]:
    """Make choices independent of the current speed of this machine."""
    from tests.speeds import same_speeds

    with same_speeds():
        yield


@pytest.fixture(scope="session", autouse=True)
def _compiled_kernels() -> Iterator[None]:
    """Make results independent of the kernels that have been compiled before."""
    from lfcal.base import compiled

    before, compiled.SPARED_S = compiled.SPARED_S, 0.0
    yield
    compiled.SPARED_S = before


@pytest.fixture(scope="session", autouse=True)
def _plain_layouts(pytestconfig: pytest.Config) -> Iterator[None]:
    """Draw figures without measuring their labels; with --long as for users."""
    if pytestconfig.getoption("--long"):
        yield
        return
    from tests.pictures import not_laid_out

    with not_laid_out():
        yield


OTHER_KERNELS = ("lattice", "multiplex", "reconstruct", "psf")
"""Folders whose tests need other kernels than those of simulations, which `accuracy` begins with."""


def begin_with_different_kernels(items: list[pytest.Item]) -> None:
    """Make the second of two workers start in the middle, so that it compiles other kernels than the first.

    If both start with simulations, they compile the same kernels at the same time.
    """

    def place(item: pytest.Item) -> int:
        folder = item.nodeid.removeprefix("tests/").partition("/")[0]
        # packages that precede them in the order of names fill the first half
        return 1 if folder in OTHER_KERNELS else 0 if folder < min(OTHER_KERNELS) and folder != "inspect" else 2

    items.sort(key=place)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    seed = config.getoption("--shuffle")
    if seed is not None:
        shuffle(items, seed)
    begin_with_different_kernels(items)
    part = config.getoption("--part")
    if part:
        chosen, others = split(items, part)
        items[:] = chosen
        config.hook.pytest_deselected(items=others)
    elif not config.getoption("--long"):
        for item, reason in left_out(items).items():
            item.add_marker(pytest.mark.skip(reason=reason))


def left_out(items: list[pytest.Item]) -> dict[pytest.Item, str]:
    """Return the items that only ``--long`` runs, with the reason.

    These are the tests marked ``long``, and all but n variants of those marked ``few(n)``: the same ones in each run.
    """
    found = {item: "takes minutes; run with --long" for item in items if "long" in item.keywords}
    variants: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if item not in found and item.get_closest_marker("few"):
            variants[item.nodeid.partition("[")[0]].append(item)
    for several in variants.values():
        marker = several[0].get_closest_marker("few")
        assert marker is not None
        # by a checksum of their names, because neighbours in a list are similar
        for item in sorted(several, key=lambda one: zlib.crc32(one.nodeid.encode()))[marker.args[0] :]:
            found[item] = "one variant of many; run with --long"
    return found


def split(items: list[pytest.Item], part: str) -> tuple[list[pytest.Item], list[pytest.Item]]:
    """Return the items of part ``K/N`` of those that only ``--long`` runs, and all others.

    A checksum of the file selects the part, so that a file's tests share what they prepare.
    """
    k, n = map(int, part.split("/"))
    more = left_out(items)
    chosen = [item for item in items if item in more and zlib.crc32(item.nodeid.partition("::")[0].encode()) % n == k]
    kept = set(chosen)
    return chosen, [item for item in items if item not in kept]
