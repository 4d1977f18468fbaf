"""The workstation: one window from the camera's description to the reconstructed volume."""
