# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Conditions of the input of one robot, each with its level and one sentence.

A robot may send odometry only, or scans only now and then: a topic of observations that is silent
is a fault if it came at a steady rate before, if its publisher has gone, or if the robot needs
observations to get into ``map``.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.sentences import reasons_in_words
from fej_slam_ros.ros.session.faults import Fault, Level
from fej_slam_ros.ros.session.input_health import (
    InputHealth, MAX_SPEED_SIGMA, MIN_GATE_SAMPLE, RobotHealth, UNMOVED_MESSAGES,
    VARIANCE_MESSAGES)
from fej_slam_ros.ros.session.topic_flow import RATE_WINDOW, TopicFlow
from fej_slam_ros.ros.topic_types import MEASUREMENT_TOPICS, OBSERVATION_TOPICS, SENT_TOPICS

#: Fraction of gated observations above which to warn, and above which it is an error; a correct
#: one is gated with probability 0.001.
GATED_WARN, GATED_ERROR = 0.5, 0.9

#: Minimum number of observations, and minimum time [ns], of which none is used. Observations wait
#: for the odometry of other robots, so the time also is at least twice the longest such wait.
MIN_UNUSED = 3
MIN_UNUSED_TIME = 2 * NS

#: Reasons for which input beyond a limit is rejected, and the sentence on each.
LIMITS = {
    RejectionReason.TOO_MANY_NEW:
        '{n} observations without ID matched no landmark, more than a scan may start: does the'
        ' detector report clutter?',
    RejectionReason.MAP_FULL:
        '{n} new landmarks were not started, the map is full: raise max_landmarks, or check the'
        ' IDs',
    RejectionReason.OVERLOAD:
        '{n} scans were dropped, their observations take longer to process than they last: publish'
        ' fewer',
}
#: Reasons for which odometry of two drivers on one topic is rejected.
CONTRADICTIONS = {RejectionReason.IMPOSSIBLE_MOTION, RejectionReason.CONFLICTING}
#: Rate of a topic [Hz] above which it takes most of the time of a node.
MAX_RATE = 1000.0

#: Delay of the other robots [ns] above which to warn: poses of half a second ago are of no use to
#: a controller, and odometry at 5 Hz stays below half of it.
MAX_LAG = NS // 2
#: Difference of delays [ns] by which observations and odometry have different clocks; cameras and
#: detectors need less time.
MAX_PROCESSING = 10 * NS
#: Multiple of the usual gap of the others' odometry up to which a delay is normal, so that a team
#: whose robots all send slowly is none.
NORMAL_LAG_RATIO = 3


class TopicPublishers(NamedTuple):
    """The publishers on a topic."""

    topic: str  #: full name of the topic
    types: tuple[str, ...]  #: type of each publisher
    #: why some of them are incompatible, '' if they are not
    incompatible: str = ''


@dataclass(frozen=True)
class RobotInput:
    """The input of one robot at the time of a report."""

    robot: str  #: its name
    now: int  #: time of the report [ns]
    team: InputHealth  #: health of the input of all robots
    #: whether the robot needs observations to get into ``map``
    needs_observations: bool
    #: publishers on the topics of the team, by relative name, empty if unknown
    publishers: Mapping[str, TopicPublishers]

    @property
    def health(self) -> RobotHealth:
        """Return the health of the input of the robot."""
        return self.team.robots[self.robot]

    def flow(self, kind: str) -> TopicFlow:
        """Return the messages on a topic of the robot."""
        return self.health.flows[kind]

    def has_stopped(self, kind: str) -> bool:
        """Return whether a topic that sent messages has stopped."""
        return self.flow(kind).has_stopped(self.now, self.team.stale_after)

    def topic(self, kind: str) -> str:
        """Return the name of a topic."""
        name = f'{self.robot}/{kind}'
        return self.publishers[name].topic if name in self.publishers else name

    def types(self, kind: str) -> tuple[str, ...] | None:
        """Return the types of the publishers on a topic, None if unknown."""
        found = self.publishers.get(f'{self.robot}/{kind}')
        return None if found is None else found.types

    def has_no_publisher(self, kind: str) -> bool:
        """Return whether a topic is known to have no publisher of its type."""
        types = self.types(kind)
        return types is not None and SENT_TOPICS[kind] not in types

    def is_expected(self, kind: str) -> bool:
        """Return whether the publishers of a topic are known, and none of them is at fault."""
        found = self.publishers.get(f'{self.robot}/{kind}')
        return found is not None and not (
            found.incompatible or {*found.types} - {SENT_TOPICS[kind]})


def faults(given: RobotInput) -> list[Fault]:
    """Return all conditions of a robot's input."""
    return [found for condition in CONDITIONS for found in condition(given)]


def _other_type(given: RobotInput) -> Iterator[Fault]:
    for kind in MEASUREMENT_TOPICS:
        others = {*(given.types(kind) or ())} - {SENT_TOPICS[kind]}
        if others:
            yield Fault(Level.ERROR, (
                f'{given.topic(kind)} is published as {", ".join(sorted(others))}, this node needs'
                f' {SENT_TOPICS[kind]}'))


def _several_drivers(given: RobotInput) -> Iterator[Fault]:
    count = (given.types('odom') or ()).count(SENT_TOPICS['odom'])
    # The publisher of a driver that died is known for some time beside that of the next one.
    if count > 1 and CONTRADICTIONS & given.health.observations.recently_rejected().keys():
        yield Fault(Level.ERROR, (
            f'{given.topic("odom")} has {count} publishers that contradict each other: stop all'
            ' but one, or remap their topics'))


def _incompatible_qos(given: RobotInput) -> Iterator[Fault]:
    for kind in MEASUREMENT_TOPICS:
        found = given.publishers.get(f'{given.robot}/{kind}')
        if found is not None and found.incompatible:
            yield Fault(Level.ERROR, found.incompatible)


def _no_odometry(given: RobotInput) -> Iterator[Fault]:
    if not given.flow('odom').received:
        if given.types('odom') == ():
            yield Fault(Level.WARN, f'{given.topic("odom")} has no publisher')
        elif given.is_expected('odom'):
            yield Fault(Level.WARN, f'no message on {given.topic("odom")} yet')


def _odometry_stopped(given: RobotInput) -> Iterator[Fault]:
    if given.has_stopped('odom'):
        yield Fault(Level.STALE, _stopped(given, 'odom', 'odometry'))


def _no_observations(given: RobotInput) -> Iterator[Fault]:
    # Without odometry, observations are of no use.
    has_odometry = given.flow('odom').received > 0
    has_observations = any(given.flow(kind).received for kind in OBSERVATION_TOPICS)
    if given.needs_observations and has_odometry and not has_observations:
        names = ' and '.join(given.topic(kind) for kind in OBSERVATION_TOPICS)
        if all(given.types(kind) == () for kind in OBSERVATION_TOPICS):
            yield Fault(Level.WARN, f'{names} have no publisher')
        elif all(given.is_expected(kind) for kind in OBSERVATION_TOPICS):
            yield Fault(Level.WARN, f'no message on {names} yet')


def _observations_stopped(given: RobotInput) -> Iterator[Fault]:
    for kind in OBSERVATION_TOPICS:
        flow = given.flow(kind)
        is_fault = given.has_no_publisher(kind) or (kind == 'landmarks' and flow.is_regular())
        if is_fault and given.has_stopped(kind):
            what = 'landmark scans' if kind == 'landmarks' else 'scans of robots'
            yield Fault(Level.WARN, _stopped(given, kind, what))


def _all_rejected(given: RobotInput) -> Iterator[Fault]:
    for kind in MEASUREMENT_TOPICS:
        flow = given.flow(kind)
        if flow.are_all_rejected(given.now):
            yield Fault(
                Level.WARN if flow.is_sent_again() else Level.ERROR,
                f'the last {flow.rejected_in_a_row.total()} messages on {given.topic(kind)} were'
                f' all rejected: {reasons_in_words(flow.rejected_in_a_row)}')


def _other_clock(given: RobotInput) -> Iterator[Fault]:
    odometry = given.flow('odom').delay
    for kind in OBSERVATION_TOPICS:
        delay = given.flow(kind).delay
        if delay is None or odometry is None or abs(delay - odometry) <= MAX_PROCESSING:
            continue
        side = 'behind' if delay > odometry else 'ahead of'
        yield Fault(Level.ERROR, (
            f'the stamps on {given.topic(kind)} are {_seconds(abs(delay - odometry))} {side} those'
            ' of its odometry: stamp both with the time of measurement by one clock'))


def _unmoved(given: RobotInput) -> Iterator[Fault]:
    if given.health.unmoved >= UNMOVED_MESSAGES:
        yield Fault(Level.ERROR, (
            f'{given.topic("odom")} has velocities, but its pose never changes: integrate them'
            ' into pose.pose, only poses are used'))


def _exact_odometry(given: RobotInput) -> Iterator[Fault]:
    if given.health.exact >= VARIANCE_MESSAGES:
        yield Fault(Level.WARN, (
            f'{given.topic("odom")} has almost no variance of vx or wz in twist.covariance, so'
            ' that observations hardly correct it: fill in vx, vy and wz, leave them zero, or set'
            f' {given.robot}.use_odometry_covariance to false'))


def _unknown_odometry(given: RobotInput) -> Iterator[Fault]:
    if given.health.unknown >= VARIANCE_MESSAGES:
        yield Fault(Level.ERROR, (
            f'{given.topic("odom")} has variances of vx, vy or wz above'
            f' {MAX_SPEED_SIGMA ** 2:g} in twist.covariance, as if they were unknown: fill in all'
            f' three, leave them zero, or set {given.robot}.use_odometry_covariance to false'))


def _too_large(given: RobotInput) -> Iterator[Fault]:
    for kind in OBSERVATION_TOPICS:
        largest = given.flow(kind).largest
        if largest is not None and abs(given.now - (largest.received or 0)) <= RATE_WINDOW:
            yield Fault(Level.ERROR, (
                f'{given.robot} publishes {largest.points:,} points a scan'
                f' ({largest.size:,} bytes) on {given.topic(kind)}, rejected as'
                f' {RejectionReason.TOO_LARGE.value}: is this a raw cloud? Publish landmarks, or'
                ' raise max_observations'))


def _too_frequent(given: RobotInput) -> Iterator[Fault]:
    for kind in MEASUREMENT_TOPICS:
        rate = given.flow(kind).rate()
        if rate > MAX_RATE:
            yield Fault(Level.ERROR, (
                f'{given.robot} publishes at least {rate:,.0f} messages a second on'
                f' {given.topic(kind)}: what is too much for this node is lost; publish at most'
                ' 100'))


def _beyond_limits(given: RobotInput) -> Iterator[Fault]:
    beyond = given.health.observations.recently_rejected()
    for reason, sentence in LIMITS.items():
        if beyond[reason]:
            yield Fault(Level.ERROR, sentence.format(n=beyond[reason]))


def _mostly_gated(given: RobotInput) -> Iterator[Fault]:
    gated, total = given.health.observations.gated()
    if total >= MIN_GATE_SAMPLE and gated > GATED_WARN * total:
        level = Level.ERROR if gated > GATED_ERROR * total else Level.WARN
        yield Fault(level, (
            f'{gated} of the last {total} observations gated: check pose and frame of the sensor,'
            ' and the covariances'))


def _none_used(given: RobotInput) -> Iterator[Fault]:
    use = given.health.observations
    patience = max(MIN_UNUSED_TIME, 2 * given.team.longest_lead)
    if (use.unused_since is None or given.now - use.unused_since < patience
            or use.unused_observations < MIN_UNUSED):
        return
    reasons = [reasons_in_words(use.unused_reasons)] if use.unused_reasons else []
    waiting = given.team.waiting(given.robot)
    if waiting >= MIN_UNUSED:
        reasons.append(f'{waiting} messages wait for later odometry')
    if not any(_mostly_gated(given)):
        yield Fault(Level.WARN, (
            f'none of {use.unused_observations} observations used for'
            f' {_seconds(given.now - use.unused_since)}:'
            f' {"; ".join(reasons) or "not accepted"}'))


def _delays_others(given: RobotInput) -> Iterator[Fault]:
    lag = given.health.lag()
    if lag <= MAX_LAG:
        return
    gaps = [
        health.flows['odom'].usual_gap() for name, health in given.team.robots.items()
        if health.newest is not None and name != given.robot]
    if gaps and lag > NORMAL_LAG_RATIO * min(gaps):
        yield Fault(Level.WARN, (
            f'delays the other robots by up to {_seconds(lag)}: its odometry, every'
            f' {_seconds(given.flow("odom").usual_gap())}, is that much older than theirs'))


#: Each yields the faults of one kind.
CONDITIONS: tuple[Callable[[RobotInput], Iterator[Fault]], ...] = (
    _other_type, _several_drivers, _incompatible_qos, _no_odometry, _odometry_stopped,
    _no_observations, _observations_stopped, _all_rejected, _other_clock, _unmoved,
    _exact_odometry, _unknown_odometry, _too_large, _too_frequent, _beyond_limits, _mostly_gated,
    _none_used, _delays_others)


def _stopped(given: RobotInput, kind: str, what: str) -> str:
    is_gone = given.types(kind) == ()
    return (
        f'{what} stopped {_seconds(given.flow(kind).silence(given.now))} ago'
        + (f': {given.topic(kind)} has no publisher' if is_gone else ''))


def _seconds(duration: int) -> str:
    return f'{duration / NS:.2f} s' if duration < NS else f'{duration / NS:.1f} s'
