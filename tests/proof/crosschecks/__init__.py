"""The cross-check of many robots.

- `batch`: every robot of example-robot-data, or random ones, a row each;
- `random_robots`: the URDF text of a random robot, from a seed;
- `wrapped_robots`: such texts with cables around cylinders and spheres.
"""
