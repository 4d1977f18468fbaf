"""Inspections of pages: of the fewest patterns, whose models are computed once for all tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from lfcal.judge._cost import FEWEST
from tests.fit.shared import shared_models


@pytest.fixture(scope="package", autouse=True)
def _fewest_patterns() -> Iterator[None]:
    """As many as there is time for would be others each time."""
    with shared_models(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("lfcal.judge.evidence.MOST_SAMPLES", 0)
        patch.setattr("lfcal.judge._cost.MOST", FEWEST)
        yield
