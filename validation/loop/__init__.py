"""The closed loop of a controller and a plant, its log and its figures of merit."""
