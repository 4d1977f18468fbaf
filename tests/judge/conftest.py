"""What all tests of inspections share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from benchmarks import _fault_costs
from lfcal.judge import _cost as cost
from tests.fit.shared import shared_models
from tests.judge import common
from tests.psf.shared_apertures import shared_apertures


@pytest.fixture(scope="package", autouse=True)
def _shared_models() -> Iterator[None]:
    with shared_models(), shared_apertures():
        yield


@pytest.fixture(scope="package", autouse=True)
def _fewer_patterns(pytestconfig: pytest.Config) -> Iterator[None]:
    """Let some patterns be compared; as many as the atlas of the documentation has with --long."""
    with pytest.MonkeyPatch.context() as patch:
        if not pytestconfig.getoption("--long"):
            patch.setattr(common, "PATTERNS", common.SOME)
        yield


@pytest.fixture
def all_patterns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare as many as with --long: fewer are not enough."""
    monkeypatch.setattr(common, "PATTERNS", common.ALL)


@pytest.fixture(scope="package", autouse=True)
def _fewer_scenes(pytestconfig: pytest.Config) -> Iterator[None]:
    """Let costs be those in small images; as for users with --long."""
    with pytest.MonkeyPatch.context() as patch:
        if not pytestconfig.getoption("--long"):
            patch.setattr(_fault_costs, "SIDE_PX", cost.SIDE_PX)
            patch.setattr(cost, "LARGE_PX", cost.SIDE_PX)
        yield
