"""Commands that are run once for several tests."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfcal.base.progress import Work
from lfcal.cli import main
from lfcal.fit import Fit, Measured


def undrawn(patch: pytest.MonkeyPatch) -> None:
    """Let reports of fits be pages without their pictures, which take as long as the fit of a few patterns."""

    def page(fit: Fit, measured: Measured, folder: Path, source: str = "", notes: Sequence[str] = ()) -> Work[Path]:
        yield from ()
        folder.mkdir(exist_ok=True)
        (folder / "index.html").write_text(f"<html><body>{source}</body></html>")
        return folder / "index.html"

    patch.setattr("lfcal.fit.files.iter_fit_report", page)


def unpictured(patch: pytest.MonkeyPatch) -> None:
    """Let reports of fits be whole pages whose pictures are a pixel each."""
    ok, pixel = cv2.imencode(".png", np.zeros((1, 1), np.uint8))
    assert ok

    def draw(_: object, path: Path) -> None:
        path.write_bytes(pixel.tobytes())

    for name in ("draw_patterns", "draw_leftover", "draw_parameters"):
        patch.setattr(f"lfcal.fit.report.{name}", draw)


def typed(folder: Path, *words: object, drawn: bool = True, pictures: bool = True) -> tuple[str, str]:
    """Run ``lfcal`` with words in a folder, in which all went well; return what it said on both streams."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.chdir(folder)
        patch.setattr("sys.argv", ["lfcal", *map(str, words)])
        if not drawn:
            undrawn(patch)
        if not pictures:
            unpictured(patch)
        with pytest.raises(SystemExit) as end:
            main()
    assert not end.value.code, err.getvalue()
    return out.getvalue(), err.getvalue()
