"""The paper's QPs as printed, and its reference implementation.

- `certificates`: V along the paper's runs, and the zero dynamics;
- `reference_laws`: these controllers with the deviations of the reference implementation;
- `altered_states`: states as the reference implementation computes them;
- `borrowed`: a twin with the collision geometry of the reference's files;
- `reproduction`: how the reference implementation differs from the paper, change by change;
- `one_step`: errors of that emulation against recorded runs, one step at a time.
"""
