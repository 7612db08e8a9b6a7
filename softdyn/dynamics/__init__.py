"""The analytic dynamics: M q̈ + C q̇ + D q̇ + K + g = B u and its derivatives, on Pinocchio.

- `model`: `SoftModel`, what every model answers, and `State`, its terms at one (q, v);
- `tree`: the model of a robot whose joints all move by themselves: springs, dampers, inputs;
- `projection`: a model whose coordinates determine a tree's; `mimic`: that of a robot with mimic
  joints (`build` chooses); `reduced`: that of a robot on a subspace, `reduce`;
- `engine`: Pinocchio's model, built and held against the strict parse, and its memory in view;
- `kernels`: a State in one compiled function: M, g, the tip's J and J̇, forces;
- `tendons`: lengths, moment arms ∂ℓ/∂q of fixed and spatial tendons, and their gradients;
- `coordinates`: where the numbers of q stand: continuous joints, floating bases;
- `derivatives`: of accelerations and forces by q, q̇ and u; tangent and gravity stiffness;
- `mjcf_reader`: what Pinocchio's own reader makes of an MJCF, for a comparison alone;
- `text`: what ``print`` shows of a model or a State;
- `integrators`: one time step, Runge–Kutta or with implicit damping.
"""
