"""The quality report: what is in the folder, that it needs nothing else, and that lists agree with the inspection."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from lfcal.acquire.redo import RedoList
from lfcal.base.errors import InputError, StorageError
from lfcal.camera import preset
from lfcal.judge import Inspection
from lfcal.judge.quality import QualityReport, inspect
from lfcal.judge.quality.verdict import counted_words
from lfcal.judge.report import iter_report, report, report_files
from lfcal.psf import PSFMatrix
from tests.strict import strict_json

MISSING, COPY = (0, 1, 2), (1, 2, 3)


class Page(HTMLParser):
    """Tags, links and text of a page; refuses tags that do not close."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.sources: list[str] = []
        self.text = ""
        self._open: list[str] = []
        self.feed(text)
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [v or "" for k, v in attrs if k in ("src", "href", "srcset", "data", "action")]
        if tag not in ("meta", "img", "br"):
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def matrix(name: str = "bench") -> PSFMatrix:
    """Spots under a round aperture, one position missing and one copied."""
    rows, columns = np.mgrid[:31, :33]
    H = np.empty((2, 4, 6, 31, 33), np.float32)
    rng = np.random.default_rng(4)
    for z, y, x in np.ndindex(H.shape[:3]):
        disc = np.hypot(rows - 15, columns - 16) < 7 + 2 * z
        H[z, y, x] = 900 * disc * ((rows + y) % 4 == 0) * ((columns + x) % 6 < 2) + rng.normal(0, 1, (31, 33))
    H[MISSING] = 0
    H[COPY] = H[1, 2, 2]
    recorded = np.ones(H.shape[:3], int)
    recorded[MISSING] = 0
    camera = replace(preset("bench"), name=name)
    history = {"corrections": {"steps": [{"kind": "dark"}]}}
    return PSFMatrix(H, depths=[-20e3, -26e3], camera=camera, recorded=recorded, provenance=history)


@pytest.fixture(scope="module")
def H() -> PSFMatrix:
    return matrix("bench <script>alert('x')</script>")


@pytest.fixture(scope="module")
def quality(H: PSFMatrix) -> QualityReport:
    return inspect(H)


@pytest.fixture(scope="module")
def folder(H: PSFMatrix, quality: QualityReport, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "out"
    assert report(H, folder, inspection=Inspection(quality), reference=matrix()) == folder / "index.html"
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    return Page((folder / "index.html").read_text(encoding="utf-8"))


@pytest.mark.long
def test_it_has_the_report_on_paper_as_a_file(folder: Path) -> None:
    paper = (folder / "report.pdf").read_bytes()
    assert paper.startswith(b"%PDF") and paper.rstrip().endswith(b"%%EOF") and paper.count(b"/Type /Page /") > 2
    assert folder / "report.pdf" in report_files(folder)


def test_page_stands_alone(folder: Path, page: Page) -> None:
    text = (folder / "index.html").read_text(encoding="utf-8")
    assert page.sources and all(s.startswith("data:image/png;base64,") for s in page.sources)
    assert "script" not in page.tags and "link" not in page.tags and "iframe" not in page.tags
    assert "http:" not in text and "https:" not in text and "url(" not in text and "@import" not in text
    assert "@media print" in text


def test_pictures_beside_the_page_are_those_in_it(folder: Path, page: Page) -> None:
    inside = {base64.b64decode(s.split(",", 1)[1]) for s in page.sources}
    beside = {p.read_bytes() for p in folder.glob("*.png")}
    assert inside == beside and all(p.startswith(b"\x89PNG") for p in beside)
    names = {p.name for p in folder.glob("*.png")}
    assert {"depth_sums.png", "transposed_sum.png", "slices.png", "map_missing.png", "shifts.png"} <= names


def test_every_metric_and_what_to_do(page: Page, quality: QualityReport) -> None:
    assert quality.verdict in page.text
    assert f"{counted_words(quality.metrics)}." in page.text
    for metric in (m for m in quality.metrics if m.applies):
        assert metric.spec.title in page.text and metric.text in page.text and metric.spec.meaning in page.text
        if metric.merit == "bad":
            assert metric.spec.advice in page.text


def test_names_from_files_are_shown_not_obeyed(page: Page) -> None:
    assert "bench <script>alert('x')</script>" in page.text


def test_redo_is_what_a_session_takes(folder: Path, quality: QualityReport) -> None:
    redo = RedoList.read(folder / "redo.json")
    assert [tuple(p) for p in redo.positions] == [place for place, _ in quality.redo()]
    assert MISSING in redo.positions and COPY in redo.positions
    assert "missing" in redo.reasons[redo.positions.index(MISSING)]  # type: ignore[arg-type]


def test_quality_json_is_strict_json(folder: Path, quality: QualityReport) -> None:
    found = strict_json((folder / "quality.json").read_text(encoding="utf-8"))
    assert found["format"] == "lfcal-quality" and found["merit"] == quality.merit
    left_out = found["counts"]["not_applicable"]
    assert len(found["metrics"]) == sum(m.applies for m in quality.metrics) == len(quality.metrics) - left_out
    assert found["comparison"]["correlation"] == pytest.approx(1)


def test_sum_of_the_transpose_is_computed_not_copied(H: PSFMatrix, quality: QualityReport) -> None:
    from lfcal.judge.report._pictures import pictures

    def difference(shown: PSFMatrix) -> float:
        picture = next(p for p in (d() for d in pictures(shown, quality, None, None)[1:2]))
        return float(re.findall(r"difference is (\S+) of", picture.caption)[0])

    assert difference(H) < 1e-6
    sums = np.stack([H.depth_sum(z) for z in range(2)])
    assert difference(PSFMatrix(H, depths=H.depths, depth_sums=sums[:, ::-1])) > 1e-3


def test_stopped_report_leaves_nothing(H: PSFMatrix, quality: QualityReport, tmp_path: Path) -> None:
    work = iter_report(H, tmp_path / "out", inspection=Inspection(quality))
    next(work), next(work), next(work)
    work.close()
    assert list(tmp_path.iterdir()) == []


def test_bad_input_writes_nothing(H: PSFMatrix, quality: QualityReport, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(StorageError, match="expected a folder"):
        report(H, tmp_path / "file", inspection=Inspection(quality))
    with pytest.raises(InputError, match="second H: expected shape"):
        report(H, tmp_path / "out", inspection=Inspection(quality), reference=np.ones((1, 2, 2, 5, 5)))
    with pytest.raises(InputError, match="inspection: expected"):
        report(np.ones((1, 4, 6, 31, 33)), tmp_path / "out", inspection=Inspection(quality))
    assert not (tmp_path / "out").exists()
