"""The cross-check of many robots.

- `batch`: every robot of example-robot-data, or random ones, a row each;
- `forced_robots`: random robots with a fluid, buoyancy, springs that are not linear, or a wrench;
- `lift_off`: a figure of cables that touch and leave a pulley, a pin and a ring.
"""
