"""What the window shows, without Qt: state is frozen, changes are events, drawing is a pure function of state.

- ``session``: the one session: camera, plan, files; undo, save, autosave, recent
- ``stages``: the stages of a session and the state of each
- ``display``: how an array becomes a picture: levels, log, gamma, binning
"""
