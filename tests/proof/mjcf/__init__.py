"""Tables of comparisons between public files of the same robots.

- `public_pairs`: URDFs of example-robot-data compared with public MJCFs of the same robots;
- `foreign_files`: single public files exported, and both formats compared in their engines;
- `mjcf_reader`, `readers`: an MJCF as Pinocchio's own reader reads it, compared with MuJoCo's;
- `reader_survey`: that comparison for every MJCF of some folders.
"""
