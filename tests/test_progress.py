"""What nobody waits for any more is left."""

from __future__ import annotations

import threading

import pytest

from lfcal.progress import Unwanted, leave_if_unwanted, wanted_while


def test_what_nobody_asks_about_goes_on() -> None:
    leave_if_unwanted()
    with wanted_while(lambda: True):
        leave_if_unwanted()


def test_it_is_left_where_nobody_waits_and_in_that_thread_alone() -> None:
    left: list[str] = []

    def other() -> None:
        leave_if_unwanted()
        left.append("went on")

    with wanted_while(lambda: False):
        with pytest.raises(Unwanted):
            leave_if_unwanted()
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        with wanted_while(lambda: True):
            leave_if_unwanted()
        with pytest.raises(Unwanted):
            leave_if_unwanted()
    leave_if_unwanted()
    assert left == ["went on"]
