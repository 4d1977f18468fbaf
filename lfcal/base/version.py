"""Version of lfcal, and the commit of the source that it runs from."""

from __future__ import annotations

import json
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from lfcal import __version__

__all__ = ["full_version"]

DIGITS = 10
"""Number of hash digits in the version."""


@cache
def full_version() -> str:
    """Return the version, with the commit if it is known, such as ``0.1.0+g1a053e7c4b``.

    The commit is that of a git checkout, the one that a wheel or source archive was made from, or the one that pip
    installed from a repository.
    """
    package = Path(__file__).resolve().parents[1]
    commit = _checked_out(package.parent) or _archived(package) or _installed()
    return f"{__version__}+g{commit[:DIGITS]}" if commit else __version__


def _checked_out(root: Path) -> str:
    """Return the commit of the git checkout in ``root``; empty if it is none. Git itself is not needed."""
    try:
        folder = root / ".git"
        if folder.is_file():  # a worktree has its own HEAD, but the references of the repository
            folder = root / folder.read_text(encoding="utf-8").partition("gitdir:")[2].strip()
        common = folder / "commondir"
        shared = (folder / common.read_text(encoding="utf-8").strip()).resolve() if common.exists() else folder
        head = (folder / "HEAD").read_text(encoding="utf-8").strip()
        if not head.startswith("ref:"):
            return _hash(head)
        name = head.partition(":")[2].strip()
        for place in (folder / name, shared / name):
            if place.exists():
                return _hash(place.read_text(encoding="utf-8").strip())
        packed = (shared / "packed-refs").read_text(encoding="utf-8").splitlines()
        return next((_hash(line.split()[0]) for line in packed if line.endswith(f" {name}")), "")
    except (OSError, UnicodeDecodeError, IndexError):
        return ""


def _archived(package: Path) -> str:
    """Return the commit that ``packaging/commit.py`` wrote into the archive; empty without one."""
    try:
        return _hash((package / "_commit").read_text(encoding="utf-8").strip())
    except (OSError, UnicodeDecodeError):
        return ""


def _installed() -> str:
    """Return the commit that pip installed from a repository (PEP 610); empty otherwise."""
    try:
        info = json.loads(distribution("lfcal").read_text("direct_url.json") or "{}")
        return _hash(str(info["vcs_info"]["commit_id"]))
    except (PackageNotFoundError, ValueError, KeyError, TypeError, OSError):
        return ""


def _hash(text: str) -> str:
    return text if len(text) >= DIGITS and set(text) <= set("0123456789abcdef") else ""
