"""Pictures whose labels are not measured, in tests that look at what is drawn and not at how it fits.

matplotlib measures every label of a figure twice before it draws it, which takes as long as drawing. With ``--long``
all figures are laid out as they are for users.
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
    """Let figures keep matplotlib's plain margins."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matplotlib.layout_engine, "do_constrained_layout", lambda *_, **__: {})
        yield


@contextmanager
def laid_out() -> Iterator[None]:
    """Lay figures out as for users, however the tests around do it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matplotlib.layout_engine, "do_constrained_layout", LAYOUT)
        yield
