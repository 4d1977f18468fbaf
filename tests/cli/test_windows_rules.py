"""Commands under the rules of Windows: nothing is open when it is replaced, and texts end their lines as there."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfcal.psf import open_psf
from tests.cli.conftest import SHAPE, Run, small_plan, true_frame
from tests.judge.plain_report import undrawn
from tests.windows_rules import OpenFileError, held_files, keep_open_files

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="asks /proc what is open")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    keep_open_files(monkeypatch, tmp_path)
    return tmp_path


def test_the_rules_are_kept(here: Path) -> None:
    (here / "a").write_bytes(b"1")
    (here / "b").write_bytes(b"2")
    (here / "folder").mkdir()
    with open(here / "a", "rb") as file:
        state = os.fstat(file.fileno())
        assert (state.st_dev, state.st_ino) in held_files()
        for refused in (lambda: os.replace("b", "a"), lambda: os.rename("a", "c"), (here / "a").unlink):
            with pytest.raises(OpenFileError):
                refused()
    mapped = np.memmap(here / "a", np.uint8, "r")
    with pytest.raises(OpenFileError):
        os.replace("b", "a")
    del mapped
    os.replace("b", "a")
    os.replace("a", "folder/a")
    with open(here / "folder" / "a", "rb"), pytest.raises(OpenFileError):
        os.rename("folder", "other")
    assert (here / "folder" / "a").read_bytes() == b"2"


def assembled(lfcal: Callable[..., Run], session: Path, out: str) -> None:
    run = lfcal(
        *("assemble", session / "frames", "--plan", session / "plan.json", "--dark", session / "dark"),
        *("-o", out, "--force"),
    )
    assert run.code == 0, run.err


AFTER = {
    "transpose": ("transpose", "H.h5", "-o", "HT.h5"),
    "reduce": ("reduce", "H.h5", "-o", "small.h5", "--tolerance", "0.01"),
    "matlab": ("export", "H.h5", "-o", "H.mat"),
    "hyperstack": ("export", "H.h5", "-o", "H.tif"),
    "numpy": ("export", "H.h5", "-o", "H.npy"),
    "compare": ("compare", "H.h5", "other.h5"),
    "verify": ("verify", "H.h5"),
    "inspect": ("inspect", "H.h5", "--report", "report", "--seconds", "0"),
    "reconstruct": ("reconstruct", "H.h5", "frame.png", "-o", "volume.tif", "--iterations", "1"),
}


@pytest.fixture
def matrices(here: Path, lfcal: Callable[..., Run], session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two H, which the first test that asks for them assembles, one of them twice."""
    kept, names = tmp_path_factory.getbasetemp() / "windows_rules_matrices", ("H.h5", "other.h5")
    if not kept.exists():
        for name in ("H.h5", *names):
            assembled(lfcal, session, name)
        kept.mkdir()
        for name in names:
            shutil.copy(here / name, kept)
    for name in names:
        shutil.copy(kept / name, here)
    return here


@pytest.mark.few(3)
@pytest.mark.parametrize("words", AFTER.values(), ids=list(AFTER))
def test_what_is_written_twice_is_not_open(
    lfcal: Callable[..., Run], matrices: Path, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    undrawn(monkeypatch)
    cv2.imwrite("frame.png", true_frame(0, 1, 1))
    force = ("--force",) if words[0] not in ("compare", "verify") else ()
    for _ in range(2):
        run = lfcal(*words, *force)
        assert run.code == 0, run.err
    assert not [path for path in matrices.rglob(".*") if path.suffix in (".part", ".lock")]


def test_a_matrix_in_use_is_not_replaced_and_says_so(
    lfcal: Callable[..., Run], session: Path, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assembled(lfcal, session, "H.h5")
    with open_psf(here / "H.h5") as H:
        monkeypatch.setattr("lfcal.base.system.sys", type("sys", (), {"platform": "win32"}))
        monkeypatch.setattr("lfcal.base.system.is_alive", lambda process: False)
        monkeypatch.setattr("lfcal.base.files.lock", lambda descriptor: None)
        with pytest.raises(
            Exception, match=r"H\.h5: expected .* is open in another program; close it there and try again"
        ):
            from lfcal.base.files import replace_whole

            with replace_whole(here / "H.h5") as part:
                part.write_bytes(b"other")
        assert H[0, 0, 0].shape == small_plan().cutout
    assert not list(here.glob(".*.part"))


def test_a_recording_is_packed_and_read_again(lfcal: Callable[..., Run], session: Path, here: Path) -> None:
    run = lfcal("acquire", session / "plan.json", "--backend", "sim", "--out", "recorded", "--json")
    assert run.code == 0, run.err
    assert lfcal("verify", "recorded").code == 0
    for _ in range(2):
        run = lfcal("assemble", "recorded", "-o", "R.h5", "--force")
        assert run.code == 0, run.err
    with open_psf("R.h5") as H:
        assert H.shape[:3] == SHAPE


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"], ids=["plain", "marked"])
def test_lines_may_end_as_windows_ends_them(lfcal: Callable[..., Run], session: Path, here: Path, mark: bytes) -> None:
    assembled(lfcal, session, "H.h5")
    for path in (session / "plan.json", session / "frames" / "manifest.csv"):
        path.write_bytes(mark + path.read_bytes().replace(b"\n", b"\r\n"))
    assembled(lfcal, session, "other.h5")
    with open_psf("H.h5") as H, open_psf("other.h5") as other:
        np.testing.assert_array_equal(H[:], other[:])
