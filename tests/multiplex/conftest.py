"""The command line, for tests of commands."""

from tests.cli.conftest import lfcal

__all__ = ["lfcal"]
