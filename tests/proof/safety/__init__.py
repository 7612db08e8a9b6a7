"""Arms among obstacles, judged by MuJoCo's distances.

- `scenes`: seeded scenes and their runs;
- `near_far`: obstacles far away and near the end of a run;
- `price`: the processor time of steps with barriers, in any checkout;
- `obstacle`: a ball on the way of the published controller, and what barriers change.
"""
