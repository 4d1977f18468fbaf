"""Faults by name, one family a module; `lfcal.inspect.finding.FAULTS` finds them."""
