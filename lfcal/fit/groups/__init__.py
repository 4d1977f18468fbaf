"""Groups of unknowns, one concept per module; each module lists its groups in ``GROUPS``.

- ``array``: gap, rotation, offset, pitch and tilt of the lenslet array
- ``pupil``: lenslets of a Fourier light-field microscope, its axis, and the tilt of the source's travel
- ``lenslets``: focal length and spherical aberration of each lens type
- ``iris``: size, rotation, curvature of the blades; the second stop of cat's-eye vignetting
- ``depths``: distances of the planes
- ``wavefront``: Zernike terms of the main lens or objective
- ``light``: size of the source, or of a target's holes; bandwidth
- ``pixels``: crosstalk
- ``stage``: length of the stage's steps
- ``regions``: for several regions of the field: the wavefront over it, its curvature, positions and depths of sources
"""
