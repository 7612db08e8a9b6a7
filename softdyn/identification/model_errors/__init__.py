"""What a fitted model lacks.

- `residuals`: where the residuals are: by marker, input and time;
- `hints`: which effect would explain them, each with its gain on data held out;
- `discrepancy`: a small smooth model of the joint forces that are missing.
"""
