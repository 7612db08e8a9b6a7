"""What a control step costs, and how that is measured.

======================== ==================================================================
`step_time`              one step, its parts, the floor below it, the paper's stack; rounds
`throughput`             whole closed loops per second
`worst_step`, `hostile`  the slowest step under numbers that no sensor should send
`recording`              closed-loop states that steps are timed on
`live_timing`            what pages cost a robot that runs live
`step_report`            tables, and the machine (figures: `report.step_figures`)
======================== ==================================================================
"""
