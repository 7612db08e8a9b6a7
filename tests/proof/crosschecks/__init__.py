"""Many robots through the cross-check.

- `batch`: every robot of example-robot-data, or random ones, a row each;
- `random_robots`: a seed in, URDF text out.
"""
