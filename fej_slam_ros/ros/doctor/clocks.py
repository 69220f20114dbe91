# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the clocks of a team: stamps of robots beside each other and beside the log time."""

from collections.abc import Callable, Iterator, Mapping
from statistics import median, median_low

import numpy as np

from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.ros.doctor.findings import error, error_if, Finding, seconds, warning
from fej_slam_ros.ros.doctor.survey import Survey, TopicSeries
from fej_slam_ros.ros.session.input_faults import MAX_PROCESSING
from fej_slam_ros.ros.topic_types import OBSERVATION_TOPICS

#: Upper bound of the share of the team's time that a robot may miss at the begin or end.
MAX_SILENT_SHARE = 0.25
#: Difference between the delays of odometry of robots [ns] from which on their clocks may differ,
#: also where max_delay is larger because of slow detectors.
MAX_USUAL_OFFSET = NS // 10
#: Minimum number of messages in a third of a topic whose median delay is compared for drift.
MIN_DRIFT_MESSAGES = 11

SYNCHRONISE = 'synchronise the clocks of the robots (chrony, PTP), or correct the stamps'
#: First and last stamp of odometry [ns] by robot.
Spans = Mapping[str, tuple[int, int]]


def check(survey: Survey, settings: CommonSettings, clock_limit: float) -> Iterator[Finding]:
    """Yield differences between the clocks of robots, topics and recorder."""
    moving = survey.moving(settings)
    if moving:
        spans = {name: topic.span() for name, topic in moving.items()}
        offsets = {name: _median_delay(topic) for name, topic in moving.items()}
        yield from _spans(spans, offsets, settings)
        yield from _offsets(moving, spans, offsets, settings, clock_limit)
        yield from _drifts(moving, settings)
        yield from _delays(survey, moving, settings)


def _spans(
    spans: Spans, offsets: Mapping[str, float], settings: CommonSettings
) -> Iterator[Finding]:
    """Yield robots that share no time with the others, or miss much of it."""
    is_skewed = _difference(offsets) > settings.max_delay * NS
    begin, end = (median(span[k] for span in spans.values()) for k in (0, 1))
    for name, (first, last) in spans.items():
        if _is_alone(name, spans):
            yield error_if(is_skewed)(
                'no_overlap', f'{name}/odom',
                f'its stamps, from {seconds(first)} to {seconds(last)}, overlap with those of no'
                ' other robot: its clock is wrong, or it drove at another time',
                f'{SYNCHRONISE}; if robots drove one after another, nothing', stamp=first)
            continue
        for missed, event, stamp in (
                (first - begin, 'begins {} after', first), (end - last, 'ends {} before', last)):
            if missed > MAX_SILENT_SHARE * (end - begin):
                yield warning(
                    'silent', f'{name}/odom', f'it {event.format(seconds(missed))} the others',
                    'check the clock of the robot, and that it was on for the whole run',
                    stamp=stamp)


def _is_alone(name: str, spans: Spans) -> bool:
    """Return whether the stamps of a robot overlap with those of none of the others."""
    first, last = spans[name]
    others = [span for other, span in spans.items() if other != name]
    return bool(others) and all(last < other[0] or first > other[1] for other in others)


def _difference(offsets: Mapping[str, float]) -> float:
    return max(offsets.values()) - min(offsets.values())


def _offsets(
    robots: Mapping[str, TopicSeries], spans: Spans, offsets: Mapping[str, float],
    settings: CommonSettings, clock_limit: float,
) -> Iterator[Finding]:
    limit = min(settings.max_delay * NS, MAX_USUAL_OFFSET)
    common, difference = median(offsets.values()), _difference(offsets)
    if difference > limit:
        yield from _skew(offsets, limit, error_if(difference > settings.max_delay * NS))
    elif not any(topic.delays().any() for topic in robots.values()):
        yield from _shifts(robots, spans, settings)
    elif abs(common) > clock_limit * NS:
        yield warning(
            'clock_offset', ', '.join(offsets),
            f'stamps and log time differ by {seconds(abs(common))}',
            'set use_sim_time for simulated time, or set the clock of the recorder')


def _skew(
    offsets: Mapping[str, float], limit: float, finding: Callable[..., Finding]
) -> Iterator[Finding]:
    if len(offsets) == 2:  # Either clock may be the wrong one.
        (first, first_offset), (second, second_offset) = offsets.items()
        side = 'ahead of' if first_offset > second_offset else 'behind'
        yield finding(
            'clock_skew', f'{first}, {second}',
            f'stamps of {second} are {seconds(abs(first_offset - second_offset))} {side} those of'
            f' {first}, by log time', SYNCHRONISE)
        return
    for name, offset in offsets.items():
        difference = offset - median(offsets.values())
        if abs(difference) > limit:
            side = 'behind' if difference > 0 else 'ahead of'
            yield finding(
                'clock_skew', name,
                f'its stamps are {seconds(abs(difference))} {side} those of the others, by log'
                ' time', SYNCHRONISE)


def _shifts(
    robots: Mapping[str, TopicSeries], spans: Spans, settings: CommonSettings
) -> Iterator[Finding]:
    """Yield robots whose whole run is shifted, in a bag whose log times are the stamps."""
    begin, end = (median_low(span[k] for span in spans.values()) for k in (0, 1))
    for name, topic in robots.items():
        first, last = spans[name]
        late = first - begin
        is_shifted = abs(late - (last - end)) < topic.period()
        is_shifted &= not _is_alone(name, spans)
        if is_shifted and abs(late) > settings.stale_after * NS:
            yield warning(
                'clock_skew', f'{name}/odom',
                f'it begins and ends {seconds(abs(late))} {"after" if late > 0 else "before"} the'
                ' others: its clock may differ', SYNCHRONISE, stamp=first)


def _drifts(robots: Mapping[str, TopicSeries], settings: CommonSettings) -> Iterator[Finding]:
    """Yield robots whose delays change between the first and the last third of the run."""
    for name, topic in robots.items():
        delays = topic.delays()
        third = max(len(delays) // 3, 1)
        drift = abs(float(np.median(delays[-third:]) - np.median(delays[:third])))
        if third >= MIN_DRIFT_MESSAGES and drift > settings.max_delay * NS:
            yield warning(
                'clock_drift', name,
                f'its stamps and the log time drift apart by {seconds(drift)}',
                'synchronise its clock during the run (chrony, PTP)')


def _delays(
    survey: Survey, robots: Mapping[str, TopicSeries], settings: CommonSettings
) -> Iterator[Finding]:
    """Yield topics whose delay, relative to the robot's odometry, exceeds `max_delay`."""
    limit = settings.max_delay * NS
    corrections = {given.name: given.sensor_delay * NS for given in settings.robots}
    for name, series in survey.topics.items():
        robot, _, kind = name.rpartition('/')
        if robot not in robots or kind == 'ground_truth' or not series.stamps:
            continue
        topic = series.without_future(settings.future_limit * NS)
        delays = topic.delays() - _median_delay(robots[robot])
        if kind in OBSERVATION_TOPICS:
            delays += corrections[robot]
        behind = float(np.median(delays))
        is_other_clock = behind > MAX_PROCESSING
        if behind < -limit or is_other_clock:
            side = 'behind' if is_other_clock else 'ahead of'
            yield error(
                'clock_skew', name,
                f'its stamps are {seconds(abs(behind))} {side} those of {robot}/odom, by log time',
                'stamp scans with the time of their measurement, by the clock of the odometry')
        late = np.flatnonzero(delays > limit)
        if len(late) and not is_other_clock:
            largest = float(delays.max())
            yield warning(
                'delayed', name,
                f'{len(late)} of {len(delays)} messages were recorded up to'
                f' {seconds(largest)} later than the usual delay of {robot}',
                'set the clock of the robot before it sends' if largest > MAX_PROCESSING else
                f'raise max_delay (now {settings.max_delay:g} s), or shorten the transport',
                len(late), int(topic.stamps[late[0]]))


def _median_delay(topic: TopicSeries) -> float:
    """Return the clock offset plus the transport time [ns]."""
    return float(np.median(topic.delays()))
