"""Hook of hatchling: a wheel or source archive names the commit that it was made from (`lfcal.base.version`)."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CommitHook(BuildHookInterface):
    """Write the commit of the checkout into ``lfcal/_commit``; an archive without git keeps the file that it has."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the file, except to an editable installation, which reads the checkout itself."""
        git = ["git", "-C", self.root, "rev-parse", "--show-prefix", "HEAD"]
        try:
            prefix, commit = subprocess.run(git, capture_output=True, text=True, check=True).stdout.split("\n")[:2]
        except (OSError, subprocess.CalledProcessError):
            return
        # an unpacked archive may be in the repository of another project
        if version != "editable" and not prefix:
            self._file = Path(self.directory) / "_commit"
            self._file.parent.mkdir(parents=True, exist_ok=True)
            self._file.write_text(commit, encoding="utf-8")
            build_data["force_include"][str(self._file)] = "lfcal/_commit"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the file from the folder of the archives."""
        Path(self.directory, "_commit").unlink(missing_ok=True)
