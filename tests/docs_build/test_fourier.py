"""The example of the page on Fourier light-field microscopes runs, and its volume shows the bead."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
import tifffile

from lfcal.cli import main
from tests.docs_build.test_commands import BLOCK, DOCS


@pytest.mark.long
def test_the_example_makes_a_volume_with_the_bead(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example = BLOCK.findall((DOCS / "fourier.md").read_text(encoding="utf-8"))[0]
    monkeypatch.chdir(tmp_path)
    for line in example.splitlines():
        monkeypatch.setattr("sys.argv", shlex.split(line))
        with pytest.raises(SystemExit) as stop:
            main()
            raise SystemExit(0)
        # inspect returns 1 where H has a fault; a simulated one has none
        assert not stop.value.code, line
    volume = tifffile.imread(tmp_path / "volume.tif")
    # one volume for each depth of the bead, or the planes of a single one
    volumes = volume.reshape(-1, 5, *volume.shape[-2:])
    assert np.isfinite(volumes).all() and volumes.max() > 0
    for z, one in enumerate(volumes):
        where = np.unravel_index(int(one.argmax()), one.shape)
        assert len(volumes) == 1 or where[0] == z
        assert np.abs(np.array(where[1:]) - (np.array(one.shape[1:]) - 1) / 2).max() <= 2
