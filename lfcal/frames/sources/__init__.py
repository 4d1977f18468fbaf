"""Where frames come from, one module a kind of source; `lfcal.frames.open_frames` finds the one that fits.

- ``base``: what a kind of source must say of itself
- ``folder``: frames in files, as a manifest, their names, or their order lists them
- ``array``: frames in one array
"""
