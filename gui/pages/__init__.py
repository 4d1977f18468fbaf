"""One page per stage; pages never import each other.

Each module has a class ``Page`` (`gui.pages._base.StagePage`) and is named as the stage's key.
"""
