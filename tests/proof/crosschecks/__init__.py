"""The cross-check of many robots.

- `batch`: every robot of example-robot-data, or random ones, a row each;
- `forced_robots`: random robots with a fluid, buoyancy, springs that are not linear, or a wrench;
- `random_robots`: the URDF text of a random robot, from a seed;
- `wrapped_robots`: such texts with cables around cylinders and spheres;
- `lift_off`: a figure of cables that touch and leave a pulley, a pin and a ring.
"""
