"""Widgets that several pages share: images with axes and colour bar, frames, plots, forms, cards, the period map."""
