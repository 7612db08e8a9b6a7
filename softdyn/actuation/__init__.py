"""Motors between a controller's inputs and the robot.

    from softdyn.actuation import Winches

    winches = Winches(model)
    lengths = winches.commands(state, u)     # free lengths of cable that give the input u
    winches.tensions(state, lengths)         # and back

- `drives`: delay, bounded rate and lag of a motor, and the speed command of a winch;
- `capstan`: friction of cables on their guides.

`Winches` stands in `softdyn.dynamics.winches`, because the balance of forces needs it.
"""

from softdyn.actuation.capstan import Capstan
from softdyn.description.rig import CommandKind
from softdyn.dynamics.winches import Winches

__all__ = ["Capstan", "CommandKind", "Winches"]
