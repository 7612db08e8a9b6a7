"""Public files of the same robots, as tables.

- `public_pairs`: robots of example-robot-data against public MJCFs of them;
- `reader_survey`: every MJCF of some folders through Pinocchio's own reader.
"""
