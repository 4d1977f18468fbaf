"""Start the window with ``python -m lfcal_gui``, as with ``lfcal-gui``."""

import sys

from lfcal_gui.app import main

sys.exit(main())
