"""Tests of `lfcal.inspect`."""
