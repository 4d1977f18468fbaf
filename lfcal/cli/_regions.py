"""What is lost between several regions of the field."""

from __future__ import annotations

from typing import Any

import typer

__all__ = ["show_loss"]


def show_loss(loss: Any) -> None:
    """Print it: the number of each region, and the worst."""
    from lfcal.base import format_share
    from lfcal.cli._console import print_table

    rows = [
        [name, f"{row:g}, {column:g}", format_share(error), f"{shift:.2f}"]
        for name, (row, column), error, shift in zip(
            loss.names, loss.anchors.tolist(), loss.losses.tolist(), loss.shift_px.tolist(), strict=True
        )
    ]
    title = f"regions: patterns against those of {loss.names[0]}"
    print_table(["region", "anchor (row, column)", "periodicity loss", "centroid shift (px rms)"], rows, title=title)
    typer.echo(
        f"where {loss.names[0]} stands for the whole field, patterns are {format_share(loss.worst)} off at worst"
    )
