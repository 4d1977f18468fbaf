"""What units of a run share is made once in a process, and let go of before another run's takes its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lfcal.work.held import Held
from lfcal.work.unit import stamp_of


class Tool:
    def __init__(self, name: str) -> None:
        self.name = name


def makers() -> tuple[Held[Tool], list[str], Callable[[str], Tool]]:
    told: list[str] = []

    def make(name: str) -> Tool:
        told.append(f"make {name}")
        return Tool(name)

    return Held(lambda tool: told.append(f"close {tool.name}")), told, make


def test_one_at_a_time() -> None:
    held, told, make = makers()
    first = held.get("a", lambda: make("a"))
    assert held.get("a", lambda: make("a")) is first
    assert held.get("b", lambda: make("b")).name == "b"
    assert told == ["make a", "close a", "make b"]


def test_what_is_lent_is_not_closed_and_goes_back() -> None:
    held, told, make = makers()
    mine = Tool("mine")
    with held.lent("a", mine):
        assert held.get("a", lambda: make("a")) is mine
    assert held.get("a", lambda: make("a")) is not mine
    with held.lent("a", mine):
        held.get("b", lambda: make("b"))
    assert held.get("b", lambda: make("b")).name == "b"
    assert told == ["make a", "close a", "make b"]


def test_a_stamp_tells_files_from_what_they_were(tmp_path: Path) -> None:
    one, two = tmp_path / "a", tmp_path / "b"
    one.write_text("x")
    two.write_text("y")
    before = stamp_of([str(one), str(two)])
    assert stamp_of([str(one), str(two)]) == before
    assert stamp_of([str(one)]) != before
    two.write_text("yy")
    assert stamp_of([str(one), str(two)]) != before
