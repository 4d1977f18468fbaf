"""``python -m gui``: the same as ``lfcal-gui``."""

import sys

from lfcal_gui.app import main

sys.exit(main())
