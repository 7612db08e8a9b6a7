"""The MuJoCo plant, built from the URDF by its own path.

- `twin`: the plant: its state, integration under a held input, MuJoCo's warnings
- `integrators`: MuJoCo's integrators by name
- `settings`: MuJoCo's settings: solver, stiffness of stops, disable flags
- `bodies`: the rigid bodies of a URDF, read by the second parser
- `plain_urdf`: what that parser can read of the file: quaternions, capsules and other shapes
- `build`: the MuJoCo model: bodies, joints, tendons, actuators, collision shapes
- `memory`: torques that remember the motion: Maxwell branches, and hysteresis
- `plant_errors`: how a plant differs from the model: masses, springs, friction, contacts, stops
- `state_map`: the convention map between a model's state and the twin's
- `free_base`: a floating base in MuJoCo's variables, so that both engines integrate alike
- `rotors`: the part of tendons' armatures in M that MuJoCo leaves out
- `balls`: springs and dampers of ball joints, from MuJoCo's kinematics
- `own_forces`: forces of a user's own, taken into each step
- `chamber_areas`: areas of chambers that change with their stretch
- `cable_friction`: friction of cables on their guides in MuJoCo's terms
- `cable_course`: turns of a cable around round bodies, from MuJoCo's points of its path
- `drives`: tendons, inputs and sensors in MuJoCo's terms
- `readings`: what the sensors of a twin read
- `obstacles`, `touch`: obstacles as solid geoms, and the forces of contacts with them
- `rig`: the rig of a run: drives, sensors, measured states
"""
