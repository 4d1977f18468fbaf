"""Names of `lfcal.frames.lists` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.frames.lists.derived import plan_of_list
from lfcal.frames.lists.entries import files_below, located
from lfcal.frames.lists.list_file import (
    any_listing,
    from_micromanager,
    from_names,
    from_stage,
    is_plain,
    manifest_from,
    micromanager_list,
    reader,
    sample_of,
)
from lfcal.frames.lists.listing import Listing
from lfcal.frames.lists.motion import Part, centre_of_light
from lfcal.frames.lists.placing import place
from lfcal.frames.lists.table import (
    LENGTHS,
    TABLE_SUFFIXES,
    TIMES,
    Column,
    Table,
    clear_columns,
    find_columns,
    parse_columns,
    read_table,
)

__all__ = [
    "LENGTHS",
    "TABLE_SUFFIXES",
    "TIMES",
    "Column",
    "Listing",
    "Part",
    "Table",
    "any_listing",
    "centre_of_light",
    "clear_columns",
    "files_below",
    "find_columns",
    "from_micromanager",
    "from_names",
    "from_stage",
    "is_plain",
    "located",
    "manifest_from",
    "micromanager_list",
    "parse_columns",
    "place",
    "plan_of_list",
    "read_table",
    "reader",
    "sample_of",
]
