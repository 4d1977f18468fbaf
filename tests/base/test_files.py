"""Files that appear whole or not at all: links, modes, scratch files of dead processes, other systems."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from lfcal.base.errors import InputError, StorageError
from lfcal.base.files import check_other_file, replace_whole


def write(path: Path, text: str) -> None:
    with replace_whole(path) as part:
        part.write_text(text)


def test_a_link_is_followed_not_replaced(tmp_path: Path) -> None:
    target, link = tmp_path / "data" / "H.h5", tmp_path / "H.h5"
    target.parent.mkdir()
    target.write_text("old")
    link.symlink_to(target)
    write(link, "new")
    assert link.is_symlink() and target.read_text() == "new"
    assert [p.name for p in target.parent.iterdir()] == ["H.h5"]


def test_an_existing_file_keeps_its_mode(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    write(path, "old")
    path.chmod(0o640)
    write(path, "new")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640 and path.read_text() == "new"


def test_a_read_only_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    write(path, "old")
    path.chmod(0o400)
    with pytest.raises(
        StorageError, match=r"H\.h5: this file is read-only; choose another name, or make the file writable"
    ):
        write(path, "new")
    assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 1


def test_an_error_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    write(path, "old")
    with pytest.raises(RuntimeError), replace_whole(path) as part:
        part.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 1


def test_scratch_files_left_behind_are_swept_and_only_those(tmp_path: Path) -> None:
    """Nobody else writes the file while its lock is held: whatever lies there is left over, whoever has its number."""
    left = [f".H.h5.{os.getppid()}.part", ".H.h5.99999999.part", ".other.h5.7.part", ".H.h5.x.part"]
    for name in left:
        (tmp_path / name).write_text("left")
    write(tmp_path / "H.h5", "new")
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*left[2:], "H.h5"])


def test_the_input_is_never_the_output(tmp_path: Path) -> None:
    path = tmp_path / "H.h5"
    path.write_text("H")
    (tmp_path / "hard.h5").hardlink_to(path)
    for other in (path, tmp_path / "." / "H.h5", tmp_path / "hard.h5"):
        with pytest.raises(InputError, match="output: expected a file other than the input"):
            check_other_file(path, other)
    check_other_file(path, tmp_path / "new.h5")
    check_other_file("", path)
