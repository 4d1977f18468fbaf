"""What accuracy costs, and which effects to simulate.

- ``planner``: the effects a scene calls for; ``cost``, ``forecast``: seconds
- ``sampling``: how finely an engine computes; ``ladder``: measured error against seconds
"""
