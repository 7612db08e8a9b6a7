"""A robot's file as frozen data, without any engine.

- `library`: finds a robot's file by name: bundled robots, paths, example-robot-data;
- `strict_xml`: reads XML strictly; every error names file, line and element;
- `urdf`: parses an annotated URDF: links, joints, checks of the whole;
- `origins`: poses of URDF, with quaternions from version 1.1 on;
- `mimics`: joints that follow others, composed along chains;
- `urdf_writer`: writes a robot as URDF text, the inverse of the parse;
- `annotations`: softdyn's additions: a joint's spring (stiffness and rest), the ``<softdyn>`` block
  with armatures, tendons, actuators and tasks (`stated_task`), overlays;
- `task_mark`: a task's link, kind and direction, for logs and pages;
- `unknown_names`: misspelt and misplaced elements; `other_tools`: a table of the elements that
  softdyn reads, ignores, or refuses because they change the robot; `motors` reads rotor inertias;
- `robot`: the data: links, joints, tendons, and the tree that they span;
- `rig`: the data of motors, winches and sensors; `rig_block` reads them from the block;
- `readings`: names, rows and units of the sensors' readings, and their times;
- `inertia`: poses; moves and adds inertias, checks that one is physical, finds the nearest
  physical one;
- `visuals`, `meshes`: the shapes that a robot shows, and its mesh files.
"""
