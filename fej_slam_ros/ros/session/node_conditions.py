# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conditions of the topics, files and clock of a node, each with a sentence for users."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from fej_slam_ros.ros.parameters import QOS_OVERRIDES
from fej_slam_ros.ros.session.input_faults import TopicPublishers

#: Condition of a node while simulated time has not begun.
NO_CLOCK = 'waiting for /clock: use_sim_time is set'
#: Per policy, the value that a publisher offers and the one that a subscription requests where
#: the two are incompatible.
QOS_STRENGTHS = {
    'reliability': ('BEST_EFFORT', 'RELIABLE'), 'durability': ('VOLATILE', 'TRANSIENT_LOCAL')}


@dataclass(frozen=True)
class IncompatibleQos:
    """A topic on which another node's quality of service is incompatible with this node's."""

    topic: str  #: its full name
    own: str  #: this node's endpoint, ``subscription`` or ``publisher``
    policy: str  #: the incompatible policy, such as ``reliability``

    def __str__(self) -> str:
        if self.policy not in QOS_STRENGTHS:
            return (
                f'{self.topic}: a subscription requests a {self.policy} that this node does not'
                ' offer: remove it from that subscription')
        offered, requested = QOS_STRENGTHS[self.policy]
        problem, cure = (
            (f'a publisher offers {offered}, this node requests {requested}', offered)
            if self.own == 'subscription' else
            (f'a subscription requests {requested}, this node offers {offered}', requested))
        name = f'{QOS_OVERRIDES}{self.topic}.{self.own}.{self.policy}'
        return f'{self.topic}: {problem}: set {name}: {cure.lower()}'


def also_published(nodes: str) -> str:
    """Return a warning of other nodes that publish the pose of a robot too."""
    return f'its pose is also published by {nodes}: stop one of the nodes, or remap its topics'


@dataclass(frozen=True)
class NodeConditions:
    """Conditions of the topics, files and clock of a node; a run over a bag has none."""

    incompatible: Sequence[IncompatibleQos] = ()  #: topics with incompatible quality of service
    #: publishers on the input topics, by relative name
    publishers: Mapping[str, TopicPublishers] = field(default_factory=dict)
    #: other nodes that publish the pose of a robot, by robot
    other_publishers: Mapping[str, str] = field(default_factory=dict)
    #: why files are not complete or up to date, by parameter
    file_errors: Mapping[str, str] = field(default_factory=dict)
    clock_fault: str = ''  #: why simulated time does not advance, '' if it does
