"""Arms among obstacles, judged by MuJoCo's distances.

- `scenes`: seeded scenes and their runs;
- `price`: the processor time of steps with barriers, in any checkout;
- `obstacle`: a ball on the way of the published controller, and what barriers change.
"""
