"""The report on paper: everything is on its pages, the worst first, and nothing lies beside them."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.judge.fault import Fault, FaultPicture, FoundFault
from lfcal.judge.inspection import Inspection
from lfcal.judge.quality import QualityReport, inspect
from lfcal.judge.report._pdf import PageBlock, blocks, iter_pages
from lfcal.judge.report._pictures import pictures
from lfcal.psf import PSFMatrix
from tests.judge.test_report import matrix


@pytest.fixture(scope="module")
def H() -> PSFMatrix:
    return matrix("bench of $5 & <b>")


@pytest.fixture(scope="module")
def quality(H: PSFMatrix) -> QualityReport:
    return inspect(H)


def texts(content: list[PageBlock]) -> list[str]:
    """Return the words of each page; those that do not lie on it end the test."""
    found = []
    for fig in iter_pages(content):
        renderer = fig.canvas.get_renderer()  # type: ignore[attr-defined]
        for one in fig.texts:
            box = one.get_window_extent(renderer)
            assert fig.bbox.x0 <= box.x0 and box.x1 <= fig.bbox.x1, one.get_text()
            assert fig.bbox.y0 <= box.y0 and box.y1 <= fig.bbox.y1, one.get_text()
        for axes in fig.axes:
            place = axes.get_position()
            assert place.x0 >= 0 and place.y0 >= 0.03 and place.x1 <= 1 and place.y1 <= 1
        found.append(" ".join(one.get_text() for one in fig.texts))
    return found


@pytest.mark.parametrize("count", [3, pytest.param(None, marks=pytest.mark.long)])
def test_every_metric_is_on_paper(H: PSFMatrix, quality: QualityReport, count: int | None) -> None:
    drawn = [draw() for draw in pictures(H, quality, None, None)[:count]]
    content = blocks(H, Inspection(quality), drawn, every=True)
    pages = texts(content)
    whole = " ".join(pages)
    assert len(pages) > 2 and quality.verdict.split(":")[0] in pages[0] and "bench of $5 & <b>" in pages[0]
    for metric in quality.metrics:
        assert all(word in whole for word in metric.spec.title.split()) and metric.text.split()[0] in whole
    assert sum(bool(one.picture) for one in content) == len(drawn)


def test_faults_come_with_picture_and_remedy(H: PSFMatrix, quality: QualityReport) -> None:
    picture = FaultPicture(np.eye(4), "%", "light", ("row (px)", "column (px)"))

    class Named(Fault):
        name, advice, rank = "named", "Do this.", 0

        def __init__(self, k: int) -> None:
            self.title, self.settles = f"fault {k}", (quality.metrics[0].key,) if k == 9 else ()  # type: ignore[misc]

    faults = tuple(
        FoundFault(Named(k), "so much", 9.0, k / 100, picture=picture, cost=0.2 + k / 100) for k in (9, 5, 2, 1)
    )
    inspection = Inspection(quality, faults, 60, 0.01, "", 1.0, clean=0.01)
    content = blocks(H, inspection, [])
    pages = texts(content)
    whole = " ".join(pages)
    assert pages[0].index("should not be used") < pages[0].index("1. fault 9: 9 % of the light")
    assert whole.index("2. fault 5") < whole.index("3. fault 2") < whole.index("4. fault 1")
    assert whole.count("What to do: Do this.") == 4 and "see fault 9" in whole


def test_a_heading_stands_with_what_it_is_about() -> None:
    content = [PageBlock("x", 9) for _ in range(66)] + [PageBlock("heading", keep=True), PageBlock("words", 60)]
    pages = texts(content)
    assert len(pages) == 2 and "heading" in pages[1] and "words" in pages[1]
