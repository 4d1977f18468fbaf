"""napari plug-in: its manifest (``napari.yaml``) and its reader. napari itself is never imported.

- ``reader``: H and HT, recorded sessions and volumes as layers; `read_layers`
- ``_lazy``: arrays that load only the parts that are displayed
"""
