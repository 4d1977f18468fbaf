"""Recipes: short texts that state how a projection is computed; the same recipe leads to identical results."""

from __future__ import annotations

import re
from typing import NamedTuple

from lfcal.base import InputError
from lfcal.reconstruct.projectors._tiles import TilePlan

__all__ = ["SEPARATOR", "Tiles", "read_recipe", "recipe_of"]

SEPARATOR = "+"
"""Separator between the recipes of several regions."""


class Tiles(NamedTuple):
    """Numbers of tiles down and across, and of rows of tiles processed together."""

    down: int
    across: int
    band: int


def recipe_of(method: str, plan: TilePlan | None, band: int | None) -> str:
    """Return the method with its tiles (and rows of tiles per pass, if not all), such as ``"polyphase:7x3/2"``."""
    if plan is None:
        return method
    down, across = plan.counts
    return f"{method}:{down}x{across}" + ("" if band is None or band >= down else f"/{band}")


def read_recipe(text: str) -> tuple[str, Tiles | None]:
    """Return the method and the tiles in a recipe; None as tiles if it states none.

    Raises
    ------
    InputError
        If tiles are not numbers, or the method has no tiles.
    """
    name, colon, said = text.partition(":")
    if not colon:
        return name, None
    found = re.fullmatch(r"([1-9]\d{0,5})x([1-9]\d{0,5})(?:/([1-9]\d{0,5}))?", said, re.ASCII)
    if found is None or name != "polyphase":
        wanted = "the name of a method, or polyphase with its number of tiles (rows x columns), such as polyphase:4x3"
        raise InputError.expected("projection method", wanted, repr(text[:40]), "choose one of these")
    down, across = int(found[1]), int(found[2])
    return name, Tiles(down, across, int(found[3]) if found[3] else down)
