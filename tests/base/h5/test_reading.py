"""HDF5 files: read, or one line says why not; written whole, or not at all; codecs named where they are missing."""

from __future__ import annotations

import errno
import subprocess
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import hdf5plugin
import numpy as np
import pytest

from lfcal.base.errors import FileFormatError, LfcalError, StorageError, UnsafeFileError
from lfcal.base.h5 import writing
from lfcal.base.h5.reading import H5File
from lfcal.base.h5.writing import new_h5


@pytest.fixture
def path(tmp_path: Path) -> Path:
    target = tmp_path / "a.h5"
    with h5py.File(target, "w") as file:
        file["numbers"] = np.arange(6, dtype=np.int16).reshape(2, 3)
        file["floats"] = [1.0, np.nan]
        file["group/inside"] = 3.0
        file["text"] = "words"
        file["empty"] = h5py.Empty("f4")
        file["soft"] = h5py.SoftLink("/numbers")
        file["external"] = h5py.ExternalLink("/etc/passwd", "/x")
        attributes: dict[str, Any] = {
            "word": "text",
            "bytes": np.bytes_(b"text"),
            "latin": np.bytes_(b"\xff\xfe"),
            "count": 3,
            "real": 2.5,
            "pair": [1.0, 2.0],
            "nan": [1.0, np.nan],
            "table": np.zeros((2, 2)),
            "void": np.void(b"\0\1"),
            "nothing": h5py.Empty("f4"),
        }
        file.attrs.update(attributes)
    return target


def test_a_file_that_a_notebook_has_open_is_not_damaged(path: Path) -> None:
    """HDF5 opens no file twice in one program unless both ask for the same lock."""
    for mode, options in product(("r", "r+"), ({}, {"locking": True}, {"locking": False})):
        with h5py.File(path, mode, **options), H5File(path) as file:
            assert "numbers" in file and file.names()


def test_what_is_there(path: Path) -> None:
    with H5File(path) as file:
        assert set(file.names()) == {"numbers", "floats", "group", "text", "empty", "soft", "external"}
        assert file.names("group") == ("inside",) and file.names("numbers") == file.names("absent") == ()
        assert "group/inside" in file and "absent" not in file and "group/absent" not in file
        assert file.values("numbers", (2, 3), kinds="iu").tolist() == [[0, 1, 2], [3, 4, 5]]
        assert file.values("group/inside") == 3.0
        assert file.dataset_shape("numbers") == (2, 3) == file.dataset("soft").shape
        assert file.datasets() == {"numbers": (2, 3), "floats": (2,), "group/inside": (), "empty": ()}
        assert file.dataset_shape("group") == file.dataset_shape("soft") == file.dataset_shape("empty") == ()
        assert file.dataset("numbers").read((1, slice(None, None, 2))).tolist() == [3, 5]


def test_an_enumeration_is_read_as_its_numbers(tmp_path: Path) -> None:
    """Its names stayed in the dtype, of which NumPy warned when the values were written to an NPY file."""
    with h5py.File(tmp_path / "a.h5", "w") as made:
        made.create_dataset("data", data=[2, 1], dtype=h5py.enum_dtype({"one": 1, "two": 2}, "i2"))
    with H5File(tmp_path / "a.h5") as file:
        data = file.dataset("data")
        values = data.read()
    assert data.dtype == values.dtype == np.int16 and values.tolist() == [2, 1]
    assert data.dtype.metadata is None and values.dtype.metadata is None


OTHER_DATA: list[tuple[Callable[[H5File], Any], type[LfcalError], str]] = [
    (lambda f: f.dataset("absent"), FileFormatError, "expected a dataset of this name, got only empty, external"),
    (lambda f: f.dataset("numbers/x"), FileFormatError, "got only nothing"),
    (lambda f: f.dataset("group"), FileFormatError, "expected a dataset, got Group"),
    (lambda f: f.dataset("external"), UnsafeFileError, "got ExternalLink"),
    (lambda f: f.dataset("text"), UnsafeFileError, "expected plain numbers, got dtype object"),
    (lambda f: f.dataset("empty"), FileFormatError, "expected numbers, got an empty dataset"),
    (lambda f: f.dataset("numbers", max_bytes=5), UnsafeFileError, "expected at most 5 B, got 12 B"),
    (lambda f: f.values("numbers", (3, 2)), FileFormatError, r"of shape \(3, 2\), got int16 of shape \(2, 3\)"),
    (lambda f: f.values("floats", kinds="iu"), FileFormatError, "expected whole numbers, got float64"),
    (lambda f: f.values("floats", finite=True), FileFormatError, "expected finite numbers, got NaN or infinity"),
]
OTHER_ATTRIBUTES: list[tuple[Callable[[Any], Any], str]] = [
    (lambda a: a.text("count"), "attribute count: expected text, got"),
    (lambda a: a.text("pair"), "attribute pair: expected text, got array"),
    (lambda a: a.text("latin"), "got damaged data .*decode"),
    (lambda a: a.text("nothing"), "attribute nothing: expected text, got"),
    (lambda a: a.integer("word"), "attribute word: expected a whole number, got 'text'"),
    (lambda a: a.integer("real"), "expected a whole number"),
    (lambda a: a.integer("pair"), "expected a whole number"),
    (lambda a: a.numbers("word", (1,)), "expected numbers, got 'text'"),
    (lambda a: a.numbers("void", (1,)), "expected numbers, got"),
    (lambda a: a.numbers("nothing", (1,)), "expected numbers, got"),
    (lambda a: a.numbers("pair", (1, 3)), "expected finite numbers, 1 or 3 of them, got"),
    (lambda a: a.numbers("nan", (2,)), "expected finite numbers, 2 of them, got"),
    (lambda a: a.numbers("table", (4,)), "expected finite numbers, 4 of them, got"),
]


def test_other_data_and_attributes_are_refused(path: Path) -> None:
    with H5File(path) as file:
        for ask, kind, words in OTHER_DATA:
            with pytest.raises(kind, match=words):
                ask(file)
        for look, words in OTHER_ATTRIBUTES:
            with pytest.raises(FileFormatError, match=words):
                look(file.attributes())


def test_attributes(path: Path) -> None:
    with H5File(path) as file:
        attributes = file.attributes()
        assert attributes.text("word") == attributes.text("bytes") == "text"
        assert attributes.text("absent") is None and attributes.text("absent", "so") == "so"
        assert attributes.integer("count") == 3 and attributes.integer("absent") is None
        for key, lengths, wanted in (("pair", (2,), [1, 2]), ("real", (1, 4), [2.5]), ("count", (1,), [3])):
            found = attributes.numbers(key, lengths)
            assert found is not None and found.tolist() == wanted
        assert attributes.numbers("absent", (1,)) is None
        plain = attributes.plain()
        assert plain["word"] == "text" and "nothing" not in plain


def test_no_file_and_other_files(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="no such file"):
        H5File(tmp_path / "absent.h5")
    with pytest.raises(StorageError, match="is a folder"):
        H5File(tmp_path)
    for data in (b"", b"not HDF5", b"\x89HDF\r\n\x1a\n" + bytes(500)):
        (tmp_path / "other.h5").write_bytes(data)
        with pytest.raises(FileFormatError, match=r"other\.h5: expected an intact HDF5 file"):
            H5File(tmp_path / "other.h5")


def test_a_closed_file_says_so(path: Path) -> None:
    file = H5File(path)
    data = file.dataset("numbers")
    file.close()
    file.close()
    assert not data.is_open
    with pytest.raises(FileFormatError, match="its file is closed; open it again"):
        data.read()


def test_a_group_that_holds_itself_ends(tmp_path: Path) -> None:
    path = tmp_path / "loop.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("a/b/c")
        group["again"] = file["a"]
        group["root"] = file["/"]
    with H5File(path) as file:
        assert file.names("a/b/c/again/b") == ("c",)


# -- writing -----------------------------------------------------------------------------------------------------------


def fill(file: Any) -> None:
    data = file.create_dataset("H", (50, 64), "u2", chunks=(1, 64), compression="gzip", fletcher32=True)
    for k in range(50):
        data[k] = np.random.default_rng(k).integers(0, 1 << 16, 64)
    file.attrs["about"] = "x" * 500
    file["group/more"] = np.arange(1000)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    header = b"header" + bytes(506)
    with new_h5(tmp_path / "a.h5", header=header, libver=("earliest", "v110")) as file:
        fill(file)
    assert (tmp_path / "a.h5").read_bytes()[:512] == header
    with h5py.File(tmp_path / "a.h5") as file:
        assert file["H"][7].tolist() == np.random.default_rng(7).integers(0, 1 << 16, 64).tolist()
        assert file["group/more"][-1] == 999 and file.attrs["about"] == "x" * 500


class FullDisk(writing._Bytes):
    """A disk that takes so many bytes and no more."""

    room = 0

    def _write(self, view: memoryview) -> None:
        if self._at + len(view) > self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        super()._write(view)


def test_a_disk_that_fills_up_at_any_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(b"old")
    with monkeypatch.context() as patch:
        patch.setattr(writing, "_Bytes", FullDisk)
        for room in (0, 600, 2048, 4000, 6000, 9000, 12000, 14000, 15000):
            patch.setattr(FullDisk, "room", room)
            with pytest.raises(StorageError, match=r"a\.h5: No space left on device; free some space"):
                with new_h5(path) as file:
                    fill(file)
            assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path], room
    with pytest.raises(ZeroDivisionError), new_h5(path) as file:
        fill(file)
        raise ZeroDivisionError
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path], "after an error of the writer"


# -- codecs ------------------------------------------------------------------------------------------------------------


ROOT = Path(__file__).parents[3]

NO_PLUGIN = "import sys; sys.modules['hdf5plugin'] = None\n"
COMMAND = f"{NO_PLUGIN}from lfcal.cli import main\nmain()"
READ = f"""{NO_PLUGIN}from lfcal.frames import open_frames
for path in sys.argv[1:]:
    print(int(open_frames(path, plan_shape=(1, 2, 3), order="raster").read(5).sum()))
"""


def without_plugin(program: str, *words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program, *map(str, words)], capture_output=True, text=True, cwd=ROOT)


def test_a_stack_is_read_or_the_library_is_named(tmp_path: Path) -> None:
    data = np.random.default_rng(0).integers(0, 900, (6, 40, 40), np.uint16)
    for name, how in (("gzip", {"compression": "gzip"}), ("zstd", dict(hdf5plugin.Zstd()))):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file.create_dataset("frames", data=data, chunks=(1, 40, 40), **how)
    done = without_plugin(READ, tmp_path / "gzip.h5", tmp_path / "zstd.h5")
    assert int(done.stdout) == data[5].sum()
    last = done.stderr.splitlines()[-1]
    assert "zstd.h5:/frames: expected the library hdf5plugin" in last
    assert last.endswith('run: pip install "lfcal[hdf5]"')


@pytest.mark.long
def test_h_compressed_with_zstd_names_the_library_and_leaves_nothing(tmp_path: Path) -> None:
    session = ROOT / "sample_data" / "recorded"
    done = without_plugin(COMMAND, "assemble", session, "-o", tmp_path / "H.h5", "--compression", "zstd")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith('run: pip install "lfcal[hdf5]"')
    assert not list(tmp_path.iterdir())
