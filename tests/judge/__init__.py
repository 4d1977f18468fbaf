"""Tests of `lfcal.judge`."""
