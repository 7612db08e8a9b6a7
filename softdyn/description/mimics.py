"""Mimic joints of a URDF: chains of followers are composed, so that each follows a free joint."""

from __future__ import annotations

from dataclasses import replace

from softdyn.checks import did_you_mean
from softdyn.description.robot import Joint, Mimic
from softdyn.description.strict_xml import Element

MOST = 1e6
"""A larger multiplier is no transmission, and a larger offset (rad, m) no place: M grows with the
multiplier's square, and products of the file's other numbers are up to 1e150."""


def read_mimic(joint: Element) -> Mimic | None:
    """The ``<mimic>`` of a joint, as the file states it."""
    element = joint.child("mimic")
    if element is None:
        return None
    element.allow("joint", "multiplier", "offset")
    multiplier, offset = element.number("multiplier", 1.0), element.number("offset", 0.0)
    return Mimic(element.text("joint"), multiplier, offset)


def compose_mimics(root: Element, joints: dict[str, Joint]) -> None:
    """Let each follower in `joints` follow a joint that follows no other.

    With q_f = m q_l + o and q_l = n q + p, it is q_f = m n q + m p + o.

    Raises
    ------
    UrdfError
        For a leader that does not move, a cycle, and a follower whose position is ambiguous: the
        angle of a continuous leader is unique up to turns only.
    """
    stated = {name: joint.mimic for name, joint in joints.items() if joint.mimic is not None}
    for element in root.children("joint"):
        name = element.text("name")
        if name not in stated:
            continue
        mimic, chain = stated[name], [name]
        while True:
            leader = joints.get(mimic.leader)
            if leader is None or not leader.moves:
                got = f"fixed joint {mimic.leader!r}"
                if leader is None:
                    got = did_you_mean(mimic.leader, joints)
                raise element.error("in <mimic> the name of a joint that moves", got)
            chain.append(leader.name)
            if leader.name not in stated:
                break
            if leader.name in chain[:-1]:
                expected = "in <mimic> a leader that does not follow its own follower"
                raise element.error(expected, f"a cycle: {' follows '.join(chain)}")
            above = stated[leader.name]
            offset = mimic.multiplier * above.offset + mimic.offset
            mimic = Mimic(above.leader, mimic.multiplier * above.multiplier, offset)
        if not max(abs(mimic.multiplier), abs(mimic.offset)) <= MOST:
            got = f"{mimic.multiplier:g} and {mimic.offset:g} along {', '.join(chain)}"
            raise element.error(f"in <mimic> a multiplier and an offset within ±{MOST:g}", got)
        follower = joints[name]
        whole = mimic.multiplier.is_integer()
        if leader.kind == "continuous" and not (follower.kind == "continuous" and whole):
            expected = (
                f"a follower of continuous joint {leader.name!r}, whose angle is unique up to "
                "turns only, that is continuous with a whole multiplier; or a leader of type "
                '"revolute"'
            )
            got = f"a {follower.kind} one with multiplier {mimic.multiplier:g}"
            raise element.error(expected, got)
        joints[name] = replace(follower, mimic=mimic)
