"""Files that end or hang the process that reads them are refused by one that lives on."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import psutil
import pytest

from lfcal.base.errors import FileFormatError
from lfcal.base.h5 import probe as probing
from lfcal.base.h5._examine import Examination, examine
from lfcal.base.h5.probe import probe, trust
from lfcal.base.h5.reading import H5File


@pytest.fixture
def endless(tmp_path: Path) -> Path:
    """Return a file on which reading an attribute never returns: a heap whose free space has no length."""
    path = tmp_path / "endless.h5"
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "lfcal-psf"
    data = bytearray(path.read_bytes())
    heap = data.index(b"GCOL") + 16
    # an object of the heap: number, references, four bytes of nothing, size; the next one follows its padded bytes
    number, size = struct.unpack_from("<H", data, heap)[0], struct.unpack_from("<Q", data, heap + 8)[0]
    assert (number, size) == (1, len("lfcal-psf"))
    struct.pack_into("<HHIQ", data, heap + 16 + 16, 2, 0, 0, 0)
    struct.pack_into("<H", data, heap, 7)  # the number looked for is not found before the end
    struct.pack_into("<Q", data, heap + 8, (1 << 64) - 16)
    path.write_bytes(data)
    return path


def small_file(path: Path) -> Path:
    with h5py.File(path, "w") as file:
        file["a"] = np.arange(5.0)
        file.attrs["word"] = "text"
    return path


def is_read(path: Path) -> None:
    with H5File(small_file(path)) as file:
        assert file.values("a").tolist() == [0, 1, 2, 3, 4]


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[probing._Child]:
    """Let the next question start a separate child."""
    child = probing._Child()
    monkeypatch.setattr(probing, "_CHILD", child)
    yield child
    child.end()


def child_runs(monkeypatch: pytest.MonkeyPatch, folder: Path, text: str) -> None:
    """Let children run another program."""
    (folder / "child.py").write_text(text)
    monkeypatch.setattr(probing, "_SCRIPT", folder / "child.py")


@pytest.mark.skipif(sys.platform == "win32", reason="processor time is not limited on Windows; the clock is")
def test_endless_reading_is_given_up(endless: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probing, "CPU_S", 1)
    words = r"endless\.h5: .* got damaged data that cannot be read to their end in 1 s"
    with pytest.raises(FileFormatError, match=words):
        H5File(endless)
    probe(small_file(tmp_path / "good.h5"))  # the next file finds a new child


@pytest.mark.usefixtures("fresh")
def test_the_end_of_the_child_is_not_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = "import os, sys\nprint('ready', flush=True)\nfor line in sys.stdin:\n    os.abort()\n"
    child_runs(monkeypatch, tmp_path, program)
    path = small_file(tmp_path / "a.h5")
    for _ in range(2):
        words = r"got damaged data that crash the process reading them \(status -?\d+\)"
        with pytest.raises(FileFormatError, match=words):
            probe(path)


def test_a_file_is_looked_at_once_until_it_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh: probing._Child
) -> None:
    asked: list[Path] = []
    monkeypatch.setattr(fresh, "ask", lambda path, seconds, only: asked.append(path) or "")
    path = small_file(tmp_path / "a.h5")
    probe(path)
    probe(path)
    assert asked == [path]
    os.utime(path, ns=(1, 1))
    probe(path)
    assert asked == [path, path]
    os.utime(path, ns=(2, 2))
    trust(path)
    probe(path)
    assert asked == [path, path]


def test_of_what_is_named_the_middle_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, planes = tmp_path / "a.h5", np.arange(3.0).repeat(4).reshape(3, 2, 2)
    with h5py.File(path, "w") as file:
        for name in "ab":
            file.create_dataset(name, data=planes, chunks=(1, 2, 2), compression="gzip")
    for name in ("SMALL", "FEW"):
        monkeypatch.setattr(f"lfcal.base.h5._examine.{name}", 50)
    read: list[object] = []

    def ask(self: Examination, question: Callable[[], object]) -> object:
        read.append(question())
        return read[-1]

    monkeypatch.setattr(Examination, "ask", ask)
    for only, levels in (([], []), (["a"], [[1]]), (None, [[0], [2], [0], [2]])):
        read.clear()
        assert examine(str(path), only) == ""
        assert [np.unique(one).tolist() for one in read if isinstance(one, np.ndarray)] == levels
    with H5File(path, only=("a",)) as file:
        assert (file.dataset("a").read_middle() == 1).all() and file.dataset("b").shape == (3, 2, 2)


@pytest.mark.usefixtures("fresh")
def test_without_a_child_a_file_is_taken_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError("no processes here")

    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("started")

    monkeypatch.setattr(subprocess, "Popen", refused)
    is_read(tmp_path / "a.h5")
    # a program that contains Python is not started again
    monkeypatch.setattr(probing, "_CHILD", probing._Child())
    monkeypatch.setattr(sys, "executable", "/opt/MATLAB/bin/matlab")
    monkeypatch.setattr(subprocess, "Popen", forbidden)
    is_read(tmp_path / "b.h5")


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize(
    "program", ["import a_library_that_is_missing\n", "print('ready', flush=True)\nraise ValueError(input())\n"]
)
def test_a_child_that_fails_says_nothing_about_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str
) -> None:
    child_runs(monkeypatch, tmp_path, program)
    is_read(tmp_path / "a.h5")


@pytest.mark.usefixtures("fresh")
def test_a_child_without_an_answer_is_out_of_time_whatever_its_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On Windows a process that is ended from outside has status 1, as one that ends by an exception."""
    child_runs(
        monkeypatch,
        tmp_path,
        "import signal, sys, time\nsignal.signal(signal.SIGTERM, lambda *_: sys.exit(1))\n"
        "print('ready', flush=True)\ntime.sleep(60)\n",
    )
    monkeypatch.setattr(probing, "CPU_S", 1)
    monkeypatch.setattr(probing, "PATIENCE", 1)
    monkeypatch.setattr(subprocess.Popen, "kill", subprocess.Popen.terminate)
    with pytest.raises(FileFormatError, match="cannot be read to their end in 1 s"):
        probe(small_file(tmp_path / "a.h5"))


@pytest.mark.skipif(os.name != "posix", reason="limits of the system")
def test_a_refused_limit_is_no_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh: probing._Child) -> None:
    """Answer as macOS does: it refuses every limit on the address space with EINVAL."""
    (tmp_path / "sitecustomize.py").write_text(
        "import resource\nreal = resource.setrlimit\n"
        "def setrlimit(what, limits):\n"
        "    if what == resource.RLIMIT_AS:\n"
        "        raise ValueError('current limit exceeds maximum limit')\n"
        "    real(what, limits)\n"
        "resource.setrlimit = setrlimit\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    is_read(tmp_path / "a.h5")
    # the child answered: it was not ended by the refusal
    assert fresh._process is not None and fresh._process.poll() is None


@pytest.mark.skipif(os.name != "posix", reason="limits of a shell")
@pytest.mark.parametrize(
    "limits", ["ulimit -t 5; ulimit -c 0", pytest.param("ulimit -v 4000000; ulimit -n 20", marks=pytest.mark.long)]
)
def test_limits_from_outside_are_no_damage(tmp_path: Path, limits: str) -> None:
    path = small_file(tmp_path / "a.h5")
    code = "import sys; from pathlib import Path; from lfcal.base.h5.probe import probe; probe(Path(sys.argv[1]))"
    command = f'{limits}; exec "$0" -c "$1" "$2"'
    done = subprocess.run(["sh", "-c", command, sys.executable, code, str(path)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.long
def test_the_child_ends_with_its_parent(tmp_path: Path) -> None:
    path = small_file(tmp_path / "a.h5")
    code = (
        "import sys; from pathlib import Path; from lfcal.base.h5 import probe as p\n"
        "p.probe(Path(sys.argv[1])); print(p._CHILD._process.pid, flush=True); import os; os._exit(0)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    with suppress(psutil.NoSuchProcess):
        psutil.Process(int(done.stdout)).wait(60)  # it sees the end of its input


def test_names_of_files_are_carried_whole(tmp_path: Path) -> None:
    probe(small_file(tmp_path / "Mikroskop ü — 像.h5"))
    if sys.platform.startswith("linux"):
        probe(small_file(tmp_path / os.fsdecode(b"latin \xfc.h5")))


def test_a_chunk_of_impossible_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    for filters in ({"compression": "gzip", "fletcher32": True}, {"fletcher32": True}):
        with h5py.File(path, "w") as file:
            made = file.create_dataset("H", data=np.arange(64.0).reshape(4, 16), chunks=(1, 16), **filters)
            size = made.id.get_chunk_info(2).size
        data = path.read_bytes()
        key = struct.pack("<IIQQ", size, 0, 2, 0)  # size, filters left out, first sample: the index of chunks
        assert data.count(key) == 1
        for wrong in (0, 2, 1 << 30):
            path.write_bytes(data.replace(key, struct.pack("<IIQQ", wrong, 0, 2, 0)))
            with pytest.raises(FileFormatError, match="; copy the file again"), H5File(path) as file:
                file.dataset("H")
