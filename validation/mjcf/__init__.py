"""MJCF files: compared with a URDF, written from one, and used as the plant.

- `transform`: rigid displacements;
- `comparison`: two files of one robot, URDF or MJCF, and the causes of their differences;
- `mjcf_file`: an MJCF read strictly, before MuJoCo sees it;
- `compiled_fields`: which fields of a compiled model are read, which have no effect and why;
- `compiled_rig`: commands, lag and delay of its actuators, and slack tendons;
- `export`: a robot written in the other format and read back (`to_mjcf` with
  `rig_to_mjcf`, `to_urdf` with
  `urdf_shapes`, `xml_text`);
- `scene`: a user's own MJCF as the plant; `scene_inputs` maps our inputs to its actuators,
  `servos` gives servos their commands, `scenery` gives the scene's shapes;
- `readers`: Pinocchio's MJCF reader, compared with MuJoCo.
"""
