"""Sessions are recorded in memory where the system has such a disk: each frame waits for the disk it is written to."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import lfcal

__all__ = ["lfcal"]

IN_MEMORY, NEEDED = Path("/dev/shm"), 4 << 30


@pytest.fixture
def tmp_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return a folder of the test's own."""
    name = re.sub(r"\W", "_", request.node.name)[:30]
    if not (IN_MEMORY.is_dir() and os.access(IN_MEMORY, os.W_OK) and shutil.disk_usage(IN_MEMORY).free > NEEDED):
        yield tmp_path_factory.mktemp(name)
        return
    with tempfile.TemporaryDirectory(prefix=f"lfcal-{name}-", dir=IN_MEMORY, ignore_cleanup_errors=True) as folder:
        yield Path(folder)
