"""Work that is cancelled or drained, and the plain functions made of it."""

from __future__ import annotations

import doctest
import inspect
import pickle
import sys
import threading
from collections.abc import Generator, Iterator
from typing import Any

import pytest

from lfcal.base.progress import Clock, Progress, Work, WorkAbandoned, abandonable, drained, raise_if_abandoned


def iter_sum_of(first: int, second: int = 2, *, times: float = 1.0) -> Work[float]:
    """Return the sum, scaled."""
    yield Clock("adding", 1).at(1)
    return (first + second) * times


sum_of = drained(iter_sum_of)


class Doubled:
    """A class whose work is drained as well."""

    def __init__(self) -> None:
        self.closed = False

    def iter_value(self, value: int) -> Work[int]:
        """Return the value, doubled."""
        try:
            yield Clock("doubling", 1).at(1)
            if value < 0:
                raise ValueError("negative")
            return 2 * value
        finally:
            self.closed = True

    value = drained(iter_value, "Return the doubled value.")


def test_drained_has_the_signature_types_and_docstring_of_its_work() -> None:
    assert str(inspect.signature(sum_of)) == (
        "(first: 'int', second: 'int' = 2, *, times: 'float' = 1.0, "
        "on_progress: 'Callable[[Progress], None] | None' = None) -> 'float'"
    )
    assert sum_of.__annotations__ == {
        "first": "int",
        "second": "int",
        "times": "float",
        "on_progress": "Callable[[Progress], None] | None",
        "return": "float",
    }
    assert (sum_of.__name__, sum_of.__module__, sum_of.__doc__) == ("sum_of", __name__, "Return the sum, scaled.")
    assert pickle.loads(pickle.dumps(sum_of)) is sum_of


def test_drained_returns_the_result_and_reports_progress() -> None:
    assert sum_of(1) == 3.0 and sum_of(1, 5, times=0.5) == 3.0
    other: Any = sum_of
    with pytest.raises(TypeError, match="unexpected keyword argument 'time'"):
        other(1, time=2)
    records: list[Progress] = []
    assert sum_of(1, 5, times=0.5, on_progress=records.append) == 3.0
    assert [(one.done, one.total) for one in records] == [(one.done, one.total) for one in iter_sum_of(1, 5)]
    records.clear()
    assert Doubled().value(4, on_progress=records.append) == 8 and records


def test_drained_method_is_bound_and_closes_its_work_on_an_error() -> None:
    doubled = Doubled()
    assert doubled.value(4) == 8
    assert (Doubled.value.__qualname__, Doubled.value.__doc__) == ("Doubled.value", "Return the doubled value.")
    doubled.closed = False
    with pytest.raises(ValueError, match="negative"):
        doubled.value(-1)
    assert doubled.closed


Counted = Generator[Progress, None, list[int]]


def iter_count(most: int) -> Counted:
    """Count.

    From one on.

    Parameters
    ----------
    most
        The last number.

    Yields
    ------
    Progress
        In numbers.

    Raises
    ------
    ValueError
        Never.

    Examples
    --------
    >>> next(iter_count(2)).count
    '1 of 2'
    """
    for number in range(1, most + 1):
        yield Clock("count", most).at(number)
    return list(range(1, most + 1))


count = drained(
    iter_count,
    """
    Raises
    ------
    TypeError
        If it is no number.

    Examples
    --------
    >>> count(2)
    [1, 2]
    """,
)


def test_drained_leaves_out_what_its_docstring_says_of_steps() -> None:
    assert count.__doc__ is not None
    assert count.__doc__.startswith("Count.\n\nFrom one on.\n\nParameters\n----------\nmost\n    The last number.")
    assert "Yields" not in count.__doc__ and "iter_count" not in count.__doc__ and "ValueError" not in count.__doc__
    assert count.__doc__.endswith(
        "Raises\n------\nTypeError\n    If it is no number.\n\nExamples\n--------\n>>> count(2)\n[1, 2]"
    )


def test_drained_is_a_function_of_the_module_of_its_work_and_has_its_result() -> None:
    assert inspect.signature(count).return_annotation == list[int] and count(2) == [1, 2]
    found = doctest.DocTestFinder().find(sys.modules[__name__])
    assert [one.name.rpartition(".")[2] for one in found if one.examples] == ["count", "iter_count"]
    assert inspect.getmodule(count) is sys.modules[__name__]


def test_drained_refuses_what_is_not_annotated_as_work() -> None:
    def iter_numbers() -> Iterator[int]:
        yield 1

    wrong: Any = iter_numbers
    with pytest.raises(TypeError, match=r"iter_numbers: .* annotated as Work\[...\], got Iterator"):
        drained(wrong)


def test_work_that_is_wanted_continues() -> None:
    raise_if_abandoned()
    with abandonable(lambda: True):
        raise_if_abandoned()


def test_abandoned_work_ends_in_its_own_thread_alone() -> None:
    left: list[str] = []

    def other() -> None:
        raise_if_abandoned()
        left.append("continued")

    with abandonable(lambda: False):
        with pytest.raises(WorkAbandoned):
            raise_if_abandoned()
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        with abandonable(lambda: True):
            raise_if_abandoned()
        with pytest.raises(WorkAbandoned):
            raise_if_abandoned()
    raise_if_abandoned()
    assert left == ["continued"]
