"""A robot's file as frozen data, without any engine.

- `library`: from a name to a file: bundled robots, paths, example-robot-data;
- `strict_xml`: XML without surprises; every error names file, line and element;
- `urdf`: the one parse of an annotated URDF, from links and joints to the checks of the whole;
- `urdf_writer`: the inverse of the parse, URDF text of a robot;
- `annotations`: softdyn's additions: a joint's spring (stiffness and rest), the ``<softdyn>`` block
  with armatures, tendons, actuators and the task frame, overlays;
- `unknown_names`: misspelt and misplaced elements;
- `robot`: the data itself, links, joints, tendons, and the tree that they span;
- `inertia`: transport, lumping, what makes an inertia physical, the nearest one that is;
- `visuals`, `meshes`: a robot's looks, and the mesh files behind them.
"""
