# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters that change at any time during a run break nothing."""

import numpy as np
import pytest

from fej_slam_ros.ros.session import simulation
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.ros import raw_record, run_settings
from helpers.slow import slow

#: Two robots among 12 landmarks for 12 s, whose data arrive in order of their stamps.
RECORDS = [
    record for record in simulation.parse(
        {'loops': 2, 'steps_per_loop': 30, 'landmarks': 12, 'rate': 5}).records()
    if hasattr(record, 'robot')]
#: Random values of parameters by name.
CHANGES = {
    'max_delay': lambda rng: rng.uniform(0.0, 1.0),
    'stale_after': lambda rng: rng.uniform(0.0, 3.0),
    'future_limit': lambda rng: rng.uniform(1.0, 5.0),
    'gate_probability': lambda rng: rng.uniform(0.9, 1.0),
    'landmark_noise_scale': lambda rng: rng.uniform(0.5, 2.0),
    'r2.odometry_noise_scale': lambda rng: rng.uniform(0.5, 2.0),
    'inflate_rejected_scans': lambda rng: bool(rng.integers(2)),
    'moved_landmarks': lambda rng: str(rng.choice(['report', 'forget', 'ignore'])),
    'join_min_landmarks': lambda rng: int(rng.integers(2, 6)),
}


def delayed(rng):
    """Return the messages in an order of arrival with delays of up to 0.6 s."""
    arrivals = [record.stamp + rng.integers(600_000_000) for record in RECORDS]
    return [raw_record(RECORDS[k]) for k in np.argsort(arrivals, kind='stable')]


def changing_run(seed, probability):
    """Return a closed session whose parameters changed at random, and the steps it made."""
    rng = np.random.default_rng(seed)
    session, steps = EstimatorSession(run_settings(), None), []
    for message in delayed(rng):
        session.receive(message)
        if rng.uniform() < probability:
            name = str(rng.choice([*CHANGES]))
            session.change_parameters({name: CHANGES[name](rng)})
        steps += session.estimator.take()
    session.inputs.close()
    return session, steps + list(session.estimator.close())


@pytest.mark.parametrize('seed', [0, 1, *map(slow, range(2, 40))])
def test_every_message_is_counted_once_and_every_robot_goes_on_in_order(seed):
    session, steps = changing_run(seed, probability=0.2)

    statistics = session.estimator.statistics
    for robot in ('r1', 'r2'):
        sent = sum(record.robot == robot for record in RECORDS)
        assert statistics.received[robot] == sent
        assert session.estimator.used(robot) + statistics.rejected[robot] == sent
        stamps = [pose.stamp for step in steps for pose in step.poses if pose.robot == robot]
        assert stamps == sorted(set(stamps))
    assert len(session.changes) > 20


def test_a_change_back_before_the_next_step_changes_no_bit():
    still, _ = changing_run(0, probability=0.0)
    session = EstimatorSession(run_settings(), None)
    for message in delayed(np.random.default_rng(0)):
        session.receive(message)
        for value in (2.0, 1.0):
            session.change_parameters({'landmark_noise_scale': value, 'max_delay': 0.1 * value})
        list(session.estimator.take())
    session.inputs.close()
    list(session.estimator.close())

    assert session.estimator.state_hash() == still.estimator.state_hash()
