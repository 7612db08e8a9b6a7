"""An annotated URDF written as MJCF, for MuJoCo's own viewer: the twin as a file.

All frames have the axes of the root and lie on their joints. Massless links between joints become
several joints of one body. If such a link carries something or branches, it becomes a body with a
mass too small to influence the dynamics.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from lxml import etree

from softdyn.description.inertia import Origin
from softdyn.description.robot import Robot
from softdyn.description.visuals import (
    BoxShape,
    CylinderShape,
    SphereShape,
    Visual,
    triangles,
    visuals,
)
from softdyn.dynamics.text import branches_text
from softdyn.validation.mjcf.comparison.from_urdf import from_urdf
from softdyn.validation.mjcf.comparison.neutral import WORLD, Neutral, NeutralTendon, Point
from softdyn.validation.mjcf.rig_to_mjcf import add_motor, add_sensors, lost_rig
from softdyn.validation.mjcf.transform import Transform
from softdyn.validation.mjcf.xml_text import Names, add, text
from softdyn.validation.twin.bodies import Shape as Collision
from softdyn.validation.twin.bodies import Tree, read_bodies
from softdyn.validation.twin.build import OFF_SURFACE, ON_SURFACE, neighbours
from softdyn.validation.twin.drives import LARGEST_FORCE, UNBOUNDED, sensor_frames, slack_name
from softdyn.validation.twin.rotors import coupling_tendons
from softdyn.validation.twin.settings import STIFF_SOLIMP, STIFF_SOLREF
from softdyn.validation.twin.twin import Twin

NEGLIGIBLE = 1e-12  # kg, and kg·m²: for a massless body that cannot be merged with another
SMALLEST = 1e-14  # kg·m²: MuJoCo's compiler wants moments above 1e-15
POINT = np.array([-1e-9, 1e-9])  # rad, m: half range of a joint with equal limits
AUTOMATIC = (-1.0, -1.0)  # the springlength that MuJoCo replaces by the length at rest
AT_MINUS_ONE = (float(np.nextafter(-1.0, 0.0)),) * 2  # m, rad: the rest -1 as MuJoCo keeps it
ROUNDING = 1e-14  # of a principal moment
SAME_FRAME = 1e-5  # MuJoCo's own bound is 1e-6; axes in another order are never so close
TASK_SITE = "task"
Element = etree._Element


def to_mjcf(
    robot: Robot, *, timestep: float = 5e-4, shapes: bool = True, contacts: bool = False
) -> str:
    """The robot as MJCF, all in one text.

    Parameters
    ----------
    robot : Robot
        The parsed URDF.
    timestep : float
        Integration step (s) that the file asks for.
    shapes : bool
        Whether to write the visual shapes, too; they do not collide.
    contacts : bool
        Whether the collision shapes can touch. They are written in both cases, as in the twin.

    Returns
    -------
    str
        The document, with the options on which the motion depends, the twin's stiffness of stops
        and of mimic joints, and a keyframe at rest.
    """
    return _Writer(robot, from_urdf(robot)).write(timestep, shapes, contacts)


class _Writer:
    """Writes one robot."""

    def __init__(self, robot: Robot, neutral: Neutral) -> None:
        self._robot, self._neutral = robot, neutral
        self._place: dict[str, tuple[int, Transform]] = {
            name: (frame.part, frame.pose) for name, frame in neutral.frames.items()
        }
        self._place |= {part.link: (k, part.pose) for k, part in enumerate(neutral.parts)}
        for ball in robot.balls:
            number = [part.name for part in neutral.parts].index(ball.name)
            place = number, neutral.parts[number].pose
            self._place |= dict.fromkeys(ball.inner_links(robot.joints), place)
        shown, _ = visuals(robot)
        self._shapes: dict[int, list[Visual]] = {}
        for visual in shown:
            self._shapes.setdefault(self._place[visual.link][0], []).append(visual)
        self._tree = tree_of(robot)
        self._hulls: dict[int, list[tuple[Collision, Transform]]] = {}
        for body in self._tree.bodies:
            for hull in body.shapes:
                part, pose = self._place[body.link]
                self._hulls.setdefault(part, []).append((hull, pose))
        self._bodies = Names("world")
        self._body_of: dict[int, str] = {WORLD: "world"}
        self._sites = Names()
        self._meshes = Names()
        self._origin: dict[int, np.ndarray] = {WORLD: np.zeros(3)}
        self._lengths = _lengths(robot, neutral)

    def write(self, timestep: float, shapes: bool, contacts: bool) -> str:
        """The whole document."""
        root = etree.Element("mujoco", model=self._robot.name)
        add(root, "compiler", angle="radian", autolimits="false")
        # only what the motion needs, because other simulators refuse options that they do not know
        option = add(root, "option", gravity=self._neutral.gravity, timestep=timestep,
                     integrator="implicitfast", density=self._robot.fluid.density or None,
                     viscosity=self._robot.fluid.viscosity or None,
                     cone="elliptic" if contacts else None)  # fmt: skip
        if not contacts:
            add(option, "flag", contact="disable")
        self._asset = add(root, "asset")
        world = add(root, "worldbody")
        self._fill(world, WORLD, shapes)
        for part in self._neutral.children(WORLD):
            self._body(world, part, shapes)
        self._apart(root)
        self._cables(root)
        self._ties(root)
        self._motors(root, timestep)
        add_sensors(root, self._robot, timestep)
        self._rest(root)
        if len(self._asset) == 0:
            root.remove(self._asset)
        return text(root, f"{self._robot.name}, written by softdyn from {self._robot.path.name}")

    # -- bodies --------------------------------------------------------------------------------

    def _joins(self, k: int) -> bool:
        """Whether a part is only a joint before the one part that it carries."""
        part, below = self._neutral.parts[k], self._neutral.children(k)
        used = {frame.part for frame in self._neutral.frames.values()}
        used |= self._shapes.keys() | self._hulls.keys()
        used |= {point.part for cable in self._neutral.cables for point in cable.path}
        used.add(self._place[self._robot.task][0])
        used |= {self._place[link][0] for _, link, _ in self._sensor_sites()}
        massless = not part.inertia.mass and not part.inertia.tensor.any()
        return massless and part.kind != "free" and len(below) == 1 and k not in used

    def _body(self, parent: Element, k: int, shapes: bool) -> None:
        """A body with all joints up to the first part that is more than a joint."""
        above = self._origin[self._neutral.parts[k].parent]
        joints = [k]
        while self._joins(joints[-1]):
            joints += self._neutral.children(joints[-1])
        last = self._neutral.parts[joints[-1]]
        for index in joints:
            self._origin[index] = last.point
        name = self._bodies.new(last.link)
        self._body_of |= dict.fromkeys(joints, name)
        body = add(parent, "body", name=name, pos=last.point - above,
                   gravcomp=last.buoyancy or None)  # fmt: skip
        for index in joints:
            self._joint(body, index)
        self._inertial(body, joints[-1])
        self._fill(body, joints[-1], shapes)
        for child in self._neutral.children(joints[-1]):
            self._body(body, child, shapes)

    def _joint(self, body: Element, k: int) -> None:
        part = self._neutral.parts[k]
        if part.kind == "free":
            add(body, "freejoint", name=part.name)
            return
        follows = part.name in {coupling.joint for coupling in self._neutral.couplings}
        limited = np.isfinite(part.lower) and not follows
        span = np.array([part.lower, part.upper])
        if part.lower == part.upper:  # a range must have some width
            span += POINT
        add(
            body, "joint", name=part.name, type=part.kind,
            axis=None if part.kind == "ball" else part.axis,
            pos=part.point - self._origin[k],
            limited="true" if limited else "false",
            range=span if limited else None,
            stiffness=_powers(part.stiffness, part.stiffness_curve), springref=part.rest or None,
            damping=_powers(part.damping, part.damping_curve), armature=part.armature or None,
            frictionloss=part.friction or None,
            solreflimit=STIFF_SOLREF if limited else None,
            solimplimit=STIFF_SOLIMP if limited else None,
            solreffriction=STIFF_SOLREF if part.friction else None,
            solimpfriction=STIFF_SOLIMP if part.friction else None,
        )  # fmt: skip

    def _inertial(self, body: Element, k: int) -> None:
        inertia = self._neutral.parts[k].inertia
        moments, axes = np.linalg.eigh((inertia.tensor + inertia.tensor.T) / 2)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        # the compiler refuses points and rods: give them moments of the size of rounding
        least = max(SMALLEST, 1e-12 * float(moments.max()))
        if not inertia.mass:
            least = NEGLIGIBLE
        moments = possible(np.maximum(moments, least))
        mass = inertia.mass or NEGLIGIBLE
        at = inertia.com - self._origin[k] if inertia.mass else np.zeros(3)
        if _snaps(at) or _snaps(_quaternion(axes)[1:]):
            axes, moments = np.roll(axes, 1, axis=1), np.roll(moments, 1)
        add(body, "inertial", pos=at, quat=_quaternion(axes), mass=mass, diaginertia=moments)

    def _fill(self, body: Element, k: int, shapes: bool) -> None:
        """Sites and shapes of a part, or of the root."""
        origin = self._origin[k]
        for cable in self._neutral.cables:
            for index, point in enumerate(cable.path):
                if point.part == k and point.around in ("", "its side"):
                    name = self._sites.new(f"{cable.name}:{index}")
                    place = site_place(cable.path, index)
                    add(body, "site", name=name, pos=place - origin, size=0.002)
                elif point.part == k and point.radius:
                    self._around(body, cable, index, origin)
        task, pose = self._place[self._robot.task]
        if task == k:
            name = self._sites.new(TASK_SITE)
            add(body, "site", name=name, pos=pose.translation - origin, size=0.004)
        for name, frame in self._neutral.frames.items():
            if frame.part == k:
                add(body, "site", name=self._sites.new(name), pos=frame.pose.translation - origin,
                    quat=_quaternion(frame.pose.rotation), size=0.002)  # fmt: skip
        for name, link, own in self._sensor_sites():
            if (carried := self._place[link])[0] == k:
                at = carried[1] @ Transform(own.rotation, own.translation)
                add(body, "site", name=self._sites.new(name), pos=at.translation - origin,
                    size=0.002, quat=_quaternion(at.rotation))  # fmt: skip
        for visual in self._shapes.get(k, ()) if shapes else ():
            self._shape(body, visual, origin)
        for hull, pose in self._hulls.get(k, ()):
            at = pose.translation + pose.rotation @ hull.pose[:3, 3]
            add(body, "geom", type=hull.kind, size=hull.size, pos=at - origin, group="3", mass=0,
                quat=_quaternion(pose.rotation @ hull.pose[:3, :3]))  # fmt: skip

    def _sensor_sites(self) -> Iterator[tuple[str, str, Origin]]:
        """Name, link and frame of each site of a sensor."""
        for sensor in self._robot.sensors:
            for name, (link, frame) in sensor_frames(sensor).items():
                yield name, link, frame

    def _around(self, body: Element, cable: NeutralTendon, index: int, origin: np.ndarray) -> None:
        """A round body of a cable as a geom without mass and contacts."""
        centre, *more = cable.path[index : index + 2]
        kind: dict[str, object] = {"type": "sphere", "size": centre.radius}
        if more and more[0].around == "its axis":
            turned = _from_z(more[0].xyz - centre.xyz)
            length = self._lengths[cable.name, index]
            kind = {"type": "cylinder", "size": (centre.radius, length / 2), "quat": turned}
        add(body, "geom", name=f"{cable.name}:{index}", pos=centre.xyz - origin, mass=0,
            contype="0", conaffinity="0", group="2", **kind)  # fmt: skip

    def _shape(self, body: Element, visual: Visual, origin: np.ndarray) -> None:
        """A visual as a geom without mass and collisions."""
        _, link = self._place[visual.link]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = link.rotation, link.translation - origin
        pose = pose @ visual.pose
        common = {"rgba": visual.rgba, "contype": "0", "conaffinity": "0", "group": "2", "mass": 0}
        kind: dict[str, object]
        match visual.shape:
            case BoxShape(size):
                kind = {"type": "box", "size": np.array(size) / 2}
            case CylinderShape(radius, length):
                kind = {"type": "cylinder", "size": (radius, length / 2)}
            case SphereShape(radius):
                kind = {"type": "sphere", "size": radius}
            case _:
                if (name := self._mesh(visual)) is None:
                    return
                placed = {"pos": link.translation - origin, "quat": _quaternion(link.rotation)}
                add(body, "geom", type="mesh", mesh=name, **placed, **common)
                return
        add(body, "geom", pos=pose[:3, 3], quat=_quaternion(pose[:3, :3]), **kind, **common)

    def _mesh(self, visual: Visual) -> str | None:
        """The triangles of a mesh as an asset in the link's frame; None if there are too few."""
        corners = triangles(visual).reshape(-1, 3)
        vertices, faces = np.unique(corners.astype(np.float32), axis=0, return_inverse=True)
        if len(vertices) < 4:  # MuJoCo's minimum
            return None
        name = self._meshes.new(f"{visual.link}_shape")
        add(self._asset, "mesh", name=name, inertia="shell",
            vertex=" ".join(f"{v:.7g}" for v in vertices.ravel()),
            face=" ".join(str(f) for f in np.ravel(faces)))  # fmt: skip
        return name

    # -- the rest ------------------------------------------------------------------------------

    def _apart(self, root: Element) -> None:
        """Exclude contacts of bodies that a joint connects, as in the twin."""
        names = [self._body_of[self._place[b.link][0]] if b.link else "world"
                 for b in self._tree.bodies]  # fmt: skip
        pairs = [(names[a], names[b]) for a, b in neighbours(self._tree.bodies)]
        if pairs:
            contact = add(root, "contact")
            for one, other in pairs:
                add(contact, "exclude", body1=one, body2=other)

    def _cables(self, root: Element) -> None:
        if not self._neutral.cables:
            return
        tendon = add(root, "tendon")
        for cable in self._neutral.cables:
            rest = AT_MINUS_ONE if cable.rest == AUTOMATIC else cable.rest
            acts = not (cable.slack and cable.damping)  # if not, an actuator does
            if cable.slack and acts:
                rest = min(0.0, rest[1]) if cable.path else -UNBOUNDED, rest[1]
            node = add(
                tendon, "fixed" if cable.terms else "spatial", name=cable.name, limited="false",
                stiffness=_powers(acts * cable.stiffness, cable.stiffness_curve),
                springlength=rest,
                damping=_powers(acts * cable.damping, cable.damping_curve),
                armature=cable.armature or None,
            )  # fmt: skip
            for joint, coefficient in cable.terms.items():
                add(node, "joint", joint=joint, coef=coefficient)
            for index, point in enumerate(cable.path):
                if not point.around:
                    add(node, "site", site=f"{cable.name}:{index}")
                elif point.radius:
                    side = next((k for k, p in enumerate(cable.path[index + 1 : index + 3], 1)
                                 if p.around == "its side"), None)  # fmt: skip
                    name = None if side is None else f"{cable.name}:{index + side}"
                    add(node, "geom", geom=f"{cable.name}:{index}", sidesite=name)

    def _ties(self, root: Element) -> None:
        if self._neutral.couplings:
            equality = add(root, "equality")
            for tie in self._neutral.couplings:
                add(equality, "joint", joint1=tie.joint, joint2=tie.leader,
                    polycoef=(tie.offset, tie.multiplier, 0, 0, 0),
                    solref=STIFF_SOLREF, solimp=STIFF_SOLIMP)  # fmt: skip

    def _motors(self, root: Element, timestep: float) -> None:
        pulls = [cable for cable in self._neutral.cables if cable.slack and cable.damping]
        actuator = add(root, "actuator") if self._neutral.motors or pulls else root
        for motor in self._neutral.motors:
            add_motor(actuator, motor, timestep)
        for cable in pulls:
            k, d = cable.stiffness, cable.damping
            add(actuator, "general", name=slack_name(cable.name), tendon=cable.name, gear=-1.0,
                gainprm=0.0, biastype="affine", biasprm=(-k * cable.rest[1], -k, -d),
                forcelimited="true", forcerange=(0.0, LARGEST_FORCE))  # fmt: skip

    def _rest(self, root: Element) -> None:
        """q = 0, followers at their offsets, in the order of the bodies."""
        offsets = {tie.joint: tie.offset for tie in self._neutral.couplings}
        qpos: list[float] = []
        for joint in root.iter("joint", "freejoint"):
            if joint.tag == "freejoint":
                qpos += [0, 0, 0, 1, 0, 0, 0]
            elif joint.get("type") == "ball":
                qpos += [1, 0, 0, 0]
            elif joint.get("type") is not None:
                qpos.append(offsets.get(str(joint.get("name")), 0.0))
        if qpos:
            add(add(root, "keyframe"), "key", name="rest", qpos=qpos)


def _lengths(robot: Robot, neutral: Neutral) -> dict[tuple[str, int], float]:
    """The drawn length of each round body, by its cable and place in the neutral path."""
    found = {}
    for tendon, cable in zip(robot.tendons, neutral.cables, strict=True):
        places = (index for index, point in enumerate(cable.path) if point.radius)
        for index, wrap in zip(places, tendon.wraps, strict=True):
            length = 4.0 * wrap.radius if wrap.length is None else wrap.length
            found[cable.name, index] = length
    return found


def site_place(path: Sequence[Point], index: int) -> np.ndarray:
    """The place (3,) of a site in MJCF.

    A site on the surface of a round body of its part stands a little off it: if it is inside by
    rounding, MuJoCo wraps nothing. A side point inside a cylinder stands in the middle: MuJoCo
    takes it for an outer one if it is a radius away from there, along the axis too.
    """
    point = path[index]
    for k, shape in enumerate(path):
        if not shape.radius or shape.part != point.part:
            continue
        beside = [j for j, p in enumerate(path) if not p.around and (j == k - 1 or j > k)][:2]
        side = point.around and k == max(j for j in range(index) if path[j].radius)
        if not side and index not in beside:
            continue
        offset = across = point.xyz - shape.xyz
        if k + 1 < len(path) and path[k + 1].around == "its axis":
            axis = path[k + 1].xyz - shape.xyz
            across = offset - (offset @ axis) / (axis @ axis) * axis
        distance = float(np.linalg.norm(across))
        if side:
            inside = distance < shape.radius <= np.linalg.norm(offset)
            return shape.xyz if inside else point.xyz
        if abs(distance / shape.radius - 1.0) < ON_SURFACE:
            return point.xyz + across * ((1.0 + OFF_SURFACE) * shape.radius / distance - 1.0)
    return point.xyz


def _from_z(axis: np.ndarray) -> np.ndarray:
    """(w, x, y, z) of a rotation that takes z to an axis."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])[0].as_quat()
    return np.array([w, x, y, z])


def _snaps(offset: np.ndarray) -> bool:
    """Whether MuJoCo would replace an inertial frame by its body's, because they are so close."""
    return 0 < float(np.abs(offset).max()) < SAME_FRAME


def possible(moments: np.ndarray) -> np.ndarray:
    """The nearest possible principal moments (3,) in rising order: a + b ≥ c.

    MuJoCo accepts no others. So moments that violate this only in their last digit must be changed.
    """
    excess = max(0.0, float(moments[2] - moments[1] - moments[0])) / 3
    found = moments + excess * np.array([1.0, 1.0, -1.0])
    found[2] = min(found[2], found[0] + found[1])
    return found


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """(w, x, y, z) of a rotation matrix, exact for the identity."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def tree_of(robot: Robot) -> Tree:
    """The bodies as the twin reads them, with their collision shapes."""
    mended = robot.text if robot.mended else ""
    return read_bodies(robot.path, mended=mended, floating=robot.floating)


def lost(robot: Robot) -> list[str]:
    """The properties of the URDF that the MJCF does not state."""
    notes = [*visuals(robot)[1], *tree_of(robot).skipped, *lost_rig(robot)]
    notes += [f"the force {force.name!r} of your own" for force in robot.forces]
    if any(tendon.armature for tendon in robot.tendons):
        notes += [
            f"tendon {name!r}: the coupling of branches by its armature, which MuJoCo leaves out"
            for name in coupling_tendons(Twin(robot).model)
        ]
    notes += [
        f"joint {joint.name!r}: its branches of relaxation, {branches_text(joint)}"
        for joint in robot.moving_joints
        if joint.relaxation
    ]
    for part in from_urdf(robot).parts:
        moments = np.linalg.eigvalsh(part.inertia.tensor)
        excess = moments[2] - moments[1] - moments[0]
        if excess > max(ROUNDING * moments[2], SMALLEST):  # a point's are rounding
            notes.append(
                f"the inertia of {part.link!r}: its principal moments are a + b < c by "
                f"{excess / moments[2]:.1e} c, so the nearest possible ones are written"
            )
    repeated = Counter(link.name for link in robot.links)
    notes += [f"a second link {name!r}" for name, count in repeated.items() if count > 1]
    return notes


def _powers(linear: float, curve: Sequence[float]) -> tuple[float, ...] | None:
    """The coefficients of a spring or a damper, as few as say it; None without any."""
    if any(curve):
        return (linear, *curve)
    return (linear,) if linear else None
