"""The benchmark of frames runs and compares what it says."""

from __future__ import annotations

import json

from typer.testing import CliRunner

from benchmarks.frames import iter_compare
from lfcal.base.progress import drain
from lfcal.cli.app import build_app


def test_rows() -> None:
    rows = drain(iter_compare(0.02, 1))
    assert len(rows) == 9
    assert all(row.seconds > 0 and row.reference_s > 0 for row in rows)
    assert {row.what for row in rows} >= {"dark + white", "read a.png, checked", "read deflate.tif, checked"}


def test_command_prints_json() -> None:
    result = CliRunner().invoke(build_app(), ["bench", "frames", "--megapixels", "0.02", "--repeats", "1", "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)[0]["ratio"] > 0
