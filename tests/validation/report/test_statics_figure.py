"""Equilibria, shapes and targets are drawn in one plane, that of the robot."""

import numpy as np

from softdyn.validation.report.statics_figure import Plane, around_z

RNG = np.random.default_rng(0)


def test_points_of_an_upright_plane_are_drawn_in_it():
    for angle in (0.0, 0.5, -1.2, np.pi / 2):
        along = np.array([np.cos(angle), np.sin(angle), 0.0])
        flat = RNG.uniform((-0.5, -1), (1.5, 1), (30, 2))
        points = flat[:, :1] * along + flat[:, 1:] * [0, 0, 1]
        plane = Plane.of(points)
        assert plane.holds(points)
        np.testing.assert_allclose(plane.flat(points), 100 * flat, atol=1e-9)
        assert not plane.holds(np.add(points, [0.1, -0.2, 0]))
    assert Plane.of(np.array([[0.1, 0, -0.3], [-0.2, 0, 0.1]])).titles == ("x (cm)", "z (cm)")
    for degrees, title in ((90.0, "y (cm)"), (88.6, "horizontally, 89° from x (cm)")):
        x, y = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        points = np.array([[0.1 * x, 0.1 * y, -0.3], [-0.2 * x, -0.2 * y, 0.1]])
        assert Plane.of(points).titles == (title, "z (cm)")


def test_a_robot_on_a_table_is_seen_from_above():
    points = np.array([[0.1, 0.2, 0.05], [-0.3, 0.4, 0.05], [0.5, -0.1, 0.05]])
    plane = Plane.of(points)
    np.testing.assert_allclose(plane.flat(points), 100 * points[:, :2])


def test_distance_from_the_axis_is_that_of_cylinders():
    np.testing.assert_allclose(around_z(np.array([[0.3, -0.4, 0.2]])), [[50.0, 20.0]])
