"""Faults by name, one family a module; `lfcal.judge.finding.FAULTS` finds them."""
