# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The figure over levels of noise has every filter in every panel, in its own colour."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.experiments.common.drawing import FILTER_STYLES
from fej_slam_ros.experiments.liu import noise
from fej_slam_ros.experiments.liu.noise_figure import draw
from helpers.figures import paths, png_size, svg, words
from helpers.reports import ENTRIES

pytestmark = pytest.mark.filterwarnings('error')


@pytest.fixture(scope='module')
def means():
    """Return means whose values lie between 1 and 2, the higher the later the case."""
    rng = np.random.default_rng(1)
    return noise.means({
        case: {name: {entry: 1.0 + 0.1 * k + rng.uniform(0.0, 0.1, 50) for entry in ENTRIES}
               for name in noise.NOISE_FILTERS}
        for k, case in enumerate(noise.cases(noise.NOISE_CONFIGURATIONS))})


def test_the_figure_is_a_picture(means):
    assert min(png_size(draw, means)) > 500


def test_the_figure_has_titles_and_a_legend(means):
    found = words(svg(draw, means))

    assert {'NEES / 3', 'position RMSE [m]', 'heading RMSE [rad]'} < set(found)
    for title in ('environment 1, R1', 'environment 1, R2', 'environment 2, R1'):
        assert found.count(title) == 1
    assert [found.count(word) for word in ('2 deg', '4 deg', '5 deg', '10 deg')] == [4, 4, 4, 4]
    assert {'standard EKF', 'FEJ-EKF', 'ideal EKF', 'invariant EKF'} < set(found)


def test_every_panel_has_the_four_levels_of_each_filter(means):
    picture = svg(draw, means)

    for _, colour, *_ in FILTER_STYLES.values():
        lines = [line for line in paths(picture, f'fill: none; stroke.*: {colour}')
                 if len(line) == 4]
        assert len(lines) == 12
        # The values rise with the level, and y goes down in a picture.
        assert all((np.diff(x) > 0.0).all() and (np.diff(y) < 0.0).all()
                   for x, y in (line.T for line in lines))


def test_a_diverged_ideal_filter_does_not_change_the_scale(means):
    diverged = {case: {**rows, 'ideal': {
        entry: replace(mean, value=1e9 * mean.value, margin=1e9)
        for entry, mean in rows['ideal'].items()}} for case, rows in means.items()}

    picture = svg(draw, diverged)

    _, colour, *_ = FILTER_STYLES['fej']
    lines = [line for line in paths(picture, f'fill: none; stroke.*: {colour}') if len(line) == 4]
    usual = [line for line in paths(svg(draw, means), f'fill: none; stroke.*: {colour}')
             if len(line) == 4]
    # There is room for three times the highest value of the others, not for a thousand million.
    assert all(np.ptp(line[:, 1]) > 0.15 * np.ptp(as_usual[:, 1])
               for line, as_usual in zip(lines, usual))
