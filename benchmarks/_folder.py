"""The option of benchmarks that write to a disk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

__all__ = ["FolderOption"]

FolderOption: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        "--folder", exists=True, file_okay=False, help="Folder to write to; default: that of temporary files."
    ),
]
"""Option for the folder in which a benchmark writes and removes its files."""
