"""What the numbers of a robot's input mean."""

from __future__ import annotations

from softdyn.description.robot import Robot


def input_unit(robot: Robot) -> str:
    """What one unit of u is: its tendon's gear in N, or N m where it sums angles."""
    tendons = {tendon.name: tendon for tendon in robot.tendons}
    turns = {joint.name for joint in robot.joints if joint.kind != "prismatic"}
    units = []
    for actuator in robot.actuators:
        terms = tendons[actuator.tendon].terms
        unit = "N m" if any(term.joint in turns for term in terms) else "N"
        gear = abs(actuator.gear)
        units.append(unit if gear == 1 else f"{gear:g} {unit}")
    return ", ".join(dict.fromkeys(units))
