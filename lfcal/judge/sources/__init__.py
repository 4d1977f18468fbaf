"""Sources of findings, one module for each kind of data; `lfcal.judge.source` says what a source is."""
