"""Make ``python -m lfcal`` run the command ``lfcal``."""

from lfcal.cli import main

if __name__ == "__main__":
    main()
