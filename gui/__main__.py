"""``python -m gui``: the same as ``lfcal-gui``."""

import sys

from gui.app import main

sys.exit(main())
