"""What a control step costs, and how that is measured.

- `step_time`: one step, its parts, the floor below it, the paper's stack; rounds and machine load
- `step_scaling`: the same against n and m, on the chains of `chains`
- `throughput`: whole closed loops per second
- `worst_step`: the slowest step under the numbers of `hostile`
- `comparison`: another checkout against this one, in processes that run `checkout`
- `recording`: closed-loop states that steps are timed on
- `step_report`: tables (figures: `report.step_figures`)
"""
