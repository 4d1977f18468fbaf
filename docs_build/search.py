"""Correction of the search of the built site."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["repair_search"]

KEY = re.compile(r"(\w)=\1\+(\w)\+(\w)\.id\}return \1")
"""Code in the minified search worker of the theme with which lunr joins labels and numbers to the key of a state."""


def repair_search(site: Path) -> bool:
    """Separate the edges in the keys of lunr's states; return whether the code was found.

    Without a separator, different states can have equal keys if words contain digits: the edge "1" to state 23 looks
    like two edges. lunr then merges the states, and finds nothing for words such as "frame".
    """
    found = False
    for worker in site.glob("assets/javascripts/workers/search.*.js"):
        text, count = KEY.subn(r'\1=\1+\2+\3.id+","}return \1', worker.read_text(encoding="utf-8"))
        if count == 1:
            worker.write_text(text, encoding="utf-8")
            found = True
    return found
