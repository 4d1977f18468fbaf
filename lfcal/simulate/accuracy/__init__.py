"""What accuracy costs, and which effects are worth it.

- ``planner``: the effects a scene calls for; ``cost``, ``forecast``: seconds
- ``sampling``: how finely an engine computes; ``ladder``: measured error against seconds
"""
