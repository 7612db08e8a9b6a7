"""The analytic dynamics: M q̈ + C q̇ + D q̇ + K + g = B u and its derivatives, on Pinocchio.

- `model`: `SoftModel`, the interface of every model, and `State`, its terms at one (q, v);
- `tree`: the model of a robot without mimic joints: springs, dampers, inputs;
- `projection`: a model whose coordinates determine a tree's; `mimic`: the one for mimic joints
  (`build` chooses); `reduced`: the one on a subspace of motions, `reduce`;
- `engine`: Pinocchio's model, built and checked against the strict parse, and views of its memory;
- `kernels`: a State in one compiled function: M, g, the tip's J and J̇, forces;
- `tendons`: lengths, moment arms ∂ℓ/∂q of fixed and spatial tendons, and their gradients;
- `wraps`: courses of cables around cylinders and spheres, with derivatives; `wrapped_paths`: the
  tendons that run around such bodies;
- `points`: a point of a body, its Jacobian and the Jacobian's derivative;
- `coordinates`: places in q of each joint: continuous joints, floating bases;
- `areas`: chambers whose area changes with their stretch;
- `curves`: springs and dampers that are not linear;
- `buoyancy`: the buoyancy of links;
- `relaxation`: Maxwell branches beside the springs of joints, for materials that creep;
- `balls`: the springs and dampers of ball joints;
- `fluid`: the drag of a fluid on the links;
- `forces`: joint forces of one's own, `Force`: the contract and its checked calls;
- `balance`: r = M a + h - B u - E d and its Jacobians, with winches and slow disturbances;
- `implicit_step`: a step of backward Euler with stops, and its exact Jacobians;
- `discretisation`: the motion over a period in such steps, as many as it needs, with A and B;
- `wrench`: `Wrench`, a constant force and torque at a point of a link;
- `stops`: joint limits: which joints they hold, and the steps that they allow;
- `winches`: the input of a motor that commands a cable's free length, and its inverse;
- `motors`: bounded rate and lag of a motor, and its states with their Jacobians;
- `derivatives`: those of accelerations; tangent and gravity stiffness;
- `text`: the lines that ``print`` shows of a model or a State;
- `integrators`: one time step, Runge–Kutta or with implicit damping.

The public names are imported when they are used, as `__init__.pyi` lists them.
"""

import lazy_loader

from softdyn.installed import check_engines

check_engines()  # before a module of the engine is imported

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
