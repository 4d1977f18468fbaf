"""What all tests of quality share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.cli.conftest import lfcal
from tests.psf.shared_apertures import shared_apertures

__all__ = ["lfcal"]


@pytest.fixture(scope="package", autouse=True)
def _shared_apertures() -> Iterator[None]:
    with shared_apertures():
        yield
