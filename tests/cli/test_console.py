"""What long work says while it runs: on a terminal, and nothing in a pipe."""

from __future__ import annotations

import io
from collections.abc import Iterator

import pytest

from lfcal.base.progress import Progress, Work
from lfcal.cli._console import done_text, run_work


class Terminal(io.StringIO):
    """A terminal that keeps what is written."""

    def isatty(self) -> bool:
        return True


def planes(count: int) -> Work[str]:
    def work() -> Iterator[Progress]:
        for k in range(count):
            yield Progress(k + 1, count, "planes", note=f"plane {k}")

    yield from work()
    return "done"


@pytest.mark.parametrize(
    ("record", "speed", "said"),
    [
        (Progress(3, 40, "planes"), None, "3 of 40"),
        (Progress(3, 40, "planes"), 0.0, "3 of 40"),
        (Progress(3, 40, "planes"), 12.345, "3 of 40, 12.3/s"),
        (Progress(3, 40, "planes"), 0.5, "3 of 40, 30/min"),
        (Progress(3, 40, "planes"), 0.001, "3 of 40, 3.6/h"),
        (Progress(3, 0, "frames"), 2.0, "3, 2/s"),
        # a run of few long units moves in thousandths of them
        (Progress(1500, 4000, "units", per=1000), 100.0, "1 of 4, 6/min"),
    ],
)
def test_how_far_and_how_fast(record: Progress, speed: float | None, said: str) -> None:
    assert done_text(record, speed) == said


def test_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    assert run_work(planes(8)) == "done"
    said = terminal.getvalue()
    assert "planes" in said and "8 of 8" in said and "left" in said and "plane 7" in said


@pytest.mark.parametrize("quiet", [False, True])
def test_nothing_in_a_pipe_or_when_asked_to_be_quiet(monkeypatch: pytest.MonkeyPatch, quiet: bool) -> None:
    written: io.StringIO = Terminal() if quiet else io.StringIO()
    monkeypatch.setattr("sys.stderr", written)
    assert run_work(planes(3), quiet=quiet) == "done" and not written.getvalue()
