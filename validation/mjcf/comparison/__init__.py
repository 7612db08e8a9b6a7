"""Two files of one robot, URDF or MJCF: one neutral form, matching, causes, substitution.

`side` is one of the files, read once. `neutral` is the neutral form; `from_urdf`, `from_mjcf` and
`mjcf_drives` fill it, and MuJoCo measures its `dynamics`. `matching` pairs the joints. `geometry`,
`bodies`, `parameters` and `drives` look for causes, each a `finding`, and `displacements` looks for
the simplest displacements that explain all. `resting` finds the tips at rest. `comparison` combines
them, and `result` is its result.
"""
