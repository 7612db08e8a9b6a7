"""Independent answers: the paper's programmes as printed, a second reading of a file.

================== =======================================================================
`programmes`       CLF-QP, ID-CLF-QP, Soft ID-CLF-QP, IC-QP, IC, UIC as the paper has them
`agreement`        every law against them, at random states
`solvers`          quadprog, DAQP, SCS through cvxpy; the least-norm minimiser
`reference_laws`   the reference implementation's peculiarities around them
`record_reference` the reference implementation itself, recorded in an environment of its own
`second_reading`   a robot's file read once more, by another parser
================== =======================================================================
"""
