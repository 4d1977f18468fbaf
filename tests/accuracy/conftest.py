"""A small plan that every part can measure in moments."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lfcal.accuracy import Subject
from lfcal.camera import ScanPlan
from tests.acquire.rigs import small_plan


@pytest.fixture(scope="session")
def plan() -> ScanPlan:
    made = small_plan()
    # seven straight blades, out of focus; a period of nine positions
    return replace(made, exposure_s=0.02)


@pytest.fixture
def subject(plan: ScanPlan) -> Subject:
    return Subject("small", plan, workers=1)
