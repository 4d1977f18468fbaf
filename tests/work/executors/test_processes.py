"""Units in processes of their own, as a script without a main guard begins them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import lfcal

SCRIPT = """
import sys
from pathlib import Path

from lfcal.base.progress import drain
from lfcal.work import RunChoice, iter_run
from tests.work.tasks import unit

print("script runs")
units = [unit(f"plane {k}", text=f"{k}") for k in range(3)]
parts = drain(iter_run(units, Path(sys.argv[2]), RunChoice(sys.argv[1], 2).make()))
print(*(part.read_text() for part in parts))
"""


@pytest.mark.parametrize("executor", ["processes", pytest.param("dask", marks=pytest.mark.long)])
def test_a_script_is_run_once(executor: str, tmp_path: Path) -> None:
    """Each worker ran it again, began the same work, and ended in the tracebacks of that."""
    if executor == "dask":
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    # the checkout for `tests`, wherever the library itself comes from
    paths = [str(Path(__file__).parents[3]), str(Path(lfcal.__file__).parents[1])]
    told = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, str(script), executor, str(tmp_path / "run")]
    done = subprocess.run(command, env=told, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.split("\n"), done.stderr) == (0, ["script runs", "0 1 2", ""], "")
