"""Random annotated robots as URDF text; together they have every feature of the format."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from softdyn.description.urdf import parse_text


def numbers(values: object) -> str:
    """Numbers as the exact decimal text of their doubles."""
    return " ".join(repr(float(x)) for x in np.atleast_1d(np.asarray(values, float)))


def inertial(rng: np.random.Generator, kind: str) -> str:
    """An <inertial> element: a solid of random shape, a point mass, or a flat plate."""
    mass = 10.0 ** rng.uniform(-2, 0)
    center = rng.normal(scale=0.03, size=3)
    if kind == "point":
        tensor = np.zeros((3, 3))
    else:
        points = rng.normal(scale=0.04, size=(6, 3))
        points -= points.mean(axis=0)
        if kind == "plate":
            points[:, 2] = 0.0
        tensor = mass / 6 * sum(p @ p * np.eye(3) - np.outer(p, p) for p in points)
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2)}
    names["izz"] = (2, 2)
    moments = " ".join(f'{name}="{numbers(tensor[k])}"' for name, k in names.items())
    rpy = rng.uniform(-3, 3, 3) if rng.random() < 0.5 else np.zeros(3)
    return (
        f'<inertial><origin xyz="{numbers(center)}" rpy="{numbers(rpy)}"/>'
        f'<mass value="{numbers(mass)}"/><inertia {moments}/></inertial>'
    )


@dataclass
class Draft:
    """A random robot while it is built."""

    rng: np.random.Generator
    parts: list[str] = field(default_factory=list)
    links: list[str] = field(default_factory=list)
    moving: list[tuple[str, str]] = field(default_factory=list)  # (joint, kind)
    armatures: list[str] = field(default_factory=list)
    still: set[str] = field(default_factory=set)  # links that no joint moves
    last: str = ""  # the last link with a joint of its own

    def link(self, body: str = "") -> str:
        """Add a link; names are drawn so that alphabetical order is not the file's."""
        name = f"{self.rng.choice(list('zyxabc'))}_{len(self.links)}"
        self.links.append(name)
        if len(self.links) == 1:
            self.still.add(name)
        self.parts.append(f'<link name="{name}">{body}</link>')
        return name

    def origin(self) -> str:
        """A joint's <origin>, sometimes without an attribute, and sometimes empty."""
        rng = self.rng
        xyz = f'xyz="{numbers(rng.normal(scale=0.15, size=3))}"'
        rpy = f'rpy="{numbers(rng.uniform(-3.1, 3.1, 3))}"'
        full = f"<origin {xyz} {rpy}/>"
        few = ["", f"<origin {xyz}/>", f"<origin {rpy}/>"]
        return str(rng.choice(few)) if rng.random() < 0.15 else full

    def weld(self, parent: str, body: str) -> str:
        """Add a link fixed to `parent`."""
        child = self.link(body)
        if parent in self.still:
            self.still.add(child)
        self.parts.append(
            f'<joint name="{self.rng.choice(list("kpf"))}{child}" type="fixed">{self.origin()}'
            f'<parent link="{parent}"/><child link="{child}"/></joint>'
        )
        return child

    def joint(self, parent: str, body: str, *, armature: bool) -> str:
        """Add a link moved by a joint of random kind."""
        rng = self.rng
        child = self.link(body)
        name = f"{rng.choice(list('qjdm'))}{child}"
        kind = str(rng.choice(["revolute", "revolute", "continuous", "prismatic"]))
        axis = rng.normal(size=3) * 10.0 ** rng.uniform(-1, 1)
        if rng.random() < 0.4:
            axis = np.eye(3)[rng.integers(3)] * rng.choice([-2.0, 1.0])
        span = 0.2 if kind == "prismatic" else 2.5
        limit = f'<limit lower="{numbers(-span * rng.uniform(0.2, 1))}" '
        limit += f'upper="{numbers(span * rng.uniform(0.2, 1))}" effort="1" velocity="1"/>'
        damping = 0.0 if rng.random() < 0.25 else 10.0 ** rng.uniform(-3, -1)
        spring, stiffness = "", 0.0
        if kind != "continuous" and rng.random() < 0.6:
            stiffness = 10.0 ** rng.uniform(-1, 1) * (100 if kind == "prismatic" else 1)
            rest = rng.uniform(-0.3, 0.3) * span
            spring = (
                f'<gazebo reference="{name}"><springStiffness>{numbers(stiffness)}'
                f"</springStiffness><springReference>{numbers(rest)}</springReference></gazebo>"
            )
        alias = f'stiffness="{numbers(stiffness)}"' if spring and rng.random() < 0.3 else ""
        axis_text = "" if rng.random() < 0.1 else f'<axis xyz="{numbers(axis)}"/>'
        self.parts.append(
            f'<joint name="{name}" type="{kind}">{self.origin()}<parent link="{parent}"/>'
            f'<child link="{child}"/>{axis_text}{limit if kind != "continuous" else ""}'
            f'<dynamics damping="{numbers(damping)}" friction="0.1" {alias}/></joint>{spring}'
        )
        if armature or rng.random() < 0.5:
            value = 10.0 ** rng.uniform(-3, -1.5)
            self.armatures.append(f'<joint name="{name}" armature="{numbers(value)}"/>')
        self.moving.append((name, kind))
        self.last = child
        return child


def random_urdf(seed: int, bodies: int = 7) -> str:
    """URDF text of a random robot; the same for the same arguments.

    Parameters
    ----------
    seed : int
        Any non-negative integer.
    bodies : int
        Number of moving links with mass, without massless links, fixed links and the root.
    """
    rng = np.random.default_rng(seed)
    draft = Draft(rng)
    root = draft.link(inertial(rng, "solid") if rng.random() < 0.3 else "")
    carriers = [root]
    if rng.random() < 0.6:
        carriers = [draft.weld(root, inertial(rng, "solid") if rng.random() < 0.5 else "")]
    for _ in range(int(rng.integers(1, bodies + 1))):
        parent = str(rng.choice(carriers[-3:]))
        for _ in range(int(rng.choice([0, 0, 1, 2]))):
            parent = draft.joint(parent, "", armature=True)
            if rng.random() < 0.3:  # a massless link that branches
                carriers.append(draft.joint(parent, inertial(rng, "solid"), armature=False))
        kind = str(rng.choice(["solid", "solid", "solid", "point", "plate"]))
        child = draft.joint(parent, inertial(rng, kind), armature=kind != "solid")
        carriers.append(child)
        if rng.random() < 0.3:
            carriers.append(draft.weld(child, inertial(rng, "solid") if rng.random() < 0.5 else ""))
    return draft_text(draft, seed)


def draft_text(draft: Draft, seed: int) -> str:
    """The finished text, with random tendons, actuators and task frame."""
    rng = draft.rng
    names, tendons = [], []
    for k in range(int(rng.integers(0, 5))):
        name = f"t{rng.integers(10)}_{k}"
        attributes = f'name="{name}"'
        spatial = rng.random() < 0.5
        elastic = rng.random() < 0.4
        if spatial:
            count = int(rng.integers(2, 6))
            path = "".join(
                f'<site link="{rng.choice(draft.links)}"'
                f' xyz="{numbers(rng.normal(scale=0.05, size=3))}"/>'
                for _ in range(count)
            )
        else:
            chosen = [
                joint for joint, kind in draft.moving if not (elastic and kind == "continuous")
            ]
            if not chosen:
                continue
            some = rng.permutation(chosen)[: int(rng.integers(1, 4))]
            path = "".join(
                f'<joint name="{joint}" coef="{numbers(rng.normal())}"/>' for joint in some
            )
        if elastic:
            attributes += f' stiffness="{numbers(10.0 ** rng.uniform(-1, 1))}"'
            if rng.random() < 0.5:
                rest = rng.uniform(0, 0.5) if spatial else rng.choice([-1.0, 0.3])
                attributes += f' rest="{numbers(rest)}"'
        if rng.random() < 0.4:
            attributes += f' damping="{numbers(10.0 ** rng.uniform(-3, -1))}"'
        names.append(name)
        tendons.append(f"<tendon {attributes}>{path}</tendon>")
    actuators = [
        f'<actuator name="u{k}" tendon="{rng.choice(names)}" gear="{numbers(rng.normal())}"'
        f' lower="{numbers(-rng.uniform(0, 2))}" upper="{numbers(rng.uniform(0, 2))}"/>'
        for k in range(int(rng.integers(0, 4)) if names else 0)
    ]
    task = ""
    if rng.random() < 0.7:
        frame = str(rng.choice(draft.links))
        task = f'<task frame="{draft.last if frame in draft.still else frame}"/>'
    block = "\n".join([*draft.armatures, *tendons, *actuators, task])
    body = "\n".join(draft.parts)
    head = f'<robot name="random_{seed}">'
    text = f'{head}\n{body}\n<softdyn version="1">\n{block}\n</softdyn>\n</robot>\n'
    return with_rotors(text, np.random.default_rng((seed, 1)))


def with_rotors(text: str, rng: np.random.Generator) -> str:
    """The file with armatures of some tendons, of those that MuJoCo knows: along one branch."""
    robot = parse_text(text, path=Path("random.urdf"))
    for tendon in robot.tendons:
        chains = [{joint.name for joint in robot.chain(site.link)} for site in tendon.sites]
        over = (
            set[str]().union(*chains) - set[str]().intersection(*chains)
            if chains
            else {term.joint for term in tendon.terms}
        )
        moving = [joint for joint in robot.moving_joints if joint.name in over]
        ways = [{joint.name for joint in robot.chain(joint.child)} for joint in moving]
        together = {joint.name for joint in moving} <= max(ways, key=len, default=set())
        if rng.random() < 0.3 and together:
            name = f'<tendon name="{tendon.name}"'
            text = text.replace(name, f'{name} armature="{numbers(10.0 ** rng.uniform(-3, 0))}"')
    return text


def write_robot(seed: int, folder: Path, bodies: int = 7) -> Path:
    """Write a random robot to `folder` and return its path."""
    path = folder / f"random_{seed}.urdf"
    path.write_text(random_urdf(seed, bodies), encoding="utf-8")
    return path
