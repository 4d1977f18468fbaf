"""The benchmark of frames runs and compares what it says."""

from __future__ import annotations

import json

import pytest

from benchmarks.__main__ import command_line
from benchmarks.frames import iter_compare
from lfcal.base.progress import drain


def test_rows() -> None:
    rows = drain(iter_compare(0.02, 1))
    assert len(rows) == 9
    assert all(row.seconds > 0 and row.reference_s > 0 for row in rows)
    assert {row.what for row in rows} >= {"dark + white", "read a.png, checked", "read deflate.tif, checked"}


def test_command_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    command_line().main(["frames", "--megapixels", "0.02", "--repeats", "1", "--json"], standalone_mode=False)
    assert json.loads(capsys.readouterr().out)[0]["ratio"] > 0
