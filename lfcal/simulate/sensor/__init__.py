"""From light to frames: the simulated sensor.

- ``noise``: photons to sample values; ``white``: the white image; ``windows``: light at its places
- ``camera_source``: a simulated session as frames
- ``session``: such a session written to a folder
"""
