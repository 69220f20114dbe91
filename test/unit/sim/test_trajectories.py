# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Loops of the robots, and the arrangement of a team."""

from itertools import combinations
import math

import numpy as np
import pytest

from fej_slam_ros.sim.trajectories import (
    circle, eight_in_circle, figure_eight, intersecting_circles, LAYOUTS, team_loops)

CURVES = {
    'left circle': lambda length, steps: circle(length, steps, 1),
    'right circle': lambda length, steps: circle(length, steps, -1),
    'figure eight': figure_eight,
}
every_curve = pytest.mark.parametrize('curve', CURVES.values(), ids=CURVES.keys())
every_team = pytest.mark.parametrize('robots', [1, 2, 3, 4, 5])


@every_curve
@pytest.mark.parametrize('steps', [7, 40, 63])
def test_steps_of_a_loop_add_up_to_its_length(curve, steps):
    loop = curve(164.45, steps)
    chords = [math.dist(a, b) for a, b in zip(loop[:-1, :2], loop[1:, :2])]
    assert len(chords) == steps
    assert sum(chords) == pytest.approx(164.45, abs=1e-9)  # rounding of a sum of 63 terms


@every_curve
def test_a_loop_begins_and_ends_at_the_origin(curve):
    loop = curve(100.0, 50)
    np.testing.assert_array_equal(loop[[0, -1]], np.zeros((2, 3)))


@every_curve
def test_heading_is_tangent_to_the_path(curve):
    loop = curve(100.0, 4000)
    dx, dy = (loop[2:, :2] - loop[:-2, :2]).T
    heading = loop[1:-1, 2]
    # Central differences at angular steps of 1.6e-3 rad: (1.6e-3)^2 times derivatives of order 1.
    np.testing.assert_allclose(np.cos(heading) * dy - np.sin(heading) * dx, 0.0, atol=1e-6)
    assert np.all(np.cos(heading) * dx + np.sin(heading) * dy > 0.0)


@pytest.mark.parametrize('turn', [1, -1])
def test_a_circle_lies_on_the_side_to_which_it_turns(turn):
    loop = circle(2.0 * math.pi * 10.0, 100_000, turn)
    distances = np.hypot(loop[:, 0], loop[:, 1] - turn * 10.0)
    np.testing.assert_allclose(distances, 10.0, atol=1e-8)  # chords are 1.6e-10 shorter than arcs


def test_a_figure_eight_crosses_itself_at_a_right_angle():
    loop = figure_eight(211.41, 40)
    np.testing.assert_allclose(loop[10, :2], loop[30, :2], atol=1e-12)  # rounding
    assert math.cos(loop[10, 2] - loop[30, 2]) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize('layout', LAYOUTS.values(), ids=LAYOUTS.keys())
@every_team
def test_all_robots_start_equally_far_from_the_centre(layout, robots):
    loops, middle = team_loops(layout((150.0, 140.0), 40), robots)
    distances = [math.dist(loop[0, :2], middle) for loop in loops]
    assert len(loops) == robots
    assert distances == pytest.approx([distances[0]] * robots)


@every_team
def test_every_two_circles_of_a_team_intersect(robots):
    loops, _ = team_loops(intersecting_circles((164.45, 145.33), 64), robots)
    centres = [loop[:-1, :2].mean(axis=0) for loop in loops]
    radii = [math.dist(loop[0, :2], centre) for loop, centre in zip(loops, centres)]
    for a, b in combinations(range(robots), 2):
        distance = math.dist(centres[a], centres[b])
        assert abs(radii[a] - radii[b]) < distance < radii[a] + radii[b]


def test_the_eight_lies_inside_the_circle():
    (around, eight), _ = team_loops(eight_in_circle((247.20, 211.41), 40), 2)
    centre = around[:-1, :2].mean(axis=0)
    reach = np.hypot(*(eight[:, :2] - centre).T).max()
    assert reach < math.dist(around[0, :2], centre)
