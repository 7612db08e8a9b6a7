"""Two files of one robot, URDF or MJCF: one neutral form, matching, causes, substitution.

`side` is one of the files, read once; `neutral` is the form, `from_urdf`, `from_mjcf` and
`mjcf_drives` fill it, `terms` computes its dynamics without an engine, `matching` pairs the
joints, `geometry`, `bodies`, `parameters` and `drives` look for causes, each a `finding`,
`displacements` for the fewest that explain all; `comparison` puts them together, `result` is what
it found.
"""
