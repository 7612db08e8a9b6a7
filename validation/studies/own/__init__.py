"""Studies of anyone's robots and controllers.

- `tuning`: a schedule for `best`: targets from the statics (`tasks`), a search, a test against
  `mpc`, all in the time that there is (`budget`).
- `side_by_side`: `benchmark`, several controllers from Python, classes of one's own among them.
"""
