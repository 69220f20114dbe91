# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figures show what the paper's do, checked by their SVG."""

import re

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.stats import chi2

from fej_slam_ros.experiments.common.drawing import FILTER_STYLES
from fej_slam_ros.experiments.liu.configurations import (
    Configuration, CONFIGURATIONS, own_world, TABLE_FILTERS)
from fej_slam_ros.experiments.liu.figures import draw_errors, draw_worlds, ROBOT_MARKERS
from fej_slam_ros.experiments.liu.monte_carlo import Errors
from helpers.figures import paths, png_size, svg, words

pytestmark = pytest.mark.filterwarnings('error')

RUNS = 10
COLOURS = [FILTER_STYLES[name].colour for name in TABLE_FILTERS.values()]
#: Steps of a loop and of all five, by environment.
STEPS = {1: (63, 315), 2: (40, 200)}
#: 95 % of means over ten runs of NEES / 3 lie between these.
LOW, HIGH = chi2.interval(0.95, 3 * RUNS) / np.array(3 * RUNS)


def made_up_errors(last, nees=(1.0, 1.0, 1.0)):
    """Return made-up errors of the filters, whose NEES do not change."""
    rng = np.random.default_rng(1)
    by_filter = {}
    for name, value in zip(TABLE_FILTERS, nees):
        poses = {
            robot: rng.uniform(0.1, 2.0, (RUNS, 3, steps))
            for robot, steps in (('r1', last), ('r2', last + 1))}
        for steps in poses.values():
            steps[:, 2] = value
        by_filter[name] = Errors(poses, np.ones((RUNS, 2, 20)))
    return by_filter


def test_worlds_stand_side_by_side_in_a_picture():
    one, three = (
        png_size(draw_worlds, {c: own_world(c) for c in CONFIGURATIONS[:count]})
        for count in (1, 3))

    # The margins of a picture are as wide for one world as for three.
    assert three[0] == pytest.approx(3 * one[0], rel=0.02)
    assert three[1] == one[1]
    assert min(one) > 500


def test_each_world_shows_a_loop_of_each_robot_and_all_landmarks():
    picture = svg(draw_worlds, {c: own_world(c) for c in CONFIGURATIONS[3:]})

    assert {'20 landmarks', '60 landmarks', '100 landmarks'} < set(words(picture))
    assert words(picture)[-3:] == ['r1, first loop', 'r2, first loop', 'landmark']
    loop, _ = STEPS[2]
    for colour, _ in ROBOT_MARKERS:
        markers = re.findall(f'<use [^>]*stroke: {colour}', picture)
        assert len(markers) == 3 * (loop + 1) + 1  # one in the legend
    landmarks = re.findall(r'<use [^>]*stroke: #000000; stroke-linejoin: miter"', picture)
    assert len(landmarks) == 20 + 60 + 100 + 1


@pytest.mark.parametrize('configuration', [Configuration(1, 60), Configuration(2, 100)], ids=str)
def test_error_curves_are_a_picture(configuration):
    _, last = STEPS[configuration.environment]

    assert min(png_size(draw_errors, configuration, made_up_errors(last))) > 500


def test_error_curves_have_titles_and_a_legend():
    found = words(svg(draw_errors, Configuration(1, 60), made_up_errors(315)))

    assert found[-6:] == [
        'Environment 1, 60 landmarks, 10 runs', 'standard EKF', 'ideal EKF', 'FEJ-EKF',
        '95 % of consistent filters', 'first loop closure']
    assert [found.count(word) for word in ('r1', 'r2', 'step')] == [1, 1, 2]
    assert {'NEES / 3', 'position RMSE [m]', 'heading RMSE [rad]'} < set(found)


@pytest.mark.parametrize('environment', [1, 2])
def test_every_panel_has_a_line_of_each_filter_and_of_the_first_loop_closure(environment):
    loop, last = STEPS[environment]

    picture = svg(draw_errors, Configuration(environment, 60), made_up_errors(last))

    closures = [p for p in paths(picture, 'stroke-dasharray') if p[0, 0] == p[-1, 0]]
    assert len(closures) == 6
    for colour in COLOURS:
        *lines, _ = paths(picture, f'stroke: {colour}')
        # Columns in turn: r1 is drawn from step 1, r2 from step 0, both to the last.
        for line, closure, first in zip(lines, closures, 3 * [1, 0], strict=True):
            (begin, _), *_, (end, _) = line
            step = first + (closure[0, 0] - begin) / (end - begin) * (last - first)
            assert step == pytest.approx(loop, abs=1e-3)  # coordinates have six decimals


def test_the_band_covers_a_consistent_filter():
    picture = svg(draw_errors, Configuration(1, 20), made_up_errors(315, nees=(LOW, HIGH, 1.0)))

    *bands, _ = paths(picture, 'fill: #(?!ffffff)')
    assert len(bands) == 2
    low, high = (paths(picture, f'stroke: {colour}') for colour in COLOURS[:2])
    for panel, band in enumerate(bands):
        edges = [low[panel][0, 1], high[panel][0, 1]]
        assert_allclose([band[:, 1].max(), band[:, 1].min()], edges, atol=1e-4)  # as above
