"""The proof of the toolkit: programs that test, fuzz, document or draw softdyn itself.

`python -m tests.proof NAME` runs one of them, from the root of a checkout. The wheel contains none
of them.

- `fuzz`, `fuzzing`: thousands of damaged files, messages and command lines;
- `robots`, `crosschecks`: all of example-robot-data, or random robots, cross-checked;
- `pairs`, `mjcf`: public URDFs and MJCFs of the same robots, compared;
- `public_files`: public files exported and compared in both engines;
- `wraps`: cables around cylinders and spheres, against MuJoCo and by differences;
- `pressed_arm`: chambers under pressure, against published measurements of a real arm;
- `rig_faults`: runs on a served rig that fail at random times;
- `planted`: `compare` against defects planted in random robots;
- `pictures`, `gallery`, `film`: the documents' pictures, the replays of the site, clips;
- `discrete_steps`: Jacobians of steps against differences, and violent steps;
- `shortest_way`: the way of `best` to a target, beside an iLQR on the full model;
- `lost_cells`: cells where `best` is behind statics, each with and without its cause;
- `batches`: our robots in MuJoCo Warp, with the figures of docs/gpu.md;
- `episodes`: the speed of the environment for learning, with the figures of docs/environment.md;
- `tables`, `documents`: the documents' tables;
- `weights`: the size of each package that an installation brings;
- `rests`: equilibria at the paper's set points, with the figures of docs/statics_measured.md;
- `poses`: predictive control at poses, with the figures of docs/beyond.md;
- `twins`: identifications of twins, with the figures of the documents;
- `closed_forms`, `peer`, `rods`: chains of joints against theory and against SoRoMoX;
- `identification`: fits by MuJoCo's own identification of the same data;
- `textbook`, `laws`: every controller against the paper's QPs as printed;
- `paper`, `reproduce`, `certify`: these QPs, an emulation of the paper's program, and V along the
  paper's runs;
- `step_time`, `hostile`, `observer_time`, `loop_time`, `throughput`, `live_time`, `timing`: times
  of steps, also under hostile numbers, of observers, of closed loops, and with live pages;
- `compare_steps`, `scaling`: step times compared with another checkout, and by the size of a robot;
- `scenes`, `near_far`, `obstacle`, `safety`: arms among obstacles, judged by MuJoCo's distances;
- `barrier_time`: the price of barriers, compared with another checkout;
- `estimates`: forces that the observer estimates.
"""
