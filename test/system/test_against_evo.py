# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""APE and RPE of a replayed bag equal those that evo computes from the written files."""

import json

import pytest

from helpers.optional import optional
from helpers.paths import BAGS
from helpers.ros import run_verb

metrics = optional('evo.core.metrics')
sync = optional('evo.core.sync')
file_interface = optional('evo.tools.file_interface')

pytestmark = pytest.mark.needs('evo')

RELATIONS = {
    'position': metrics.PoseRelation.translation_part,
    'heading': metrics.PoseRelation.rotation_angle_rad}


@pytest.fixture(scope='module', params=['two_circles', 'rendezvous'])
def evaluated(request, tmp_path_factory):
    """Return the folder of an evaluated replay, and the evaluation of each robot."""
    folder = tmp_path_factory.mktemp(request.param)
    bag = BAGS / request.param
    assert run_verb('replay', bag, '--params', f'{bag}.yaml', '--output', folder) == 0
    assert run_verb('evaluate', folder, '--no-plots') == 0
    report = json.loads((folder / 'evaluation/evaluation.json').read_text())
    return folder, report['robots']


def trajectories(folder, robot):
    """Return the true and the estimated trajectory, read and associated by evo."""
    true, estimated = (
        file_interface.read_tum_trajectory_file(str(folder / f'evaluation/{robot}{kind}.tum'))
        for kind in ('_truth', ''))
    return sync.associate_trajectories(true, estimated)


def statistics(metric, pair):
    metric.process_data(pair)
    return metric.get_all_statistics()


@pytest.mark.parametrize('kind', RELATIONS)
@pytest.mark.parametrize(('alignment', 'align'), [('unaligned', False), ('robot_aligned', True)])
def test_ape_equals_that_of_evo(evaluated, kind, alignment, align):
    folder, robots = evaluated
    for robot, evaluation in robots.items():
        true, estimated = trajectories(folder, robot)
        if align:
            estimated.align(true)
        by_evo = statistics(metrics.APE(RELATIONS[kind]), (true, estimated))

        for name, value in evaluation['ape'][alignment][kind].items():
            # evo takes angles from cosines, so that one below 1e-5 has an error of 1e-8.
            tolerance = 3e-8 if value < 1e-5 else 1e-9
            assert value == pytest.approx(by_evo[name], abs=tolerance), (robot, name)


def test_trajectories_of_the_run_itself_give_the_same_ape_in_evo(evaluated):
    folder, robots = evaluated
    for robot, evaluation in robots.items():
        true, estimated = (file_interface.read_tum_trajectory_file(str(path)) for path in (
            folder / f'evaluation/{robot}_truth.tum', folder / f'{robot}.tum'))
        by_evo = statistics(
            metrics.APE(RELATIONS['position']), sync.associate_trajectories(true, estimated))

        assert evaluation['ape']['unaligned']['position']['rmse'] == pytest.approx(
            by_evo['rmse'], abs=1e-9)


@pytest.mark.parametrize('kind', RELATIONS)
@pytest.mark.parametrize('length', ['1', '10'])
def test_rpe_equals_that_of_evo(evaluated, kind, length):
    folder, robots = evaluated
    for robot, evaluation in robots.items():
        if evaluation['rpe'][length] is not None:
            metric = metrics.RPE(RELATIONS[kind], float(length), metrics.Unit.meters)
            by_evo = statistics(metric, trajectories(folder, robot))
            rmse = evaluation['rpe'][length][kind]['rmse']
            assert rmse == pytest.approx(by_evo['rmse'], abs=1e-9)
