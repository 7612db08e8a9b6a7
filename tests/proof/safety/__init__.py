"""Arms among obstacles, judged by MuJoCo's distances.

- `scenes`: seeded scenes and their runs.
"""
