"""Arms among obstacles, judged by MuJoCo's distances.

- `scenes`: seeded scenes and their runs;
- `obstacle`: a ball on the way of the published controller, and what barriers change.
"""
