"""One page per stage; pages never import each other.

Each module has a class ``Page`` (`gui.base_page.StagePage`) and is named as the stage's key.
"""
