"""Figures without layout, for tests that check the content of figures but not their layout.

matplotlib measures every label of a figure twice before it draws it, which takes as long as drawing. With ``--long``,
all figures are laid out as for users.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib.layout_engine
import pytest

__all__ = ["laid_out", "not_laid_out"]

LAYOUT = matplotlib.layout_engine.do_constrained_layout  # type: ignore[attr-defined]


@contextmanager
def not_laid_out() -> Iterator[None]:
    """Keep the default margins of matplotlib."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matplotlib.layout_engine, "do_constrained_layout", lambda *_, **__: {})
        yield


@contextmanager
def laid_out() -> Iterator[None]:
    """Lay figures out as for users, regardless of the other tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matplotlib.layout_engine, "do_constrained_layout", LAYOUT)
        yield
