"""What all tests of inspections share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from lfcal.bench import _fault_costs
from tests.fit.shared import shared_models


@pytest.fixture(scope="package", autouse=True)
def _shared_models() -> Iterator[None]:
    with shared_models():
        yield


@pytest.fixture(scope="package", autouse=True)
def _fewer_scenes(pytestconfig: pytest.Config) -> Iterator[None]:
    """Let true costs be those of the first scene; of all of them with --long."""
    with pytest.MonkeyPatch.context() as patch:
        if not pytestconfig.getoption("--long"):
            patch.setattr(_fault_costs, "SEEDS", _fault_costs.SEEDS[:1])
        yield
