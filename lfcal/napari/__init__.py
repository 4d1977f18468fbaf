"""The plug-in for napari: its manifest (``napari.yaml``) and what it reads. napari itself is never imported.

- ``reader``: H and HT, recorded sessions and volumes as layers; `read_layers`
- ``_lazy``: arrays of which only what is looked at is read
"""
