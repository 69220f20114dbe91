# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A namespace moves the whole team: inputs, outputs, services and parameters."""

import pytest

from helpers.optional import optional

live = optional('helpers.live')
lifecycle = optional('lifecycle_msgs.srv')
rcl = optional('rcl_interfaces.srv')

pytestmark = pytest.mark.ros

#: Topics that stay where they are: by REP-107, tf2 and the ROS clock.
GLOBAL_TOPICS = {
    '/diagnostics', '/tf', '/tf_static', '/clock', '/rosout', '/parameter_events'}
#: Parameters in all sections that apply to the node /fleet/estimator, in the notation of ROS.
PARAMETERS = {
    '/fleet/estimator': ('max_delay', 0.25), '/**': ('future_limit', 4.5),
    '/**/estimator': ('clock_limit', 0.5), '/*/estimator': ('map_period', 0.2),
    'fleet/estimator': ('gate_probability', 0.5)}


@pytest.fixture
def start_in_fleet(domain, tmp_path):
    """Return what starts a node in the namespace /fleet with parameters, by sections."""

    def start(verb, **sections):
        path = tmp_path / f'{verb}.yaml'
        path.write_text(''.join(
            f'{name}:\n  ros__parameters:\n' + ''.join(f'    {line}\n' for line in lines)
            for name, lines in sections.items()))
        domain.start(verb, '--ros-args', '-r', '__ns:=/fleet', '--params-file', path)

    return start


@pytest.mark.slow
def test_parameters_for_the_node_in_its_namespace_reach_it(domain, start_in_fleet):
    start_in_fleet(
        'estimator', **{'/fleet/*': ['robots: [a, b]']},
        **{section: [f'{name}: {value}'] for section, (name, value) in PARAMETERS.items()})

    names, expected = zip(*PARAMETERS.values())
    response = domain.ask('/fleet/estimator/get_parameters', rcl.GetParameters, names=names)

    assert tuple(value.double_value for value in response.values) == expected


def test_a_team_in_a_namespace_is_estimated_there_and_only_there(domain, start_in_fleet):
    poses = domain.listen('/fleet/r2/pose', live.POSE)
    start_in_fleet('estimator', **{'/**': ['robots: [r1, r2]']})
    start_in_fleet('simulator', **{'/**': ['speed: 4.0']})

    domain.until(lambda: poses and poses[-1].header.frame_id == 'map')

    outside = {
        name for name, _ in domain.node.get_topic_names_and_types()
        if not name.startswith('/fleet/')}
    assert outside <= GLOBAL_TOPICS
    assert domain.call('/fleet/estimator/reset')
    state = domain.ask('/fleet/estimator/get_state', lifecycle.GetState).current_state
    assert state.label == 'active'
