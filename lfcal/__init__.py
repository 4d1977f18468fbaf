"""PSF calibration and acquisition for plenoptic (light-field) cameras.

- ``axes``: array conventions shared by every part
- ``errors``, ``progress``, ``files``, ``units``, ``plain``, ``threads``, ``figures``: common ground
- ``camera``: what the optics are; presets; Raytrix XML; scan plan and its forecast
- ``frames``: where frames come from and how they are cleaned
- ``psf``: the matrix H: cutout, assembly, storage, transpose, judgement, export
- ``simulate``: the simulated camera
- ``reconstruct``: projector pair and solvers
- ``multiplex``: plenoptic multiplexing
- ``cli``: the command line
"""

__version__ = "0.1.0"
