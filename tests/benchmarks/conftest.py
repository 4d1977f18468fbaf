"""``python -m benchmarks`` in this process."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from benchmarks.__main__ import main
from tests.strict import strict_json


class Bench:
    """Runs ``python -m benchmarks`` in this process and returns what it prints."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capsys = monkeypatch, capsys

    def __call__(self, *arguments: object, code: int = 0) -> str:
        self._monkeypatch.setattr(sys, "argv", ["benchmarks", *map(str, arguments)])
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main()
        printed = self._capsys.readouterr()
        assert int(stop.value.code or 0) == code, printed.err
        return printed.out + printed.err

    def json(self, *arguments: object) -> Any:
        return strict_json(self(*arguments, "--json"))


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Bench:
    monkeypatch.setitem(sys.modules, "pyolaf", None)  # whether it is installed or not
    return Bench(monkeypatch, capsys)
