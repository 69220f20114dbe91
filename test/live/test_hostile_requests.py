# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""No content of a service request ends a node or stops it for long."""

from functools import cache, partial
from itertools import chain, product
from time import monotonic

import pytest

from helpers.optional import optional
from helpers.ros import write_parameters
from helpers.slow import slow

live_helpers = optional('helpers.live')
messages = optional('rcl_interfaces.msg')
services = optional('rcl_interfaces.srv')
lifecycle = optional('lifecycle_msgs.srv')

pytestmark = pytest.mark.ros

TEAM = {'robots': ['r1', 'r2']}
BIG = 'x' * 1_000_000
#: Fields of values of every type, and of types that ROS does not define.
VALUES = {
    'not set': {'type': 0}, 'bool': {'type': 1, 'bool_value': True},
    'largest': {'type': 2, 'integer_value': 2**63 - 1},
    'smallest': {'type': 2, 'integer_value': -2**63},
    'nan': {'type': 3, 'double_value': float('nan')},
    'inf': {'type': 3, 'double_value': float('inf')},
    'empty': {'type': 4}, 'big': {'type': 4, 'string_value': BIG},
    'control': {'type': 4, 'string_value': '\x01\n\u2028'},
    'bytes': {'type': 5, 'byte_array_value': [b'\x00', b'\xff']},
    'bools': {'type': 6, 'bool_array_value': [True] * 3},
    'integers': {'type': 7, 'integer_array_value': [2**63 - 1] * 3},
    'no integers': {'type': 7}, 'no numbers': {'type': 8}, 'no texts': {'type': 9},
    'nans': {'type': 8, 'double_array_value': [float('nan')] * 3},
    'many numbers': {'type': 8, 'double_array_value': [1.0] * 100_000},
    'texts': {'type': 9, 'string_array_value': ['r1', '']},
    'twice': {'type': 9, 'string_array_value': ['r1', 'r1']},
    'long': {'type': 9, 'string_array_value': ['r1', 'r' * 232]},
    'big text': {'type': 9, 'string_array_value': ['r1', BIG]},
    '10,000 robots': {'type': 9, 'string_array_value': [f'r{k}' for k in range(10_000)]},
    'type 99': {'type': 99}, 'type 255': {'type': 255},
}
NAMES = [
    'robots', 'max_delay', 'landmark_sigma', 'filter', 'map_frame', 'moved_landmarks',
    'r2.odometry_sigma', 'use_sim_time', 'initialpose_robot', 'second_look', 'relative_poses', '',
    ' ', 'a..b', '.', 'r9.odometry_sigma', 'ü', 'k' * 300, BIG, 'qos_overrides.x',
    'qos_overrides./r1/odom.subscription.depth']


def parameter(name, value):
    return messages.Parameter(
        name=name, value=messages.ParameterValue(**VALUES[value]))


def set_all(domain, *parameters, node='estimator'):
    """Set parameters one by one and all at once; return the results."""
    results = domain.ask(
        f'/{node}/set_parameters', services.SetParameters, parameters=parameters).results
    at_once = domain.ask(
        f'/{node}/set_parameters_atomically', services.SetParametersAtomically,
        parameters=parameters).result
    return [*results, at_once]


@pytest.mark.parametrize(('parameters', 'reason'), [
    ([('max_delay', 'type 99')], "'max_delay' has the type 99, which ROS does not define"),
    ([('robots', '10,000 robots')], "'robots' lists 10000 robots: list at most 100"),
    ([('robots', 'long')], 'a name of 232 characters'),
    ([(f'unknown{k}', 'nan') for k in range(200)], "200 parameters are unknown, such as 'unknown"),
    ([('max_delay', 'nan')] * 2000, 'a request sets at most 500 parameters: send several'),
    ([(BIG, 'nan')], "unknown parameter 'xxx"),
])
def test_a_request_that_no_node_can_use_is_refused_with_a_reason(domain, parameters, reason):
    node = domain.estimate(**TEAM)

    results = set_all(domain, *(parameter(*pair) for pair in parameters))

    assert not any(result.successful for result in results)
    assert all(reason in result.reason and len(result.reason) < 2000 for result in results)
    assert node.get_parameter('max_delay').value == 0.1


def test_a_new_robot_whose_topics_ros_refuses_leaves_the_team_as_it_is(domain):
    node = domain.estimate('--remap', f'r3/odom:=/{"n" * 300}', **TEAM)

    results = set_all(domain, messages.Parameter(
        name='robots', value=messages.ParameterValue(type=9, string_array_value=['r1', 'r3'])))

    assert not any(result.successful for result in results)
    assert all("ROS refuses the topic 'r3/odom'" in result.reason for result in results)
    assert list(node.get_parameter('robots').value) == ['r1', 'r2']
    assert domain.node.count_publishers('/r2/pose') == 1


@pytest.mark.parametrize(('node', 'values'), [
    slow('detector', {}), slow('adapter', {'formats': ['marker_array']}), ('simulator', {})])
def test_a_node_without_changeable_parameters_says_why_it_changes_none(
    domain, tmp_path, node, values,
):
    path = write_parameters(tmp_path / 'p.yaml', **TEAM, **values)
    domain.start(node, '--ros-args', '--params-file', path)

    results = set_all(domain, *(
        parameter(name, 'texts') for name in ('robots', 'robot', '')), node=node)

    assert not any(result.successful for result in results)
    assert ["'robots' is read when the node starts" in r.reason for r in results] == [
        True, False, False, True]
    assert "'robot': did you mean 'robots'?" in results[1].reason
    assert results[2].reason == "unknown parameter ''"


def requests():
    """Yield the service and the fields of each request."""
    for name, value in product(NAMES, VALUES):
        for service in ('set_parameters', 'set_parameters_atomically'):
            yield service, {'parameters': [parameter(name, value)]}
    for names in ([], [''], ['unknown'], [BIG], ['.', 'a..b'], [f'u{k}' for k in range(1000)]):
        for service in ('get_parameters', 'get_parameter_types', 'describe_parameters'):
            yield service, {'names': names}
        for depth in (0, 1, 2**64 - 1):
            yield 'list_parameters', {'prefixes': names, 'depth': depth}


def transitions():
    """Yield requests of transitions that are none, or not possible in the state active."""
    for number, label in product((0, 2, 9, 10, 20, 60, 99, 254, 255), ('', 'unknown', BIG)):
        request = lifecycle.ChangeState.Request()
        request.transition.id, request.transition.label = number, label
        yield 'change_state', {'transition': request.transition}


def service_type(service):
    package = lifecycle if service == 'change_state' else services
    return getattr(package, ''.join(word.capitalize() for word in service.split('_')))


def connected(domain, node, service):
    """Return a client whose requests are answered; before discovery answers can get lost."""
    client = domain.node.create_client(service_type(service), f'/{node}/{service}')
    domain.until(client.service_is_ready)
    responses = []

    def is_answered():
        responses.append(client.call_async(service_type(service).Request()))
        return any(response.done() for response in responses)

    domain.until(is_answered)
    return client


@pytest.mark.slow
@pytest.mark.parametrize('node', ['estimator', 'smoother', 'simulator', 'detector', 'adapter'])
def test_no_request_ends_a_node_or_stops_it_for_long(domain, tmp_path, node):
    formats = {'formats': ['marker_array']} if node == 'adapter' else {}
    path = write_parameters(tmp_path / 'p.yaml', **TEAM, **formats)
    process = domain.start(node, '--ros-args', '--params-file', path)
    client_of = cache(partial(connected, domain, node))
    durations = []

    is_managed = node in {'estimator', 'smoother'}
    for service, fields in chain(requests(), transitions() if is_managed else ()):
        client, begin = client_of(service), monotonic()
        response = client.call_async(service_type(service).Request(**fields))
        domain.until(response.done)
        durations.append(monotonic() - begin)
    assert process.poll() is None

    # On an idle machine 0.2 s, nearly all of it for the million characters.
    assert max(durations) < 5.0
