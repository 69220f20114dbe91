# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulator define a run that repeats bit for bit."""

import re

import numpy as np
import pytest

from fej_slam_ros.core.records import Odometry, RobotScan, Scan, TrueLandmarks, TruePose
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.session import simulation
from helpers.ros import cdr, write_parameters

SMALL = {'loops': 1, 'steps_per_loop': 8, 'landmarks': 6}


def records_of(**values):
    return list(simulation.parse({**SMALL, **values}).records())


def published(records):
    return [cdr(outgoing.input_message(record)[1]) for record in records]


def test_the_default_is_the_first_environment():
    world = simulation.parse({}).environment.world

    assert (world.environment, world.robots, world.landmarks, world.loops) == (
        'circles', ('r1', 'r2'), 60, 5)


def test_a_start_in_degrees_is_a_warning():
    warnings = []

    simulation.parse({'start': [90.0, 90.0, -90.0]}, warnings.append)

    sentence, = warnings
    assert sentence.startswith("parameter 'start' has an angle of -90 rad, more than a turn")


@pytest.mark.parametrize('environment', ['circles', 'figure_eight'])
def test_the_same_parameters_give_the_same_bytes_at_every_call(environment):
    simulated = simulation.parse({**SMALL, 'environment': environment})

    first = published(simulated.records())

    assert first == published(simulated.records())
    assert first == published(records_of(environment=environment))
    assert first != published(records_of(environment=environment, seed=2))


def test_the_true_world_is_that_of_the_records():
    simulated = simulation.parse(SMALL)

    world, (landmarks, *records) = simulated.true_world(), simulated.records()

    assert isinstance(landmarks, TrueLandmarks)
    for number, point in landmarks.positions.items():
        np.testing.assert_array_equal(point, world.landmarks[number])
    poses = [r.pose for r in records if isinstance(r, TruePose) and r.robot == 'r2']
    np.testing.assert_array_equal(poses, world.true_poses['r2'])


def test_every_robot_gives_odometry_a_scan_and_its_true_pose_at_every_step():
    records = records_of(robots=['a', 'b', 'c'], rate=10)

    assert [(type(r), r.robot, r.stamp) for r in records[1:]] == [
        (kind, robot, 1_000_000_000 + 100_000_000 * k)
        for k in range(9) for robot in 'abc' for kind in (Odometry, Scan, TruePose)]


def test_sensors_are_configured_by_parameters():
    near = records_of(range=1e-3)
    exact = [r for r in records_of(odometry_sigma=[0.1, 0.2, 0.3]) if isinstance(r, Odometry)]

    assert not any(r.observations for r in near if isinstance(r, Scan))
    # Q / dt^2 with steps of 0.2 s.
    np.testing.assert_allclose(
        exact[-1].twist_covariance, np.diag([0.25, 1.0, 2.25]), rtol=1e-12)


@pytest.mark.parametrize('environment', ['circles', 'figure_eight'])
def test_robots_observe_each_other_if_robot_sigma_is_given(environment):
    without = records_of(environment=environment, range=1e3)
    records = records_of(environment=environment, range=1e3, robot_sigma=[0.1, 0.2])

    scans = [r for r in records if isinstance(r, RobotScan)]
    assert [(r.robot, [s.observed for s in r.observations]) for r in scans] == 9 * [
        ('r1', ['r2']), ('r2', ['r1'])]
    np.testing.assert_allclose(scans[0].observations[0].R, np.diag([0.01, 0.04]), rtol=1e-12)
    # All else is measured with the same noise.
    assert published(r for r in records if not isinstance(r, RobotScan)) == published(without)


def test_parameters_of_publishing_do_not_change_the_world():
    simulated = simulation.parse({'speed': 4, 'clock': True, 'wait': False, 'use_sim_time': False})

    assert (simulated.speed, simulated.clock, simulated.wait) == (4.0, True, False)
    assert simulated.environment == simulation.parse({}).environment


@pytest.mark.parametrize('values', [
    {}, {'environment': 'figure_eight', 'robot_sigma': [0.1, 0.2], 'seed': 3, 'speed': 2},
    {'environment': 'sensor_extension', 'robots': ['a', 'b'], 'polar_sigma': [0.5, 0.1]}])
def test_all_parameters_of_a_simulation_make_the_same_simulation(values):
    simulated = simulation.parse(values)

    all_values = simulation.as_parameters(simulated)

    assert simulation.parse(all_values) == simulated
    assert all_values.keys() >= values.keys()
    assert all_values.keys() <= simulation.PARAMETERS.keys()


@pytest.mark.parametrize('environment', ['map_joining', 'sensor_extension'])
def test_robots_that_meet_have_names_and_ids(environment):
    simulated = simulation.parse({'environment': environment, 'robots': ['a', 'b'], 'seed': 2})

    records = [*simulated.records()]

    assert simulated.robot_ids == {'a': 1, 'b': 2}
    assert {r.robot for r in records} == {'a', 'b'}
    seen = [s.observed for r in records if isinstance(r, RobotScan) for s in r.observations]
    assert seen
    assert {*seen} <= {'a', 'b'}


def test_noise_of_robots_that_meet_is_configured_by_parameters():
    records = [*simulation.parse({
        'environment': 'sensor_extension', 'driving_sigma': [0.02, 0.01, 0.1],
        'polar_sigma': [0.5, 1e-6], 'range': 3.0}).records()]

    *_, last = (r for r in records if isinstance(r, Odometry) and r.robot == 'q')
    # Five times the first robot's.
    assert last.twist_covariance[2, 2] == pytest.approx(0.25)
    R = next(s.R for r in records if isinstance(r, Scan) for s in r.observations)
    assert np.linalg.eigvalsh(R)[1] == pytest.approx(0.25)


@pytest.mark.parametrize(('environment', 'values'), [
    ('map_joining', {'loops': 2}), ('sensor_extension', {'landmarks': 10}),
    ('map_joining', {'odometry_sigma': [0.1, 0.1, 0.1], 'range': 3.0}),
    ('map_joining', {'robot_sigma': [0.1, 0.1]}), ('circles', {'polar_sigma': [0.1, 0.1]}),
    ('figure_eight', {'driving_sigma': [1, 1, 1]})])
def test_a_parameter_that_does_not_apply_to_the_environment_is_refused(environment, values):
    sentence = (
        f"parameter '{min(values)}' does not apply to the environment '{environment}': leave it")

    with pytest.raises(UsageError, match=sentence):
        simulation.parse({'environment': environment, **values})


@pytest.mark.parametrize(
    ('wrong', 'sentence'),
    [
        (
            {'landmark': 5, 'strict_parameters': True},
            "unknown parameter 'landmark': did you mean 'landmarks'?",
        ),
        ({'environment': 'ring'}, "'environment' must be one of 'circles', 'figure_eight'"),
        ({'rate': 0}, "parameter 'rate' must be a number from 1e-3 to 1e6, not 0"),
        ({'speed': -1.0}, "parameter 'speed' must be a number from 1e-3 to 1e6, not -1.0"),
        ({'robots': ['r1', 'r1']}, "parameter 'robots' contains 'r1' twice"),
        ({'loops': 0}, "parameter 'loops' must be an integer from 1 to 100000, not 0"),
        ({'landmarks': 10**12}, "'landmarks' must be an integer from 1 to 100000"),
        ({'environment': 'figure_eight', 'steps_per_loop': 1},
         "'steps_per_loop' must be an integer from 2 to 100000, not 1"),
        ({'loops': 1000, 'steps_per_loop': 1001}, '1,001,000 steps, at most 1,000,000'),
        ({'seed': 1.5}, "parameter 'seed' must be an integer, 0 or above, not 1.5"),
        ({'loop_lengths': [1.0]}, "parameter 'loop_lengths' must be two numbers from 1e-3 to 1e6"),
        ({'environment': 'map_joining', 'robots': ['a', 'b', 'c']}, 'has exactly two robots'),
        ({'driving_sigma': [0.1, 0.0, 0.1]}, "'driving_sigma' must be three numbers from 1e-6"),
        ({'polar_sigma': [0.1]}, "parameter 'polar_sigma' must be two numbers from 1e-6 to 1e6"),
        ({'clock': 1}, "parameter 'clock' must be true or false, not 1"),
    ])
def test_a_mistake_is_explained_in_one_sentence(wrong, sentence):
    with pytest.raises(UsageError, match=re.escape(sentence)):
        simulation.parse(wrong)


def test_too_few_landmarks_for_a_start_are_refused():
    with pytest.raises(UsageError, match='landmarks: 1 are too few'):
        records_of(landmarks=1)


def test_the_section_of_the_simulator_is_read_from_a_file(tmp_path):
    path = write_parameters(tmp_path / 'p.yaml', 'simulator', **SMALL)

    assert simulation.load(path) == simulation.parse(SMALL)


def test_an_old_name_of_a_parameter_of_the_estimator_is_reported_as_it_is_written(
        tmp_path, caplog):
    path = write_parameters(tmp_path / 'p.yaml', **SMALL, second_look=True)

    assert simulation.load(path) == simulation.parse(SMALL)
    assert caplog.messages == [f"{path}: unknown parameter 'second_look' is ignored"]


def test_a_mistake_in_a_file_is_explained_with_its_path(tmp_path):
    path = write_parameters(tmp_path / 'p.yaml', 'simulator', sed=1, strict_parameters=True)

    with pytest.raises(UsageError, match=rf"{path}: .*'sed': did you mean 'seed'"):
        simulation.load(path)


def test_every_parameter_is_described_with_its_default():
    described = simulation.PARAMETERS

    assert str(described['rate']) == 'steps per second of simulated time [Hz]; default: 5.0'
    assert all(parameter.default for parameter in described.values())
