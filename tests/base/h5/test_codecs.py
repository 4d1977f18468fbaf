"""Without hdf5plugin, everything but its codecs works, and one line says what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import h5py
import hdf5plugin
import numpy as np
import pytest

ROOT = Path(__file__).parents[3]

NO_PLUGIN = "import sys; sys.modules['hdf5plugin'] = None\n"
COMMAND = f"{NO_PLUGIN}from lfcal.cli import main\nmain()"
READ = f"""{NO_PLUGIN}from lfcal.frames import open_frames
print(int(open_frames(sys.argv[1], plan_shape=(1, 2, 3), order="raster").read(5).sum()))
"""


def without_plugin(program: str, *words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program, *map(str, words)], capture_output=True, text=True, cwd=ROOT)


@pytest.mark.parametrize("codec", ["gzip", "zstd"])
def test_a_stack_is_read_or_the_library_is_named(tmp_path: Path, codec: str) -> None:
    path = tmp_path / "stack.h5"
    how = dict(hdf5plugin.Zstd()) if codec == "zstd" else {"compression": "gzip"}
    data = np.random.default_rng(0).integers(0, 900, (6, 40, 40), np.uint16)
    with h5py.File(path, "w") as file:
        file.create_dataset("frames", data=data, chunks=(1, 40, 40), **how)
    done = without_plugin(READ, path)
    if codec == "gzip":
        assert int(done.stdout) == data[5].sum()
    else:
        last = done.stderr.splitlines()[-1]
        assert "stack.h5:/frames: expected the library hdf5plugin" in last
        assert last.endswith('run: pip install "lfcal[hdf5]"')


def test_h_compressed_with_zstd_names_the_library_and_leaves_nothing(tmp_path: Path) -> None:
    session = ROOT / "sample_data" / "recorded"
    done = without_plugin(COMMAND, "assemble", session, "-o", tmp_path / "H.h5", "--compression", "zstd")
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith('run: pip install "lfcal[hdf5]"')
    assert not list(tmp_path.iterdir())
