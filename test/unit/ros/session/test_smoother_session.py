# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publications of the smoother, before and after robots are joined."""

import numpy as np
from numpy.testing import assert_array_equal
import pytest

from fej_slam_ros.core.csam.team_solution import solve, TeamMap
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import decoded, incoming, own_results
from fej_slam_ros.ros.messages.common import from_quaternion, from_time
from fej_slam_ros.ros.session import smoother_session
from fej_slam_ros.ros.session.outputs import MAX_PATH
from fej_slam_ros.ros.session.smoother_session import SmootherSession
from fej_slam_ros.ros.topic_types import ODOMETRY
from helpers.paths import BAGS
from helpers.ros import feed, meeting, odometry_message, raw, raw_record, run_settings

RENDEZVOUS = list(bags.read(BAGS / 'rendezvous'))
MEETING = [raw_record(record) for record in meeting()]


def driven(messages, **settings):
    """Return a run that was given messages, and what it published."""
    run = SmootherSession(run_settings(**settings), None)
    return run, [*feed(run, messages), *run.release()]


def overview(run):
    return dict(run.outputs.maps_and_paths())


def levels(run):
    """Return level and message of each part of the team."""
    _, report = run.diagnostics.report(0, at_rest=True)
    return {
        status.name.removeprefix('smoother: '): (status.level, status.message)
        for status in report.status}


def test_every_step_publishes_a_pose_in_the_robots_own_frame():
    _, published = driven(MEETING)

    assert [topic for topic, _ in published] == ['r1/pose', 'r2/pose'] * 5
    assert {message.header.frame_id for _, message in published} == {'r1/map', 'r2/map'}


def planar_pose(transform):
    t, q = transform.translation, transform.rotation
    return np.array([t.x, t.y, from_quaternion(q.x, q.y, q.z, q.w)])


def transforms(published):
    """Return parent, child, stamp [ns] and planar pose of each transform."""
    return [
        (transform.header.frame_id, transform.child_frame_id, from_time(transform.header.stamp),
         planar_pose(transform.transform))
        for topic, message in published if topic == '/tf' for transform in message.transforms]


@pytest.mark.parametrize('is_joined', [False, True])
def test_a_transform_composed_with_the_odometry_is_the_pose_of_the_smoother(is_joined):
    run = SmootherSession(run_settings(
        'p', 'q', shared_landmark_ids=False, publish_smoothed_tf=True, transform_tolerance=0.25),
        None)
    odometry, published = {}, []
    for message in RENDEZVOUS:
        run.receive(message)
        if is_joined:
            list(run.take())
        else:
            published += run.take()
        name, _, kind = message.topic.partition('/')
        if kind == 'odom':
            record = incoming.odometry(decoded(message.raw, ODOMETRY), name)
            odometry[name, record.stamp] = record.pose
    if is_joined:
        list(run.adopt(solve(run.team.task())))
    published += run.release()

    poses = {
        (estimate.robot, estimate.stamp): estimate for estimate in (
            own_results.pose_estimate(message, topic.partition('/')[0])
            for topic, message in published if topic.endswith('/pose'))}
    found = transforms(published)
    assert len(found) == len(poses) > 0
    assert '/tf' in run.outputs.topics
    for parent, child, stamp, transform in found:
        name, _, frame = child.partition('/')
        at = name, stamp - 250_000_000
        assert (frame, parent) == ('odom', 'map' if is_joined else f'{name}/map')
        # Tens of metres in floats, and a quaternion between.
        difference = between(compose(transform, odometry[at]), poses[at].pose)
        np.testing.assert_allclose(difference, 0.0, atol=1e-12)


def test_a_solution_that_fails_is_reported_once_and_keeps_poses_and_the_solution_before(tmp_path):
    given = run_settings('p', 'q', shared_landmark_ids=False)
    run = SmootherSession(given, tmp_path / 'out')
    feed(run, RENDEZVOUS[:700])
    list(run.adopt(solve(run.team.task())))
    before, poses = run.state_hash(), len(run.team.trajectories['q'].stamps)
    list(run.log.take())

    for _ in range(2):
        run.team.new_measurements += 1
        _, task = run.solving()
        run.give_up(task, 'its computation fails with ZeroDivisionError: by zero')
        assert not run.is_solution_due(1)

    sentence = 'not smoothed: its computation fails with ZeroDivisionError: by zero'
    assert sorted(line.text for line in run.log.take()) == [
        f'{name} is {sentence}' for name in 'pq']
    assert [levels(run)[name][0] for name in 'pq'] == [2, 2]
    assert all(levels(run)[name][1].startswith(sentence) for name in 'pq')
    assert run.state_hash() == before
    assert run.alignment()['unsolved'].keys() == {'p', 'q'}
    run.write_files()
    assert len((tmp_path / 'out' / 'trajectory_q.csv').read_text().splitlines()) == poses + 1

    list(run.adopt(solve(run.team.task())))
    assert sorted(line.text for line in run.log.take()) == [
        f'{name} is smoothed again' for name in 'pq']
    assert not any('fails' in levels(run)[name][1] for name in 'pq')


def test_a_solution_that_failed_is_tried_with_new_input_after_a_pause(monkeypatch):
    now = [0]
    monkeypatch.setattr(smoother_session, 'monotonic_ns', lambda: now[0])
    run, _ = driven(MEETING)
    _, task = run.solving()
    run.give_up(task, 'its computation fails')
    now[0] += smoother_session.FAILURE_PAUSE
    assert not run.is_solution_due(1)

    run.team.new_poses += 1

    assert run.is_solution_due(1)


def smoothed_with(change, messages, at):
    """Return the session whose team changes before a message, with a solution at the end."""
    before, after = change
    run = SmootherSession(run_settings(*before, shared_landmark_ids=False), None)
    for number, message in enumerate(messages):
        if number == at:
            run.change_team(after)
            list(run.adopt(solve(run.team.task())))
        run.receive(message)
        list(run.take())
    list(run.close())
    return run


def test_a_robot_that_is_added_before_its_first_message_is_as_one_of_the_first_team():
    of_q = [m for m in RENDEZVOUS if m.topic.startswith('q/')]
    others = [m for m in RENDEZVOUS if m not in of_q]
    messages = [*others[:6], *sorted([*others[6:], *of_q], key=lambda m: m.received)]

    late = smoothed_with((['p'], ['p', 'q']), messages, 6)
    first = smoothed_with((['p', 'q'], ['p', 'q']), messages, 6)

    (of_late,), (of_first,) = late.team.solution.maps, first.team.solution.maps
    assert of_late.frame == of_first.frame == 'map'
    for name in ('p', 'q'):
        # Both end where increments are below 1e-9, from different solutions before.
        np.testing.assert_allclose(
            of_late.trajectories[name].poses, of_first.trajectories[name].poses, atol=1e-8)


def test_a_robot_that_is_removed_stays_in_the_solutions_but_not_on_topics():
    run = smoothed_with((['p', 'q'], ['p']), RENDEZVOUS, 450)

    (joint,) = run.team.solution.maps
    assert {*joint.trajectories} == {'p', 'q'}
    assert len(run.team.trajectories['q'].stamps) < len(run.team.trajectories['p'].stamps)
    topics = {*overview(run), *(topic for topic, _ in run.outputs.of_solution())}
    assert not any('q/' in topic for topic in [*topics, *run.outputs.topics, *run.inputs.topics])


def test_the_state_of_the_input_of_a_robot_is_removed_with_it():
    run = SmootherSession(run_settings('p', 'q', shared_landmark_ids=False), None)
    for message in RENDEZVOUS[:50]:
        run.receive(message)
    assert run.inputs.health.robots.keys() == {'p', 'q'}

    run.change_team(['p'])

    assert run.inputs.health.robots.keys() == {'p'}


def test_a_robot_that_returns_is_lost_until_it_observes_its_landmarks():
    run = smoothed_with((['p', 'q'], ['p']), RENDEZVOUS, 450)

    run.change_team(['p', 'q'])
    feed(run, RENDEZVOUS[450:])

    assert {'q/pose', 'q/path'} <= run.outputs.topics.keys()
    assert run.team.statistics.restart_reasons == {'q': 'it has returned to the team'}


def test_a_request_to_relocalize_is_a_pose_that_loses_the_robot_or_says_why_not():
    run = SmootherSession(run_settings('p', 'q', shared_landmark_ids=False), None)
    with pytest.raises(UsageError, match='q is in no map'):
        run.relocalization('q')
    for number, message in enumerate(RENDEZVOUS):
        if number == 450:
            run.receive(raw_record(run.relocalization('q')))
        run.receive(message)
        list(run.take())

    assert run.team.statistics.restart_reasons == {'q': 'its pose is not known'}
    assert run.team.statistics.pose_priors_used == {'q': 1}


def test_a_run_after_a_reset_has_the_present_team():
    run = smoothed_with((['p', 'q'], ['q']), RENDEZVOUS, 450)

    settings = run.next_settings('').estimation

    assert [robot.name for robot in settings.robots] == ['q']
    assert settings.anchor == 'q'


def test_by_default_only_the_estimator_publishes_transforms():
    run, published = driven(MEETING)

    assert transforms(published) == []
    assert '/tf' not in run.outputs.topics


def test_a_single_robot_publishes_its_own_map():
    run, _ = driven(MEETING, shared_landmark_ids=False)

    list(run.adopt(solve(run.team.task())))

    published = overview(run)
    assert published.keys() == {
        'r1/path', 'r2/path', 'r1/map_landmarks', 'r2/map_landmarks', '~/markers'}
    assert published['r2/map_landmarks'].header.frame_id == 'r2/map'
    assert {m.header.frame_id for m in published['~/markers'].markers[1:]} == {'r1/map', 'r2/map'}
    assert levels(run)['r2'] == (1, 'r2 not joined: it has no rendezvous with another robot')


def test_joined_robots_publish_one_map_and_their_base_nodes():
    run, _ = driven(MEETING)

    base_nodes = dict(run.adopt(solve(run.team.task())))

    published = overview(run)
    assert published.keys() == {'r1/path', 'r2/path', '~/landmarks', '~/markers'}
    assert published['r2/path'].header.frame_id == 'map'
    base = base_nodes['r2/base_node']
    assert base.header.frame_id == 'map'
    # Where r2 was when it started, which exact measurements tell.
    position = base.pose.pose.position
    assert (position.x, position.y) == pytest.approx((1.0, -3.0), abs=1e-6)
    assert levels(run)['r2'] == (0, 'in map')
    assert levels(run)['smoother'] == (0, 'running')


def test_a_robot_that_cannot_be_smoothed_is_an_error():
    run, _ = driven(MEETING)

    list(run.adopt(TeamMap(unsolved={'r1': 'no minimum'})))

    assert levels(run)['r1'] == (2, 'not smoothed: no minimum')


def test_every_publication_is_listed_in_topics():
    run, published = driven(MEETING)
    published += [*run.adopt(solve(run.team.task())), *run.outputs.maps_and_paths()]

    assert {topic for topic, _ in published} < run.outputs.topics.keys()


def test_a_path_is_thinned_and_ends_with_the_newest_pose():
    run, _ = driven([raw('r1/odom', odometry_message(10 * k), 10 * k) for k in range(2500)])
    list(run.adopt(solve(run.team.task())))

    poses = overview(run)['r1/path'].poses

    assert MAX_PATH / 2 < len(poses) <= MAX_PATH
    newest = poses[-1].header.stamp
    assert (newest.sec, newest.nanosec) == (24, 990_000_000)


def test_a_rendezvous_makes_a_solution_due_at_once():
    run = SmootherSession(run_settings('p', 'q', shared_landmark_ids=False), None)
    for message in RENDEZVOUS:
        run.receive(message)
    list(run.release())

    # Nine samples, in both directions.
    assert run.team.new_measurements == 18
    run.team.task()
    assert (run.team.new_measurements, run.team.new_poses) == (0, 0)


def test_without_a_final_solution_the_last_one_is_kept():
    """Poses since then follow from it; sizes of messages are part of the final solution."""
    run = SmootherSession(
        run_settings('p', 'q', shared_landmark_ids=False), None,
        solve_finally=lambda function, task: None)
    for message in RENDEZVOUS[:len(RENDEZVOUS) // 2]:
        run.receive(message)
    list(run.release())
    solution = solve(run.team.task())
    list(run.adopt(solution))
    for message in RENDEZVOUS[len(RENDEZVOUS) // 2:]:
        run.receive(message)

    list(run.close())

    assert run.team.solution.maps == solution.maps
    assert (run.message_sizes, run.alignment()['messages']) == ({}, [])
    solved = next(map_.trajectories['q'] for map_ in solution.maps if 'q' in map_.trajectories)
    kept = [estimate.pose for estimate in run.team.trajectories['q'].estimates()]
    assert len(kept) > len(solved.poses)
    assert_array_equal(kept[:len(solved.poses)], solved.poses)
