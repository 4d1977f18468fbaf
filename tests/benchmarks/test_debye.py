"""The microscope's benchmark."""

from __future__ import annotations

import json
import sys

import pytest

from benchmarks.__main__ import main
from benchmarks.debye import measure
from lfcal.base.errors import InputError


@pytest.mark.long
def test_error_falls_with_the_nodes():
    rows = measure(5.0, 31, 1)
    errors = [row.error for row in rows if row.name.startswith("lfcal")]
    assert len(errors) == 4
    assert errors[1] < 0.03
    assert errors[0] > errors[1] > errors[2]
    assert all(row.seconds > 0 for row in rows)
    theirs = [row.error for row in rows if row.name.startswith("pyolaf")]
    assert all(error > errors[0] for error in theirs)


@pytest.mark.long
def test_command_prints_json_and_refuses_even_cutouts(capsys, monkeypatch):
    with pytest.raises(InputError, match="odd"):
        measure(5.0, 30, 1)
    monkeypatch.setitem(sys.modules, "pyolaf", None)  # whether it is installed or not
    options = ["--depth", "0", "--cutout", "31", "--repeat", "1", "--json"]
    monkeypatch.setattr(sys, "argv", ["benchmarks", "debye", *options])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    rows = json.loads(capsys.readouterr().out)
    assert [row["positions"] for row in rows] == [225] * 4
