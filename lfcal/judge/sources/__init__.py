"""Sources of findings, one module for each kind of data; `lfcal.judge.source` defines a source."""
