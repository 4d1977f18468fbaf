"""The quality report: its folder, its page, its pages on paper, and the control frames of a session."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.axes import Axes

from lfcal.acquire.recording.records import Kind
from lfcal.acquire.recording.source import CheckFrame
from lfcal.acquire.redo import RedoList
from lfcal.base.errors import InputError, StorageError
from lfcal.base.figures import figure
from lfcal.camera import preset
from lfcal.frames.source import Position
from lfcal.judge.fault import Fault, FaultPicture, FoundFault
from lfcal.judge.inspection import Inspection
from lfcal.judge.quality import QualityReport, inspect
from lfcal.judge.quality._units import control_frames
from lfcal.judge.quality.verdict import counted_words
from lfcal.judge.report import iter_report, report, report_files
from lfcal.judge.report._pdf import PageBlock, blocks, iter_pages
from lfcal.judge.report._pictures import pictures
from lfcal.judge.telling import draw_picture, drawn
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


def test_the_page_needs_no_other_file(folder: Path, page: Page) -> None:
    text = (folder / "index.html").read_text(encoding="utf-8")
    assert page.sources and all(s.startswith("data:image/png;base64,") for s in page.sources)
    assert not {"script", "link", "iframe"} & set(page.tags) and "@media print" in text
    assert not any(word in text for word in ("http:", "https:", "url(", "@import"))
    assert "bench <script>alert('x')</script>" in page.text, "names from files are shown as text"


def test_pictures_in_the_folder_are_those_of_the_page(folder: Path, page: Page) -> None:
    inside = {base64.b64decode(s.split(",", 1)[1]) for s in page.sources}
    files = {p.name: p.read_bytes() for p in folder.glob("*.png")}
    assert inside == set(files.values()) and all(data.startswith(b"\x89PNG") for data in files.values())
    assert {"depth_sums.png", "transposed_sum.png", "slices.png", "map_missing.png", "shifts.png"} <= files.keys()


def test_curves_over_depth_name_the_depth_and_its_unit(
    H: PSFMatrix, quality: QualityReport, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = []
    set_xlabel = Axes.set_xlabel
    monkeypatch.setattr(Axes, "set_xlabel", lambda axes, text: named.append(text) or set_xlabel(axes, text))
    over_depth = pictures(H, quality, None, None)[2]
    assert over_depth().name == "over_depth.png" and named == 3 * ["depth z (mm)"]


def test_every_metric_is_on_the_page_with_its_remedy(page: Page, quality: QualityReport) -> None:
    assert quality.verdict in page.text and f"{counted_words(quality.metrics)}." in page.text
    for metric in (m for m in quality.metrics if m.applies):
        assert metric.spec.title in page.text and metric.text in page.text and metric.spec.meaning in page.text
        assert metric.merit != "bad" or metric.spec.advice in page.text


def test_lists_in_the_folder_agree_with_the_inspection(folder: Path, quality: QualityReport) -> None:
    redo = RedoList.read(folder / "redo.json")
    assert [tuple(p) for p in redo.positions] == [place for place, _ in quality.redo()]
    assert MISSING in redo.positions and COPY in redo.positions
    assert "missing" in redo.reasons[redo.positions.index(MISSING)]
    found = strict_json((folder / "quality.json").read_text(encoding="utf-8"))
    assert found["format"] == "lfcal-quality" and found["merit"] == quality.merit
    left_out = found["counts"]["not_applicable"]
    assert len(found["metrics"]) == sum(m.applies for m in quality.metrics) == len(quality.metrics) - left_out
    assert found["comparison"]["correlation"] == pytest.approx(1)


def test_sum_of_the_transpose_is_computed_not_copied(H: PSFMatrix, quality: QualityReport) -> None:
    def difference(shown: PSFMatrix) -> float:
        picture = pictures(shown, quality, None, None)[1]()
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
    small = {"reference": np.ones((1, 2, 2, 5, 5))}
    for values, out, more, error, words in (
        (H, "file", {}, StorageError, "expected a folder"),
        (H, "out", small, InputError, "second H: expected shape"),
        (np.ones((1, 4, 6, 31, 33)), "out", {}, InputError, "inspection: expected"),
    ):
        with pytest.raises(error, match=words):
            report(values, tmp_path / out, inspection=Inspection(quality), **more)
    assert not (tmp_path / "out").exists()


# -- on paper --------------------------------------------------------------------------------------------
def texts(content: list[PageBlock]) -> list[str]:
    """Return the words of each page; words and axes beyond the page end the test."""
    found = []
    for fig in iter_pages(content):
        renderer = fig.canvas.get_renderer()
        for one in fig.texts:
            box = one.get_window_extent(renderer)
            assert fig.bbox.x0 <= box.x0 and box.x1 <= fig.bbox.x1, one.get_text()
            assert fig.bbox.y0 <= box.y0 and box.y1 <= fig.bbox.y1, one.get_text()
        for place in (axes.get_position() for axes in fig.axes):
            assert place.x0 >= 0 and place.y0 >= 0.03 and place.x1 <= 1 and place.y1 <= 1
        found.append(" ".join(one.get_text() for one in fig.texts))
    return found


@pytest.mark.parametrize("count", [3, pytest.param(None, marks=pytest.mark.long)])
def test_every_metric_is_on_paper(quality: QualityReport, count: int | None) -> None:
    H = matrix("bench of $5 & <b>")
    drawn = [draw() for draw in pictures(H, quality, None, None)[:count]]
    content = blocks(H, Inspection(quality), drawn, every=True)
    pages = texts(content)
    whole = " ".join(pages)
    assert len(pages) > 2 and quality.verdict.split(":")[0] in pages[0] and "bench of $5 & <b>" in pages[0]
    for metric in quality.metrics:
        assert all(word in whole for word in metric.spec.title.split()) and metric.text.split()[0] in whole
    assert sum(bool(one.picture) for one in content) == len(drawn)


def test_faults_are_on_paper_with_picture_and_remedy(H: PSFMatrix, quality: QualityReport) -> None:
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


def test_a_heading_is_on_the_page_of_its_text() -> None:
    content = [PageBlock("x", 9) for _ in range(66)] + [PageBlock("heading", keep=True), PageBlock("words", 60)]
    pages = texts(content)
    assert len(pages) == 2 and "heading" in pages[1] and "words" in pages[1]


# -- control frames on their way from a session to the page ----------------------------------------------
ANCHOR = (40.0, 52.0)


@pytest.fixture(scope="module")
def periodic() -> PSFMatrix:
    """Patterns that repeat every 4 x 6 pixels of the sensor."""
    rows, columns = np.mgrid[:21, :23]
    values = np.empty((2, 4, 6, 21, 23), np.float32)
    for z, y, x in np.ndindex(values.shape[:3]):
        lattice = (np.cos(np.pi / 2 * (rows + y)) + 1) * (np.cos(np.pi / 3 * (columns + x)) + 1)
        values[z, y, x] = lattice * np.exp(-((rows - 10) ** 2 + (columns - 11) ** 2) / (20 + 10 * z))
    return PSFMatrix(values, anchor=ANCHOR)


def checks(periodic: PSFMatrix, *periods: tuple[int, int]) -> list[CheckFrame]:
    """Return control frames of position (1, 2), three pixels wider than the cutout on each side."""
    return [
        CheckFrame(Kind.CONTROL, Position(z, 1, 2), away, 0.0, 1.0, (0, 0), np.pad(periodic[z, 1, 2], 3))
        for z in range(2)
        for away in periods
    ]


def test_control_frames_are_cut_out_like_h_and_placed(periodic: PSFMatrix, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfcal.judge.quality._units.read_checks", lambda _: checks(periodic, (1, 0), (0, -2)))
    found = control_frames(Path("session"), periodic)
    assert sorted(found) == [0, 1]
    frames, places = found[1]
    assert np.array_equal(frames, [periodic[1, 1, 2]] * 2)
    assert np.array_equal(places, [(40 + 1 + 4, 52 + 2), (40 + 1, 52 + 2 - 12)])
    quality = inspect(periodic, controls=found)
    assert quality["tiling"].value == pytest.approx(0, abs=1e-3)
    assert quality.tilings[0] is not None and quality.tilings[0].away.tolist() == [[1, 0], [0, -2]]


def test_sessions_without_control_frames_or_of_another_h_are_refused(
    periodic: PSFMatrix, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfcal.judge.quality._units.read_checks", lambda _: [])
    with pytest.raises(InputError, match="control frames"):
        control_frames(Path("session"), periodic)
    small = [check._replace(frame=np.zeros((5, 5))) for check in checks(periodic, (1, 0))]
    monkeypatch.setattr("lfcal.judge.quality._units.read_checks", lambda _: small)
    with pytest.raises(InputError, match="session in which H was recorded"):
        control_frames(Path("session"), periodic)


@pytest.mark.long
def test_the_page_shows_the_tiling_where_it_was_measured(periodic: PSFMatrix, tmp_path: Path) -> None:
    frames, places = np.asarray(periodic[0, 1:2, 2]), np.array([[45.0, 54.0]])
    page = report(periodic, tmp_path / "with", controls={0: (frames, places)})
    assert "Tiling over the field</h2>" in page.read_text() and (tmp_path / "with" / "tiling.png").exists()
    assert "Tiling over the field</h2>" not in report(periodic, tmp_path / "without").read_text()


# -- pictures of faults ----------------------------------------------------------------------------------
def test_a_map_is_numbered_from_its_origin_and_a_curve_has_its_abscissa() -> None:
    with figure(3, 2) as fig:
        axes = fig.add_subplot()
        labels = ("down (px)", "across (px)")
        draw_picture(axes, FaultPicture(np.zeros((5, 7)), "%", "what is left", labels, origin=(-2, -3)))
        left, right, bottom, top = axes.images[0].get_extent()
        assert (top, bottom, left, right) == (-2.5, 2.5, -3.5, 3.5)
        assert (axes.get_title(), axes.get_ylabel(), axes.get_xlabel()) == ("what is left", *labels)
    values = np.array([1.0, 3.0, 2.0])
    for across in (None, np.array([10.0, 20.0, 40.0])):
        with figure(3, 2) as fig:
            axes = fig.add_subplot()
            draw_picture(axes, FaultPicture(values, "counts", "mean value", ("light (counts)",), across))
            line = axes.lines[0]
            np.testing.assert_array_equal(line.get_xdata(), range(3) if across is None else across)
            np.testing.assert_array_equal(line.get_ydata(), values)
            shown = (axes.get_title(), axes.get_ylabel(), axes.get_xlabel())
            assert shown == ("mean value", "counts", "light (counts)")


def test_what_is_drawn_is_a_png() -> None:
    png = drawn(FaultPicture(np.eye(4), "%", "light", ("row (px)", "column (px)")))
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.std() > 0 and io.BytesIO(png).read(4) == b"\x89PNG"
