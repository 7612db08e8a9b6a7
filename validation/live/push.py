"""A pull by the mouse on a link: a spring from one of its points to the pointer."""

from __future__ import annotations

import mujoco
import numpy as np

from softdyn import InputError, SoftdynError, SoftModel
from softdyn.description.robot import moving_link_of
from softdyn.statics import rest
from softdyn.validation.twin.build import body_name
from softdyn.validation.twin.twin import Twin
from softdyn.view.live.messages import Push

GRAVITY = 9.81
SHARE = 10.0  # of its length: assumed sag under its own weight of a robot without a stable rest


def hand_stiffness(model: SoftModel) -> float:
    """Stiffness of the mouse's spring (N/m): that of the tip at rest, so that it moves half way.

    For a robot without a stable rest, its weight would stretch the spring by a tenth of its length.
    """
    try:
        largest = float(np.linalg.eigvalsh(rest(model).tip_compliance)[-1]) if model.nv else 0.0
    except (SoftdynError, np.linalg.LinAlgError):
        largest = 0.0
    if largest > 0:
        return 1 / largest
    mass = sum(link.inertia.mass for link in model.robot.links)
    return SHARE * mass * GRAVITY / max(model.robot.length, 1e-3)


class Hand:
    """Pulls a point of a body with an external force in the twin.

    Parameters
    ----------
    model : SoftModel
        The robot.
    q : ndarray, (nq,)
        Its configuration.
    push : Push
        The message of the page.
    stiffness, largest : float
        Stiffness of the spring (N/m), and its largest force (N).

    Raises
    ------
    InputError
        The link does not move.
    """

    def __init__(
        self, model: SoftModel, q: np.ndarray, push: Push, stiffness: float, largest: float
    ) -> None:
        carrier = moving_link_of(model.robot)[push.link]
        fixed = carrier == model.robot.root and not model.robot.floating
        if fixed:
            raise InputError("push.link", "a link that moves", push.link)
        poses = model.link_poses(q)
        self.link, self.to = push.link, push.to
        self.said_at = push.at
        at = np.linalg.solve(poses[carrier], poses[push.link] @ np.append(push.at, 1.0))
        self._at, self._stiffness, self._largest = at[:3], stiffness, largest
        self._body = body_name(model.robot, carrier)
        self.force = self.point = np.zeros(3)

    def pull(self, twin: Twin) -> None:
        """Set the force for the next steps."""
        data, body = twin.data, twin.model.body(self._body).id
        mujoco.mj_kinematics(twin.model, data)
        mujoco.mj_comPos(twin.model, data)
        self.point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ self._at
        force = self._stiffness * (self.to - self.point)
        size = float(np.linalg.norm(force))
        self.force = force if size <= self._largest else force * (self._largest / size)
        arm = self.point - data.xipos[body]
        data.xfrc_applied[body] = np.concatenate((self.force, np.cross(arm, self.force)))
