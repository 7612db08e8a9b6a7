"""Controllers: each a class C(model, gains=None) whose instances map (State, Reference) → Command."""

from controllers.controller import Command, Controller, InputGuard, Status
from controllers.gains import Gains
from controllers.id_clf_qp import SoftIdClfQp

# command-line name → class
CONTROLLERS = {controller.name: controller for controller in (SoftIdClfQp,)}

__all__ = ["CONTROLLERS", "Command", "Controller", "Gains", "InputGuard", "SoftIdClfQp", "Status"]
