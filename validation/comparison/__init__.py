"""Two files of one robot, URDF or MJCF: one neutral form, matching, causes, substitution.

`neutral` is the form, `from_urdf`, `mjcf_file` and `from_mjcf` fill it, `terms` computes its
dynamics without an engine and `engines` asks both about it, `matching` pairs the joints,
`geometry`, `bodies` and `parameters` look for causes, each a `finding`, `comparison` puts them
together, `result` is what it found, `public_pairs` compares public files.
"""
