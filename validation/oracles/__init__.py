"""Independent answers: the paper's programmes as printed, a second reading of a file.

- `programmes`: CLF-QP, ID-CLF-QP, Soft ID-CLF-QP, IC-QP, IC and UIC as the paper prints them
- `solvers`: what may solve them: quadprog, DAQP, SCS through cvxpy; the least-norm minimiser
- `reference_laws`: the reference implementation's peculiarities around them, as controllers
- `second_reading`: a URDF read again by other means
"""
