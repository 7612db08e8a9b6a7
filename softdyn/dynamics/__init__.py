"""The analytic dynamics on Pinocchio: model, State, tendons, derivatives, integrators."""
