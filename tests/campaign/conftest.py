"""Models of cameras are computed once for all tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.cli.conftest import lfcal
from tests.fit.shared import shared_models

__all__ = ["lfcal"]


@pytest.fixture(scope="package", autouse=True)
def _shared_models() -> Iterator[None]:
    with shared_models():
        yield
