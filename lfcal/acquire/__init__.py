"""Recording a session so that nothing acknowledged is ever lost.

- ``devices``, ``errors``: the protocols of camera and stage, and what can go wrong
- ``registry``, ``backends``: what devices there are, and why not
- ``options``, ``schedule``, ``orders``: everything a session will do, in order
- ``runner``, ``motion``, ``exposing``, ``acceptance``, ``averaging``, ``hdr``: the strict loop and its parts
- ``control``, ``preview``, ``live_quality``: what a person may ask and see meanwhile
- ``journal``, ``records``, ``durable``, ``store``: frames that survive crash and power cut
- ``session``, ``session_file``, ``origin``, ``guard``: begun, interrupted, resumed
- ``recording``, ``finish``: what was recorded as a `FrameSource`; H from it; repacking
- ``setup``, ``spots``: live set-up
"""
