"""Every command that writes, what it writes, and a process of its own to run several of them in."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import cv2
import numpy as np
import tifffile

from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor
from lfcal.psf import PSFMatrix, save
from tests.acquire.rigs import small_plan
from tests.fit.common import few_patterns
from tests.judge.test_trend import write_fit
from tests.lattice.white_frames import draw_white
from tests.recalibrate.common import beads, frame_of, small_h, true_setup
from tests.recalibrate.common import small_plan as beads_plan

HANG_S = 600
"""Only to end a run that hangs."""


class Writer(NamedTuple):
    """A command: its words, one of the files it writes, and about half as many bytes as it writes there."""

    command: str
    output: str
    half: int

    def words(self, *more: str) -> list[str]:
        return [*self.command.split(), *more]


WRITERS = {
    "plan": Writer("plan bench --virtual-depths 3,4 -o out.json", "out.json", 500),
    "plan fit": Writer("plan fit scan.json --count 3 --unknowns iris -o out.json", "out.json", 100),
    "plan target": Writer("plan target scan.json array:3x3@2mm --most-frames 2 -o out.json", "out.json", 500),
    "run": Writer("run job.toml -o out.json", "out.json", 500),
    "camera new": Writer("camera new --preset r29 --yes -o out.json", "out.json", 500),
    "camera import": Writer("camera import camera.json -o out.json", "out.json", 500),
    "camera check": Writer("camera check camera.json white.tif -o out.json --anyway", "out.json", 500),
    "camera sensor": Writer("camera sensor flats.tif darks.tif --camera camera.json -o out.json", "out.json", 500),
    "white": Writer("white white.tif --camera camera.json -o out", "out/camera.json", 200),
    "views": Writer("views white.tif --white white.tif --slopes 2,3 -o out", "out/focal_stack.tif", 2000),
    "simulate": Writer("simulate scan.json --level geometric -o out.h5", "out.h5", 8000),
    "accuracy": Writer("accuracy scan.json --part bases --draw out.png", "out.png", 3000),
    "assemble": Writer("assemble session/frames --dark session/dark -o out.h5", "out.h5", 8000),
    "acquire": Writer(
        "acquire scan.json --out s --assemble out.h5 --no-check-stage --darks 0 --reference-every 0", "out.h5", 4000
    ),
    "inspect": Writer("inspect H.h5 --report out", "out/index.html", 3000),
    "compare": Writer("compare H.h5 H.h5 --report out", "out/index.html", 3000),
    "fit": Writer("fit fit.h5 --unknowns geometry,iris -o out", "out/H.h5", 8000),
    "fit frames": Writer(
        "fit frames beads.tif --camera beads.json --black-level 64 --noise 9,1 --unknowns geometry,iris -o out",
        "out/H.h5",
        8000,
    ),
    "watch": Writer("watch beads.h5 beads.tif --black-level 64 --noise 9,1 -o out", "out/watch.png", 3000),
    "trend": Writer("trend fits -o out.png", "out.png", 3000),
    "transpose": Writer("transpose H.h5 -o out.h5", "out.h5", 60_000),
    "reduce": Writer("reduce H.h5 -o out.h5", "out.h5", 8000),
    "export npy": Writer("export H.h5 -o out.npy", "out.npy", 60_000),
    "export h5": Writer("export H.h5 -o out.h5", "out.h5", 60_000),
    "export mat": Writer("export H.h5 -o out.mat", "out.mat", 60_000),
    "export tif": Writer("export H.h5 -o out.tif", "out.tif", 60_000),
    "export one tif": Writer("export H.h5 -o out.tif --position 1,2", "out.tif", 2000),
    "reconstruct tif": Writer("reconstruct H.h5 frame.tif -n 1 -o out.tif", "out.tif", 3000),
    "reconstruct h5": Writer("reconstruct H.h5 frame.tif -n 1 -o out.h5", "out.h5", 3000),
    "reconstruct npy": Writer("reconstruct H.h5 frame.tif -n 1 -o out.npy", "out.npy", 3000),
    "reconstruct series": Writer("reconstruct H.h5 stack.tif -n 1 -o out.tif", "out.tif", 6000),
    "reconstruct batch": Writer("reconstruct H.h5 stack.tif -n 1 -o out", "out/stack_0001.tif", 3000),
    "depth": Writer("depth white.tif --camera camera.json -o out.tif", "out.tif", 3000),
    "multiplex compare": Writer("multiplex compare Bayer CYMG -o out.png", "out.png", 3000),
    "multiplex show": Writer("multiplex show MURA:5 -o out.png", "out.png", 3000),
    "multiplex demosaic": Writer("multiplex demosaic frame.tif --pattern GRBG -o out.tif", "out.tif", 3000),
    "multiplex views": Writer("multiplex views white.tif --white white.tif -o out.tif", "out.tif", 3000),
    "multiplex search": Writer("multiplex search filters --chi2 1 -o out.png", "out.png", 3000),
    "multiplex filters": Writer("multiplex filters --size 64 -o out.png", "out.png", 3000),
    "multiplex figures": Writer("multiplex figures out", "out/figure6.png", 3000),
    "multiplex map": Writer("multiplex map CYMG --reference Bayer -o out.png", "out.png", 3000),
    "multiplex design": Writer("multiplex design 2x2 --chi2 1 -o out.npy", "out.npy", 100),
    "multiplex recover": Writer("multiplex recover frame.tif --modulator Bayer -o out.tif", "out.tif", 3000),
    "multiplex coding": Writer("multiplex coding H.h5 --sensor r29 --points 3 -o out.png", "out.png", 3000),
    "demo": Writer("demo out", "out/H.h5", 8000),
}
if find_spec("zarr"):  # a folder: what is asked of it as a file holds for the file of that name that it replaces
    WRITERS["reconstruct zarr"] = Writer("reconstruct H.h5 frame.tif -n 1 -o out.ome.zarr", "out.ome.zarr", 3000)
LONG = {"accuracy", "compare", "demo", "fit", "fit frames", "inspect", "trend", "watch", "white", "views"}
LONG |= {f"multiplex {name}" for name in ("compare", "show", "search", "filters", "figures", "map", "design", "coding")}
"""Those that take a second or more."""


def make_inputs(folder: Path) -> None:
    """Write what the commands read, besides ``session``."""
    rng = np.random.default_rng(0)
    save(PSFMatrix(rng.random((1, 5, 5, 31, 31)).astype(np.float32)), folder / "H.h5")
    frames = rng.integers(100, 4000, (2, 40, 40)).astype(np.uint16)
    cv2.imwrite(str(folder / "frame.tif"), frames[0])
    tifffile.imwrite(folder / "stack.tif", frames)
    save(few_patterns(), folder / "fit.h5")
    plan = beads_plan()
    (folder / "beads.json").write_text(plan.to_json())
    save(small_h(plan, true_setup(plan)), folder / "beads.h5")
    tifffile.imwrite(
        folder / "beads.tif", np.maximum(frame_of(plan, beads(plan, 1), 1).values + 64, 0).astype(np.uint16)
    )
    for name, day in (("a", 0), ("b", 30)):
        write_fit(folder / "fits" / name, day)
    (folder / "scan.json").write_text(small_plan((2, 2), 1).to_json())
    (folder / "job.toml").write_text('task = "plan"\ncamera = "bench"\nvirtual_depths = [3, 4]\n')
    white = draw_white((200, 240), pitch=16.0, edges=(3.9, 2.6, 1.6), fill=0.85, step=2).frame
    tifffile.imwrite(folder / "white.tif", white)
    types = tuple(LensType.focused_at(v, 400.0) for v in (2.0, 3.0, 5.0))
    camera = Camera("c", MainLens(), LensletLattice("hexagonal", 82.0, 400.0, types), Sensor(white.shape, 5.0))
    (folder / "camera.json").write_text(camera.to_json())
    levels = np.repeat([0, 0, 2e3, 4e3, 8e3, 12e3, 16e3], 2)  # electrons, two frames a level
    counts = rng.poisson(np.tile(levels[:, None, None], (1, 60, 60))) / 5 + rng.normal(100, 2, (len(levels), 60, 60))
    tifffile.imwrite(folder / "flats.tif", np.rint(counts[4:]).astype(np.uint16), photometric="minisblack")
    tifffile.imwrite(folder / "darks.tif", np.rint(counts[:4]).astype(np.uint16), photometric="minisblack")


CHILD = """
import contextlib, io, json, os, sys, traceback
from lfcal.cli import main
resource = None
with contextlib.suppress(ImportError):
    import resource
BEFORE
for line in sys.stdin:
    words, limit, folder = json.loads(line)
    os.chdir(folder)
    sys.argv, said, code = ['lfcal', *words], io.StringIO(), 0
    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            main()
        except SystemExit as end:
            code = end.code
        except BaseException:
            traceback.print_exc(file=said)
            code = 1
    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    print(json.dumps([code, said.getvalue()]), flush=True)
"""


class Answer(NamedTuple):
    """How a command ended."""

    code: int
    err: str


class Shell:
    """A process that runs one command after the other; one that has died is started again.

    ``before`` is run in it at its start.
    """

    def __init__(self, before: str = "") -> None:
        self.code = CHILD.replace("BEFORE", before)
        self.fonts = TemporaryDirectory()
        self.child = self._start()

    def _start(self) -> subprocess.Popen[str]:
        # -B: a compiled module cut short by the limit on files would end every program that loads it from then on
        command = [sys.executable, "-B", "-c", self.code]
        # lists of fonts, which the limit cuts short, are its own: nothing is left to other programs, or taken from them
        env = {**os.environ, "MPLCONFIGDIR": self.fonts.name}
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env)

    def run(self, words: Sequence[str], folder: Path, limit: int = 0) -> Answer:
        """Run a command in ``folder``, where files may grow to ``limit`` bytes (0: without end)."""
        if self.child.poll() is not None:
            self._leave()
            self.child = self._start()
        assert self.child.stdin is not None and self.child.stdout is not None
        self.child.stdin.write(json.dumps([list(words), limit, str(folder)]) + "\n")
        self.child.stdin.flush()
        line = self.child.stdout.readline()
        return Answer(*json.loads(line)) if line else Answer(self.child.wait(HANG_S), "the process has died")

    def close(self) -> None:
        self._leave()
        self.fonts.cleanup()

    def _leave(self) -> None:
        assert self.child.stdin is not None and self.child.stdout is not None
        self.child.stdin.close()
        self.child.wait(HANG_S)
        self.child.stdout.close()


def listing(folder: Path) -> dict[str, bytes]:
    """Return every file below ``folder`` with its bytes."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
