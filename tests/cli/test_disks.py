"""Disks that refuse: full, over quota, read-only, another file system. One line, the old file whole, nothing left."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.cli.writing import LONG, WRITERS, Answer, Shell, listing, make_inputs

UNCHECKED = "import lfcal.base.files; lfcal.base.files.require_space = lambda *_, **__: None"
"""The free space is not looked at beforehand, as where another program fills the disk meanwhile."""

NAMES = [pytest.param(name, marks=pytest.mark.long) if name in LONG else name for name in WRITERS]
SOME = {"plan", "transpose", "reconstruct h5"}
A_FEW = [name if name in SOME else pytest.param(name, marks=pytest.mark.long) for name in WRITERS]

Mount = Callable[[str], Path]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory, _recorded: Path) -> Path:
    folder = tmp_path_factory.mktemp("disks")
    make_inputs(folder)
    shutil.copytree(_recorded, folder / "session")
    return folder


@pytest.fixture(scope="module")
def shell() -> Iterator[Shell]:
    found = Shell(UNCHECKED)
    yield found
    found.close()


@pytest.fixture
def mount(tmp_path: Path) -> Iterator[Mount]:
    """Give a function that mounts a small disk in memory with the given options."""
    if shutil.which("mount") is None or not hasattr(os, "geteuid") or os.geteuid() != 0:
        pytest.skip("only the administrator can mount a disk")
    folder = tmp_path / "disk"
    folder.mkdir()

    def mounted(options: str) -> Path:
        command = ["mount", "-t", "tmpfs", "-o", options, "none", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"a disk cannot be mounted here: {done.stderr.strip()}")
        return folder

    yield mounted
    subprocess.run(["umount", "-l", str(folder)], capture_output=True)


def prepare(source: Path, folder: Path, name: str) -> dict[str, bytes]:
    """Copy what the commands read, and put an old file where the command writes; return all that is there."""
    shutil.copytree(source, folder, dirs_exist_ok=True)
    target = folder / WRITERS[name].output
    target.parent.mkdir(exist_ok=True)
    target.write_text("old")
    return listing(folder)


def check(answer: Answer, folder: Path, name: str, before: dict[str, bytes], *why: str) -> None:
    said = [line for line in answer.err.splitlines() if not any(w in line for w in (" ahead", "note:", "set-up"))]
    assert answer.code == 2, answer
    assert len(said) == 1 and any(w in said[0] for w in why) and len(said[0]) < 500, answer.err
    after, output = listing(folder), WRITERS[name].output
    assert after[output] == b"old"
    assert not [k for k in after if k.endswith((".part", ".lock")) and k != "s/session.lock"]
    # a session that was recorded, and whole files of a folder of several, are not scrap
    others = {k for k in after if k.startswith(("s/", "out/")) or k == output}
    assert {k: v for k, v in after.items() if k not in others} == {k: before[k] for k in before if k not in others}


@pytest.mark.few(1)
@pytest.mark.skipif(os.name == "nt", reason="this system has no limits on file sizes")
@pytest.mark.parametrize("name", NAMES)
def test_writes_refused_in_the_middle(shell: Shell, source: Path, tmp_path: Path, name: str) -> None:
    """Real writes, refused by the system as by a quota."""
    before = prepare(source, tmp_path, name)
    answer = shell.run(WRITERS[name].words("--force"), tmp_path, WRITERS[name].half)
    check(
        answer,
        tmp_path,
        name,
        before,
        "File too large; choose a disk that supports",
        ("stored only a part of the data; free"),
    )


@pytest.mark.parametrize("name", A_FEW)
def test_a_disk_that_fills_up(shell: Shell, source: Path, mount: Mount, name: str) -> None:
    folder = mount("size=24m")
    prepare(source, folder, name)
    left = WRITERS[name].half // 4096 * 4096
    (folder / "filling").write_bytes(bytes(shutil.disk_usage(folder).free - left))
    # a session waits for space instead: its own look at the disk comes first
    if name == "acquire":
        pytest.skip("a recording that runs waits until there is space again")
    answer = shell.run(WRITERS[name].words("--force"), folder)
    check(answer, folder, name, listing(folder), "free some space or choose another disk")


@pytest.mark.parametrize("name", A_FEW)
def test_a_disk_that_is_read_only(shell: Shell, source: Path, mount: Mount, name: str) -> None:
    folder = mount("size=24m")
    before = prepare(source, folder, name)
    subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
    check(shell.run(WRITERS[name].words("--force"), folder), folder, name, before, "is not writable; choose another")


def test_an_output_on_another_file_system(shell: Shell, source: Path, mount: Mount, tmp_path: Path) -> None:
    """The scratch file lies beside its target, through links too, so that nothing is moved between disks."""
    folder = mount("size=24m")
    prepare(source, tmp_path, "transpose")
    (tmp_path / "out.h5").unlink()
    (tmp_path / "out.h5").symlink_to(folder / "HT.h5")
    for more in ((), ("--force",)):
        answer = shell.run(WRITERS["transpose"].words(*more), tmp_path)
        assert answer.code == 0, answer.err
    assert [p.name for p in folder.iterdir()] == ["HT.h5"] and (tmp_path / "out.h5").is_symlink()
