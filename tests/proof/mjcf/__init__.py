"""Tables of comparisons between public files of the same robots.

- `public_pairs`: URDFs of example-robot-data compared with public MJCFs of the same robots;
- `reader_survey`: Pinocchio's own reader on every MJCF of some folders.
"""
