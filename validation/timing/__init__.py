"""The time of a control step, and its measurement.

======================== ==================================================================
`step_time`              one step, its parts, the floor below it, the paper's stack; rounds
`observer_time`          a step of an observer
`throughput`             whole closed loops per second
`worst_step`, `hostile`  the slowest step under hostile inputs
`recording`              closed-loop states on which steps are timed
`live_timing`            how live pages slow down a running robot
`step_report`            tables, and the machine (figures: `report.step_figures`)
======================== ==================================================================
"""
