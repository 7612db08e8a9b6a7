"""Forces that a fitted model lacks.

- `discrepancy`: a small smooth model of missing joint forces, and rows left out of a fit;
- `hints`: where the residuals are, and extensions of the model with their gain on unseen data.
"""
