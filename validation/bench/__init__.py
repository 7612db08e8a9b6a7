"""A real rig in place of the twin: the same loop on the monotonic clock, and what makes it safe.

- `driver`: what a user writes, a driver of the rig, and its readings in order
- `clock`: the beginnings of the control periods on the monotonic clock
- `fail_safe`: the causes for which a run stops, and the checks that find them
- `plant`: a driver as the plant of a loop
- `watchdog`: a process that relaxes the rig if the loop's process dies or blocks
- `supervisor`: a process that has an exit code if the loop's process is killed
- `signals`: Ctrl-C and other signals in a run: noted, and asked for before anything moves
- `drive`: one run on a rig
- `pulled_cable`: the curve of tension of one cable, and the zeros that fit it
- `zeroing`: the offsets of winches and the biases of encoders, by pulling each cable
- `kept_zeros`: those that were found before it stopped, in a file from which it goes on
- `served`: a simulated rig in real time behind a local socket
"""
