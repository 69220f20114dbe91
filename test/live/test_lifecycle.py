# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lifecycle of the estimator, a managed node."""

import signal

import pytest

from helpers.optional import optional
from helpers.records import MS
from helpers.ros import meeting, raw_record, write_parameters

live_helpers = optional('helpers.live')
lifecycle = optional('lifecycle_msgs.srv')
rclpy = optional('rclpy')
services = optional('rcl_interfaces.srv')
trigger = optional('std_srvs.srv')

pytestmark = pytest.mark.ros

#: Pauses between messages end no run.
TEAM = {'robots': ['r1', 'r2'], 'stale_after': 60.0}
WAITING = {**TEAM, 'autostart': False}


def change(domain, label):
    """Request a transition; return whether it succeeded."""
    return domain.ask(
        '/estimator/change_state', lifecycle.ChangeState, transition=transition(label)).success


def transition(label):
    """Return the message of a transition."""
    message = lifecycle.ChangeState.Request().transition
    message.label = label
    return message


def requested(domain, *labels):
    """Request transitions without waiting; return their futures."""
    client = domain.node.create_client(lifecycle.ChangeState, '/estimator/change_state')
    domain.until(client.service_is_ready)
    return [
        client.call_async(lifecycle.ChangeState.Request(transition=transition(label)))
        for label in labels]


def state(domain):
    """Return the state that the node reports."""
    return domain.ask('/estimator/get_state', lifecycle.GetState).current_state.label


def start(domain, path, **values):
    """Start an estimator as a process."""
    parameters = write_parameters(path, **values)
    return domain.start('estimator', '--ros-args', '--params-file', parameters)


def await_discovery(domain):
    """Wait for an answer of the node; before discovery is complete answers can get lost."""
    client = domain.node.create_client(lifecycle.GetState, '/estimator/get_state')
    domain.until(client.service_is_ready)
    requests = []

    def answered():
        requests.append(client.call_async(lifecycle.GetState.Request()))
        return any(future.done() for future in requests)

    domain.until(answered)


def stamps(folder):
    """Return the stamps [ms] of the poses of r1 in the files of a run."""
    rows = (folder / 'trajectory_r1.csv').read_text().splitlines()[1:]
    return [int(row.partition(',')[0]) // MS for row in rows]


@pytest.mark.parametrize(('parameters', 'expected'), [
    ({}, 'active'), ({'autostart': True}, 'active'), ({'autostart': False}, 'unconfigured')])
def test_autostart_activates_the_node_by_default(domain, parameters, expected):
    domain.estimate(**TEAM, **parameters)

    assert state(domain) == expected


def test_a_node_that_waits_to_be_configured_says_so(domain):
    estimator = domain.start(
        'estimator', '--ros-args', '-p', 'robots:=[r1]', '-p', 'autostart:=false')
    assert state(domain) == 'unconfigured'

    _, log = domain.finish(estimator, 2)

    assert 'ros2 lifecycle set /estimator configure' in log


def test_transitions_lead_to_their_states_and_only_an_active_node_subscribes(domain):
    domain.estimate(**WAITING)

    for label, expected in [
        ('configure', 'inactive'), ('activate', 'active'), ('deactivate', 'inactive'),
        ('cleanup', 'unconfigured'), ('configure', 'inactive'), ('activate', 'active'),
        ('shutdown', 'finalized'),
    ]:
        assert change(domain, label)
        assert state(domain) == expected
        is_active = expected == 'active'
        for topic in '/r1/odom', '/r2/landmarks', '/ground_truth/landmarks':
            domain.until(
                lambda t=topic, n=is_active: bool(domain.node.count_subscribers(t)) == n)


@pytest.mark.parametrize('transition', [{'label': 'activate'}, {'id': 1}, {'id': 77}])
def test_an_invalid_transition_fails_and_leaves_the_node_active(domain, transition):
    domain.estimate(**TEAM)
    request = lifecycle.ChangeState.Request()
    for name, value in transition.items():
        setattr(request.transition, name, value)

    response = domain.ask(
        '/estimator/change_state', lifecycle.ChangeState, transition=request.transition)

    assert not response.success
    assert state(domain) == 'active'


def test_deactivation_processes_queued_input_and_is_a_gap_in_the_input(domain, tmp_path):
    node = domain.estimate(**TEAM, output=str(tmp_path / 'run'))
    poses = domain.record('r1/pose', live_helpers.POSE)
    before, paused, after = (
        [*map(raw_record, [m for m in meeting(30) if first <= m.stamp // MS < first + 1000])]
        for first in (0, 1000, 2000))

    domain.send(*before)
    domain.until(lambda: node.received == len(before))
    assert change(domain, 'deactivate')
    domain.until(lambda: len(poses) == 10)
    domain.until(lambda: not domain.node.count_subscribers('/r1/odom'))
    domain.send(*paused)
    assert change(domain, 'activate')
    domain.until(lambda: domain.node.count_subscribers('/r1/odom'))
    domain.send(*after)
    domain.until(lambda: node.received == len(before) + len(after))
    domain.end_estimate()

    assert stamps(tmp_path / 'run') == [*range(0, 1000, 100), *range(2000, 3000, 100)]


def test_requests_that_wait_during_a_cleanup_are_refused(domain, tmp_path):
    domain.estimate(**TEAM, checkpoint=str(tmp_path / 'team.checkpoint'))
    names = ['/estimator/save', '/estimator/reset', '/r2/relocalize']
    clients = [domain.node.create_client(trigger.Trigger, name) for name in names]
    for client in clients:
        domain.until(client.service_is_ready)
    assert change(domain, 'deactivate')

    changed, = requested(domain, 'cleanup')
    # Each service gets two requests.
    waiting = [client.call_async(trigger.Trigger.Request()) for client in clients * 2]
    domain.until(lambda: all(future.done() for future in [changed, *waiting]))

    assert changed.result().success
    for name, future in zip(names * 2, waiting):
        assert not future.result().success
        assert future.result().message.startswith(f'{name} ended before ')
    assert state(domain) == 'unconfigured'
    assert not [*tmp_path.iterdir()]


def test_messages_and_timers_that_wait_during_a_cleanup_do_not_end_the_node(domain, monkeypatch):
    # The timer is due while messages are sent.
    monkeypatch.setattr('fej_slam_ros.ros.nodes.session_node.DIAGNOSTICS_PERIOD', 1e-3)
    node = domain.estimate(**TEAM)
    messages = [*map(raw_record, meeting(20))]
    before, waiting = messages[:60], messages[60:]
    domain.send(*before)
    domain.until(lambda: node.received == len(before))

    changed = requested(domain, 'deactivate', 'cleanup')
    domain.send(*waiting)
    domain.until(lambda: all(future.done() for future in changed))

    assert all(future.result().success for future in changed)
    assert state(domain) == 'unconfigured'
    assert node.received == len(before)


def test_cleanup_discards_the_estimate_and_starts_a_new_run(domain, tmp_path):
    node = domain.estimate(**TEAM, output=str(tmp_path / 'run'))
    messages = [*map(raw_record, meeting(10))]

    for runs in 1, 2:
        domain.until(lambda: domain.node.count_subscribers('/r1/odom'))
        domain.send(*messages)
        domain.until(lambda n=runs: node.received == n * len(messages))
        for label in 'deactivate', 'cleanup':
            assert change(domain, label)
        # A parameter that is set in between does not bring the folder of the first run back.
        message = rclpy.Parameter('map_period', value=float(runs)).to_parameter_msg()
        result, = domain.ask(
            '/estimator/set_parameters', services.SetParameters, parameters=[message]).results
        assert result.successful
        for label in 'configure', 'activate':
            assert change(domain, label)

    first, second = tmp_path / 'run', tmp_path / 'run_2'
    assert stamps(first) == stamps(second) == [*range(0, 1000, 100)]
    for name in 'trajectory_r1.csv', 'trajectory_r2.csv', 'landmarks.csv':
        assert (first / name).read_text() == (second / name).read_text()


def test_a_failed_configuration_reports_its_cause_and_can_be_repeated(
    domain, tmp_path, capfd,
):
    (tmp_path / 'summary.json').write_text('{}')
    domain.estimate(**WAITING, output=str(tmp_path))

    assert not change(domain, 'configure')
    assert state(domain) == 'unconfigured'
    error, = (line for line in capfd.readouterr().err.splitlines() if '[ERROR]' in line)
    assert f'{tmp_path / "summary.json"} exists' in error

    (tmp_path / 'summary.json').unlink()
    assert change(domain, 'configure')


@pytest.mark.slow
def test_a_process_that_cannot_be_configured_exits_with_one_sentence(domain, tmp_path):
    (tmp_path / 'summary.json').write_text('{}')

    status, errors = domain.finish(
        start(domain, tmp_path / 'team.yaml', **TEAM, output=str(tmp_path)))

    assert status == 2
    assert errors.startswith(
        f'python3 -m fej_slam_ros estimator: {tmp_path / "summary.json"} exists')
    assert errors.count('\n') == 1


@pytest.mark.slow
def test_parameters_are_checked_before_configuration(domain, tmp_path):
    process = start(domain, tmp_path / 'team.yaml', **WAITING, max_delay=-1.0)

    status, errors = domain.finish(process)

    assert (status, errors.count('\n')) == (2, 1)


@pytest.mark.slow
def test_shutdown_answers_completes_the_files_and_ends_the_process(domain, tmp_path):
    process = start(domain, tmp_path / 'team.yaml', **TEAM, output=str(tmp_path / 'run'))

    await_discovery(domain)
    assert change(domain, 'shutdown')
    status, errors = domain.finish(process)

    assert status == 0, errors
    assert (tmp_path / 'run' / 'summary.json').exists()


@pytest.mark.slow
@pytest.mark.parametrize(('labels', 'files'), [
    ([], False), (['configure'], True), (['configure', 'activate', 'deactivate'], True),
    (['configure', 'cleanup'], True)])
def test_a_signal_ends_the_process_in_any_state_with_complete_files(
    domain, tmp_path, labels, files,
):
    process = start(domain, tmp_path / 'team.yaml', **WAITING, output=str(tmp_path / 'run'))

    await_discovery(domain)
    assert all(change(domain, label) for label in labels)
    status, errors = domain.finish(process, signal.SIGINT)

    assert status == 0, errors
    assert (tmp_path / 'run' / 'summary.json').exists() == files


def test_the_node_can_be_deactivated_while_messages_arrive(domain):
    node = domain.estimate(**TEAM)
    messages = map(raw_record, meeting(300))
    domain.send(*(next(messages) for _ in range(6)))

    for label in ['deactivate', 'activate'] * 5:
        for _, message in zip(range(30), messages):
            domain.send(message)
        assert change(domain, label)

    received = node.received
    domain.until(lambda: domain.node.count_subscribers('/r1/odom'))
    domain.send(*messages)
    domain.until(lambda: node.received > received)
    assert state(domain) == 'active'
