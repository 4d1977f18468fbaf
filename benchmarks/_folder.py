"""The option of benchmarks that write to a disk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

__all__ = ["FolderOption"]

FolderOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--folder", exists=True, file_okay=False, help="Where to write; the temporary files' by default."),
]
"""Disk that a benchmark writes to and cleans up."""
