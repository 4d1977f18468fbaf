"""Whole sessions to be damaged, recorded once for all tests."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from lfcal.acquire.finish import iter_finish
from lfcal.acquire.session import record
from lfcal.base.progress import drain
from lfcal.frames.source import Position
from tests.acquire.rigs import CAREFUL, rig_for, small_plan

PLAN = small_plan()
FULL = replace(CAREFUL, darks=2, dark_every=14, reference_every=5, controls=1)
AGAIN = (Position(0, 1, 2), Position(2, 0, 0))
"""Positions that some sessions have recorded twice."""

Find = Callable[..., Path]


@pytest.fixture(scope="session")
def _whole(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, bool], Path]:
    folder = tmp_path_factory.mktemp("sessions")
    found = {}
    for again in (False, True):
        place, packed = folder / f"in place {again}", folder / f"packed {again}"
        record(place, PLAN, rig_for(PLAN), FULL)
        if again:
            record(place, PLAN, rig_for(PLAN, seed=2), FULL, redo=list(AGAIN))
        shutil.copytree(place, packed)
        drain(iter_finish(packed))
        found |= {("in place", again): place, ("packed", again): packed}
    return found


@pytest.fixture
def kept(_whole: dict[tuple[str, bool], Path]) -> Find:
    """Return what finds a session, to be read only: "in place" or "packed", with positions recorded again or not."""
    return lambda how, again=True: _whole[how, again]


@pytest.fixture
def copied(kept: Find, tmp_path: Path) -> Find:
    """Return what copies a session."""

    def copy(how: str, name: str = "s", *, again: bool = True) -> Path:
        return Path(shutil.copytree(kept(how, again), tmp_path / name))

    return copy
