"""The workstation: a window for the whole calibration session."""
