"""Write the report into a folder: the page, its images, and lists for programs."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from lfcal.base import Clock, InputError, StorageError, Work, drained, one_line, plain, replace_whole
from lfcal.judge.comparison import Comparison, iter_compare
from lfcal.judge.inspection import Inspection
from lfcal.judge.quality import Controls, iter_inspect
from lfcal.judge.report._pdf import blocks, pdf
from lfcal.judge.report._pictures import PICTURES, pictures
from lfcal.judge.report.page import page
from lfcal.psf import PSFMatrix

__all__ = ["iter_report", "redo_list", "report", "report_files"]

PAGE, PAPER = "index.html", "report.pdf"


def iter_report(
    matrix: PSFMatrix | ArrayLike,
    folder: str | os.PathLike[str],
    *,
    reference: PSFMatrix | ArrayLike | None = None,
    controls: Controls | None = None,
    workers: int | None = None,
    inspection: Inspection | None = None,
    every: bool = False,
) -> Work[Path]:
    """Write a report on H to ``folder``: an HTML page, images, ``report.pdf``, ``quality.json`` and ``redo.json``.

    All plots are drawn before the first file is written. Each file is written atomically, the HTML page last.

    Parameters
    ----------
    matrix
        H; for a transposed view, its H is used.
    folder
        Output folder, created if needed. Files of an earlier report are replaced.
    reference
        Another H of the same shape to compare H with. None: no comparison.
    controls
        Control frames by depth plane, as in `lfcal.judge.quality.iter_inspect`.
    workers
        Number of threads. None: all processors.
    inspection
        Inspection of this H, if already available. None: only the metrics are measured.
    every
        Whether to list metrics that do not apply to H.

    Raises
    ------
    InputError
        If ``inspection`` or ``reference`` has another shape, or ``reference`` another number of pixels per sensor
        pixel.
    StorageError
        If the folder is not writable.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix
    >>> from lfcal.judge import iter_report
    >>> work = iter_report(PSFMatrix(np.ones((2, 3, 3, 9, 9))), "quality")
    >>> step = next(work)
    >>> print(step.stage, step.count)
    inspection steps 0 of 12
    >>> work.close()  # cancelled: nothing is written
    """
    target = Path(folder)
    if target.exists() and not target.is_dir():
        raise StorageError.expected(str(target), "a folder for the report", "a file", "choose another name")
    H = _straight(matrix)
    other = None if reference is None else _straight(reference)
    if inspection is not None and inspection.shape != H.shape:
        raise InputError.expected(
            "inspection",
            f"an inspection of this H, of shape {H.shape}",
            f"one of shape {inspection.shape}",
            "inspect this H",
        )
    comparison: Comparison | None = None
    if other is not None:
        comparison = yield from iter_compare(H, other, by_index=True, workers=workers)
    if inspection is None:
        inspection = Inspection((yield from iter_inspect(H, controls=controls, workers=workers)))
    draws = pictures(H, inspection.quality, other, comparison)
    clock = Clock("drawing the report", len(draws) + 2)
    drawn = []
    for k, draw in enumerate(draws):
        yield clock.at(k)
        drawn.append(draw())
    yield clock.at(len(draws))
    paper = pdf(
        blocks(H, inspection, drawn, every=every),
        f"{one_line(Path(H.path).name) or 'PSF matrix'}: PSF quality",
    )
    yield clock.at(len(draws) + 1)
    text = page(H, inspection, drawn, comparison, other.path if other is not None else "", every=every)
    # the page is last: if it exists, all files that it links to exist
    files = {p.name: p.png for p in drawn}
    result = inspection.to_dict(every=every) | ({} if comparison is None else {"comparison": comparison.to_dict()})
    result |= {"inspected": datetime.now(UTC).isoformat(timespec="seconds")}
    redo = redo_list(inspection)
    files |= {PAPER: paper, "quality.json": _json(result), "redo.json": _json(redo), PAGE: text.encode()}
    for name, content in files.items():
        with replace_whole(target / name) as part:
            part.write_bytes(content)
    yield clock.at(len(draws) + 2)
    return target / PAGE


report = drained(
    iter_report,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix
    >>> from lfcal.judge import report
    >>> page = report(PSFMatrix(np.ones((1, 3, 3, 9, 9))), "quality")
    >>> print(page.name, "redo.json" in {file.name for file in page.parent.iterdir()})
    index.html True
    """,
)


def report_files(folder: Path) -> list[Path]:
    """Return the paths of all files that a report in ``folder`` may have: HTML page, PDF, JSON files and images.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.judge.report import report_files
    >>> [file.name for file in report_files(Path("quality"))[:4]]
    ['index.html', 'report.pdf', 'quality.json', 'redo.json']
    """
    maps = sorted(p.name for p in folder.glob("map_*.png"))
    return [folder / name for name in (PAGE, PAPER, "quality.json", "redo.json", *PICTURES, *maps)]


def redo_list(inspection: Inspection) -> dict[str, Any]:
    """Return the positions to record again as plain JSON types, in the form that ``lfcal acquire --redo`` reads.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix
    >>> from lfcal.judge import Inspection, inspect
    >>> from lfcal.judge.report import redo_list
    >>> H = np.zeros((1, 3, 3, 9, 9))
    >>> H[..., 3:6, 3:6] = np.arange(100, 109).reshape(1, 3, 3, 1, 1)
    >>> H[0, 0, 1] = 0  # a frame without light
    >>> redo = redo_list(Inspection(inspect(PSFMatrix(H))))
    >>> print(redo["positions"], redo["reasons"])
    [[0, 0, 1]] ['missing frames']
    """
    redo = inspection.redo()
    return {
        "format": "lfcal-redo",
        "version": 1,
        "positions": [list(place) for place, _ in redo],
        "reasons": [why for _, why in redo],
    }


def _straight(matrix: PSFMatrix | ArrayLike) -> PSFMatrix:
    H = matrix if isinstance(matrix, PSFMatrix) else PSFMatrix(matrix)
    return H.T if H.is_transposed else H


def _json(value: Any) -> bytes:
    return json.dumps(plain(value), indent=1, ensure_ascii=False).encode()
