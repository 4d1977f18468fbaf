"""``python -m lfcal`` is ``lfcal``."""

from lfcal.cli import main

if __name__ == "__main__":
    main()
