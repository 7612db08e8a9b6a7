"""The proof of the toolkit: what tests, fuzzes, documents or draws softdyn itself.

`python -m tests.proof NAME` runs one of its programs, from the root of a checkout. None of it is in
the wheel.

- `fuzz`, `fuzzing`: damaged files, messages and command lines by the thousand;
- `robots`, `crosschecks`: all of example-robot-data, or random robots, cross-checked;
- `pairs`, `mjcf`: public URDFs and MJCFs of the same robots, compared;
- `planted`: `compare` against defects planted in random robots;
- `pictures`, `film`: the documents' pictures and clips;
- `tables`, `documents`: the documents' tables;
- `twins`: the identification of twins whose figures the documents show;
- `closed_forms`, `peer`, `rods`: chains of joints against theory and against SoRoMoX;
- `textbook`, `laws`: every controller against the paper's QPs as printed;
- `compare_steps`, `scaling`, `timing`: step times of another checkout against this one, and
  against the size of a robot.
"""
