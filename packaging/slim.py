"""Remove video codecs, debug symbols and duplicates, which lfcal never uses, from a Linux bundle.

- OpenCV is linked with FFmpeg, an AVIF reader and a separate OpenBLAS (80 MB), and does not load without them. lfcal
  reads no videos, so small libraries of the same names replace them; their functions return 0. The few functions of
  linear algebra are forwarded to the OpenBLAS of scipy.
- Debug symbols are removed.
- A library of two packages becomes one file with two names.
- ``lfcal-gui`` becomes the same file as ``lfcal``, which checks its name.

Bundles for Windows and macOS have another structure, and are not changed.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

__all__ = ["slim"]

UNCALLED = {
    "LIBAVCODEC": "libavcodec",
    "LIBAVFORMAT": "libavformat",
    "LIBAVUTIL": "libavutil",
    "LIBSWSCALE": "libswscale",
}
"""Libraries of FFmpeg by the symbol version of their functions."""

ONLY_THEIRS = (
    "libaom-",
    "libvpx-",
    "libcrypto-",
    "libssl-",
    "libswresample-",
    "libdrm-",
    "libgfortran-",
    "libquadmath-",
)
"""Libraries that only FFmpeg and the other replaced libraries need."""

AS_THEY_ARE = (".libs/", "PySide6/", "cv2/")
"""Libraries without debug symbols, or that strip would damage because auditwheel has moved them."""


def slim(folder: Path) -> None:
    """Remove from the bundle in ``folder`` what is not needed."""
    if not sys.platform.startswith("linux"):
        return
    inside = folder / "_internal"
    if shutil.which("gcc") and shutil.which("nm"):
        _without_video(inside)
    if shutil.which("strip"):
        _without_symbols(inside)
    _without_copies(inside)
    window = folder / "lfcal-gui"
    window.unlink()
    os.link(folder / "lfcal", window)


def _without_video(inside: Path) -> None:
    module = inside / "cv2" / "cv2.abi3.so"
    libraries = next(inside.glob("opencv*.libs"), None)
    if libraries is None or not module.is_file():
        return
    called: dict[str, set[str]] = defaultdict(set)
    for line in _said("nm", "-D", "--undefined-only", str(module)).splitlines():
        name, _, version = line.split()[-1].partition("@")
        called[version.lstrip("@")].add(name)
    for version, begins in ((v, b) for v in called for key, b in UNCALLED.items() if v.startswith(f"{key}_")):
        _replace(libraries, begins, [f"long {name}(void) {{ return 0; }}" for name in called[version]], version)
    plain = called[""]
    _replace(libraries, "libavif", [f"long {name}(void) {{ return 0; }}" for name in plain if name.startswith("avif")])
    algebra = next((inside / "scipy.libs").glob("libscipy_openblas*"))
    known = set(re.findall(r"\bscipy_(\w+)$", _said("nm", "-D", "--defined-only", str(algebra)), re.MULTILINE))
    passed_on = [
        f'__asm__(".globl {name}\\n.type {name},@function\\n{name}: jmp scipy_{name}@PLT\\n");'
        for name in plain & known
        if re.match(r"cblas_|[sdcz]\w+_$", name)
    ]
    _replace(libraries, "libopenblas", passed_on, needs=algebra)
    for path in libraries.iterdir():
        if path.name.startswith(ONLY_THEIRS):
            path.unlink()


def _replace(libraries: Path, begins: str, code: list[str], version: str = "", needs: Path | None = None) -> None:
    """Replace the library whose name starts with ``begins`` by compiled ``code`` of a symbol ``version``."""
    old = next(libraries.glob(f"{begins}*"))
    with tempfile.TemporaryDirectory() as scratch:
        source, script, made = (Path(scratch, name) for name in ("a.c", "a.map", "a.so"))
        source.write_text("\n".join(sorted(code)) + "\n", encoding="utf-8")
        words = ["gcc", "-shared", "-fPIC", "-w", "-s", "-O1", str(source), "-o", str(made), f"-Wl,-soname,{old.name}"]
        if version:
            script.write_text(f"{version} {{ global: *; }};\n", encoding="utf-8")
            words.append(f"-Wl,--version-script={script}")
        if needs is not None:
            words += [str(needs), f"-Wl,-rpath,$ORIGIN/../{needs.parent.name}", "-Wl,--no-as-needed"]
        subprocess.run(words, check=True)
        shutil.copy(made, old)


def _without_symbols(inside: Path) -> None:
    for path in sorted(inside.rglob("*.so*")):
        name = path.relative_to(inside).as_posix()
        if path.is_file() and not path.is_symlink() and not any(part in name for part in AS_THEY_ARE):
            subprocess.run(["strip", "--strip-unneeded", str(path)], check=False, stderr=subprocess.DEVNULL)


def _without_copies(inside: Path) -> None:
    first: dict[bytes, Path] = {}
    for path in sorted(inside.rglob("*.so*")):
        if not path.is_symlink() and path.is_file():
            kept = first.setdefault(hashlib.sha256(path.read_bytes()).digest(), path)
            if kept is not path:
                path.unlink()
                os.link(kept, path)


def _said(*words: str) -> str:
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    slim(Path(sys.argv[1]))
