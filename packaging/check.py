"""Check that a bundle, a wheel and a tool of uv work outside the checkout.

    python packaging/check.py bundle build/bundle/lfcal    # made with packaging/lfcal.spec
    python packaging/check.py wheel        # builds a wheel and installs it twice, in clean environments

Each is used as by a new user: in a separate folder, with a separate home folder, and without this checkout on the path.
The script runs the demo, simulates H with several processes, exports it, reconstructs a volume, starts the window with
the sample session, and takes a picture of every page. It needs only the standard library.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LARGEST_MB = 600
"""Largest size of a bundle (MB)."""

COMMANDS = 20
"""Smallest number of listed commands."""

PAGES = (
    *("setup", "acquire", "frames", "h"),
    *("simulate", "reconstruct", "multiplex", "accuracy"),
)
"""Pages that the sample session and a recorded session show with content."""

STARTS_S, PATIENCE_S = 30, 900


@dataclass(frozen=True)
class Programs:
    """Commands that start the command line, the window, and the pictures of its pages."""

    lfcal: tuple[str, ...]
    window: tuple[str, ...]
    screenshots: tuple[str, ...]


class Failed(Exception):
    """Exception for a failed check."""


def main() -> int:
    """Run the requested check; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("bundle", "wheel"))
    parser.add_argument("folder", nargs="?", type=Path, help="folder of the bundle")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="lfcal-check-", ignore_cleanup_errors=True) as scratch:
        try:
            if options.what == "bundle":
                check_bundle(options.folder.resolve(), Path(scratch))
            else:
                check_wheel(Path(scratch))
        except Failed as failure:
            print(f"FAILED: {failure}", flush=True)
            return 1
    print("all checks passed")
    return 0


def check_bundle(folder: Path, scratch: Path) -> None:
    """Check the size of a bundle, and its use outside the checkout."""
    # both programs are one file if the system supports links
    files = {(found.st_dev, found.st_ino or path): found.st_size for path, found in _files(folder)}
    size = sum(files.values()) / 1e6
    print(f"size: {size:.0f} MB in {len(files)} files", flush=True)
    suffix = ".exe" if sys.platform == "win32" else ""
    lfcal, window = (str(folder / f"{name}{suffix}") for name in ("lfcal", "lfcal-gui"))
    check_programs(Programs((lfcal,), (window,), (lfcal, "--screenshots")), scratch)
    if size > LARGEST_MB:
        raise Failed(f"size: {size:.0f} MB, more than {LARGEST_MB}")


def _files(folder: Path) -> list[tuple[Path, os.stat_result]]:
    return [(path, path.lstat()) for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]


def check_wheel(scratch: Path) -> None:
    """Build a wheel; install it with pip into an environment, and as a tool of uv; check both."""
    run(("uv", "build", "--wheel", "--out-dir", str(scratch / "dist"), str(ROOT)), scratch)
    (wheel,) = (scratch / "dist").glob("*.whl")
    print(f"wheel: {wheel.stat().st_size / 1e6:.1f} MB", flush=True)
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    binaries = "Scripts" if sys.platform == "win32" else "bin"
    run(("uv", "venv", "-q", "--python", python, str(scratch / "env")), scratch)
    inside = scratch / "env" / binaries
    run(("uv", "pip", "install", "-q", "--python", str(inside / "python"), f"{wheel}[gui]"), scratch)
    check_programs(programs_in(inside, str(inside / "python")), scratch)
    tool = {"UV_TOOL_DIR": str(scratch / "tools"), "UV_TOOL_BIN_DIR": str(scratch / "bin")}
    run(("uv", "tool", "install", "-q", "--python", python, f"lfcal[gui] @ {wheel.as_uri()}"), scratch, tool)
    own = scratch / "tools" / "lfcal" / binaries / "python"
    check_programs(programs_in(scratch / "bin", str(own)), scratch)


def programs_in(folder: Path, python: str) -> Programs:
    """Return the programs of an installation with its Python."""
    return Programs((str(folder / "lfcal"),), (str(folder / "lfcal-gui"),), (python, "-m", "lfcal_gui.screenshots"))


def check_programs(programs: Programs, scratch: Path) -> None:
    """Use the command line and the window as a new user does."""
    here = Path(tempfile.mkdtemp(prefix="used-", dir=scratch))
    print(f"-- {programs.lfcal[0]}", flush=True)
    check_commands(programs.lfcal, here)
    check_pages(programs.screenshots, here)
    check_window(programs.window, here)


def check_commands(lfcal: Sequence[str], here: Path) -> None:
    """Run the demo, then simulate, export, verify and reconstruct."""
    print(run((*lfcal, "--version"), here).strip(), flush=True)
    listed = [line for line in run((*lfcal, "--help"), here).splitlines() if line.startswith("  ") and line[2] != " "]
    if len(listed) < COMMANDS:
        raise Failed(f"--help: lists {len(listed)} commands")
    found = json.loads(run((*lfcal, "doctor", "--json"), here))
    if found["plugins"] or str(ROOT) in json.dumps(found["machine"]):
        raise Failed(f"doctor: {found['plugins']}, {found['machine']}")
    demo = json.loads(run((*lfcal, "demo", "demo", "--json"), here))
    if not demo["correlation"] > 0.999 < demo["recorded_correlation"]:
        raise Failed(f"demo: {demo}")
    processes = ("--executor", "processes", "--workers", "2")
    run(
        (*lfcal, "simulate", "bench", "--virtual-depths", "3,4", "--tolerance", "0.2", "-o", "sim.h5", *processes), here
    )
    run((*lfcal, "export", "sim.h5", "-o", "sim.mat"), here)
    run((*lfcal, "verify", "demo/H.h5"), here)
    run((*lfcal, "reconstruct", "demo/H.h5", "--iterations", "2", "-o", "volume.tif", str(frame_of(here))), here)
    for name in ("sim.h5", "sim.mat", "volume.tif"):
        if not (here / name).stat().st_size:
            raise Failed(f"{name}: is empty")


def frame_of(here: Path) -> Path:
    """Return a frame to reconstruct: a grey picture, written without any library."""
    path = here / "frame.pgm"
    rows, columns = 96, 128
    samples = bytes((7 * y * y + 13 * x) % 251 for y in range(rows) for x in range(columns))
    path.write_bytes(f"P5 {columns} {rows} 255\n".encode() + samples)
    return path


def check_pages(screenshots: Sequence[str], here: Path) -> None:
    """Take a picture of every page with the sample session and a recording."""
    only = ("--scene", "sample", "--scene", "recording", "--theme", "light", "--size", "1280x800")
    run((*screenshots, str(here / "shots"), *only), here)
    there = {path.name.split("_light_")[0] for path in (here / "shots").glob("*.png") if path.stat().st_size > 10_000}
    if missing := set(PAGES) - {name.partition("_")[0] for name in there}:
        raise Failed(f"pages without a picture: {sorted(missing)}")
    print(f"{len(there)} pictures of {len(PAGES)} pages", flush=True)


def check_window(window: Sequence[str], here: Path) -> None:
    """Check that the window runs with the sample session, and ends normally when it is asked to terminate."""
    process = subprocess.Popen(
        (*window, "--demo"),
        cwd=here,
        env=environment(here),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        said = process.communicate(timeout=STARTS_S)[0]
    except subprocess.TimeoutExpired:
        process.terminate()
        said = process.communicate(timeout=PATIENCE_S)[0]
        wanted = 1 if sys.platform == "win32" else 128 + signal.SIGTERM
        if process.returncode != wanted or "Traceback" in said:
            raise Failed(f"window: ended with {process.returncode}, not {wanted}: {said}") from None
        print(f"window: ran for {STARTS_S} s, ended normally", flush=True)
        return
    raise Failed(f"window: ended too early with {process.returncode}: {said}")


def environment(here: Path) -> dict[str, str]:
    """Return an environment without this checkout and without the files that it keeps elsewhere."""
    kept = (
        "PATH",
        "SYSTEMROOT",
        "TEMP",
        "TMP",
        "LANG",
        "UV_CACHE_DIR",
        "UV_INDEX_URL",
        "UV_DEFAULT_INDEX",
        "SSL_CERT_FILE",
    )
    found = {name: os.environ[name] for name in kept if name in os.environ}
    home = here / "home"
    home.mkdir(exist_ok=True)
    found |= dict.fromkeys(("HOME", "USERPROFILE", "LOCALAPPDATA", "APPDATA"), str(home))
    # uv reuses the packages in its cache
    found.setdefault("UV_CACHE_DIR", str(Path.home() / ".cache" / "uv"))
    return found | {"QT_QPA_PLATFORM": "offscreen", "NO_COLOR": "1", "COLUMNS": "120", "PYTHONIOENCODING": "utf-8"}


def run(words: Sequence[str], here: Path, more: dict[str, str] | None = None) -> str:
    """Run a program in ``here``; return its standard output."""
    start = time.monotonic()
    program = shutil.which(words[0]) or words[0]
    done = subprocess.run(
        (program, *words[1:]),
        cwd=here,
        env=environment(here) | (more or {}),
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=PATIENCE_S,
    )
    shown = " ".join(Path(word).name if word.startswith("/") else word for word in words)
    print(f"{time.monotonic() - start:6.1f} s  {shown}", flush=True)
    if done.returncode or "Traceback" in done.stderr:
        raise Failed(f"{shown}: exit code {done.returncode}: {done.stdout[-2000:]}{done.stderr[-4000:]}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
