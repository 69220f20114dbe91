# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run continues when its team changes, with topics and files of the present robots."""

import pytest

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.ros import meeting, odometry_message, raw, raw_record, run_settings, seen

MEETING = [raw_record(record) for record in meeting()]


def odom(robot, ms):
    return raw(f'{robot}/odom', odometry_message(ms), ms)


@pytest.fixture
def run(tmp_path):
    """Return a run in mid-meeting that writes files."""
    settings = run_settings(
        anchor_sigma=(0.1, 0.1, 0.1), odometry_sigma=(0.4, 0.4, 0.2), robot_noise_scale=2.0)
    run = EstimatorSession(settings, tmp_path / 'out')
    for message in MEETING:
        run.receive(message)
    list(run.release())
    yield run
    run.discard_files()


def test_topics_follow_the_team(run):
    run.change_team(['r2', 'r3'])

    assert {topic.partition('/')[0] for topic in run.inputs.topics} == {
        'r2', 'r3', 'ground_truth', 'initialpose'}
    of_robots = {topic.partition('/')[0] for topic in run.outputs.topics}
    assert of_robots == {'r2', 'r3', '~', ''}


def test_added_robots_get_files_and_removed_robots_keep_theirs(run, tmp_path):
    run.change_team(['r1', 'r3'])
    run.receive(odom('r3', 500))

    list(run.close())
    summary = run.write_files()

    lengths = {
        name: len((tmp_path / 'out' / f'trajectory_{name}.csv').read_text().splitlines())
        for name in ('r1', 'r2', 'r3')}
    assert lengths == {'r1': 6, 'r2': 6, 'r3': 2}
    assert summary['robots'].keys() == {'r1', 'r2', 'r3'}


def test_a_path_ends_with_its_robot(run):
    run.change_team(['r1'])

    topics = {topic for topic, _ in run.outputs.maps_and_paths()}

    assert 'r1/path' in topics
    assert not any(topic.startswith('r2/') for topic in topics)


def test_an_added_robot_has_the_settings_of_the_team_and_its_own_id(run):
    run.change_team(['r3', 'r1', 'r2'])

    r3 = run.estimator.robots['r3']
    assert (r3.id, r3.odometry_sigma, r3.start_pose) == (3, (0.4, 0.4, 0.2), None)
    assert r3.robot_noise_scale == 2.0


def test_waiting_scans_are_rejected_when_their_robot_is_removed(run):
    run.change_team(['r1', 'r2', 'r3'])
    run.receive(raw('r3/landmarks', seen((1, 1.0, 0.0), ms=400, frame='laser'), 400))

    run.change_team(['r1', 'r2'])

    assert run.estimator.statistics.rejection_counts['r3'] == {RejectionReason.LEFT: 1}


class UnknownMissed:
    """Messages of which it is unknown how many were missed."""

    def missed(self, _topic):
        return None

    def forget(self, _topic):
        pass


def test_odometry_held_for_a_late_start_is_rejected_when_its_robot_is_removed():
    run = EstimatorSession(run_settings(known=[('r2', (1.0, 0.0, 0.0), (0.1, 0.1, 0.1))]), None)
    run.check_starts(UnknownMissed())
    far = [raw('r2/odom', odometry_message(ms, (3.0, 0.0, 0.0)), ms) for ms in (0, 100)]
    for message in far:
        run.receive(message)

    run.change_team(['r1'])

    assert run.estimator.statistics.rejection_counts['r2'] == {RejectionReason.LEFT: 2}
    list(run.close())
    assert run.estimator.statistics.received['r2'] == 2
    # Nothing is said of the start of a robot that is not there.
    assert [line.text for line in run.log.take()] == ['first data of r2 on r2/odom']


@pytest.mark.parametrize('names', [[], ['r1', 'r1'], ['no name'], ['filter'], 'r1', [1]])
def test_a_value_that_is_no_team_is_refused(run, names):
    with pytest.raises(UsageError, match='robots'):
        run.change_team(names)

    assert list(run.estimator.robots) == ['r1', 'r2']


def test_the_anchor_cannot_be_removed_before_it_has_seen_a_landmark():
    run = EstimatorSession(run_settings(), None)

    with pytest.raises(UsageError, match="anchor 'r1' cannot be removed before it has seen"):
        run.change_team(['r2'])

    assert list(run.estimator.robots) == ['r1', 'r2']


def test_adding_a_robot_whose_files_exist_is_refused(run, tmp_path):
    (tmp_path / 'out' / 'r3.tum').write_text('of an earlier run')

    with pytest.raises(UsageError, match=r'r3\.tum exists'):
        run.change_team(['r1', 'r3'])

    assert list(run.estimator.robots) == ['r1', 'r2']


def test_a_parameter_that_is_set_to_its_present_value_is_no_change(run):
    present = run.estimator.settings.gate_probability

    run.change_parameters({'gate_probability': present, 'join_min_landmarks': 4})

    assert [change.parameter for change in run.changes] == ['join_min_landmarks']
