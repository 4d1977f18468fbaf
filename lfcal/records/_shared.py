"""Names of `lfcal.records` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.records.assembly import COMPRESSIONS, INTERPOLATIONS, STORED_TYPES, AssemblySettings
from lfcal.records.corrections import CorrectionRecipe
from lfcal.records.option import (
    FieldRow,
    check_needs,
    check_record,
    flat,
    from_dict,
    from_flat,
    opt,
    panel,
    record,
    required,
    rows,
    to_dict,
    value_at,
)
from lfcal.records.reading import (
    check_planes,
    read_as,
    read_cutout,
    read_depths,
    read_orientation,
    read_pair,
    read_position,
    read_share,
    read_virtual_depths,
    show_pair,
)

__all__ = [
    "COMPRESSIONS",
    "INTERPOLATIONS",
    "STORED_TYPES",
    "AssemblySettings",
    "CorrectionRecipe",
    "FieldRow",
    "check_needs",
    "check_planes",
    "check_record",
    "flat",
    "from_dict",
    "from_flat",
    "opt",
    "panel",
    "read_as",
    "read_cutout",
    "read_depths",
    "read_orientation",
    "read_pair",
    "read_position",
    "read_share",
    "read_virtual_depths",
    "record",
    "required",
    "rows",
    "show_pair",
    "to_dict",
    "value_at",
]
