# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Check of the stamps of each topic: order, rate and gaps."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from statistics import median

import numpy as np

from fej_slam_ros.core.geometry import Stamps
from fej_slam_ros.core.ordering.backward_stamps import breaks, steps_back
from fej_slam_ros.core.ordering.coarse_stamps import coarse_step
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.sentences import counted
from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.ros.doctor.findings import error, error_if, Finding, seconds, warning
from fej_slam_ros.ros.doctor.survey import (
    ObservationSeries, OdometrySeries, Survey, TopicSeries)

#: Lower bound of a gap, in median periods: three messages in a row are lost.
GAP_PERIODS = 3.5
#: Lower bound of a gap in regular scans [ns]; shorter pauses cost little.
MIN_SCAN_GAP = 2 * NS
#: Upper bound of a regular period, in median periods.
REGULAR_PERIODS = 1.5
#: Minimum share of regular periods, and of periods, of a sensor with a fixed rate.
REGULAR_SHARE = 0.9
MIN_SCAN_PERIODS = 5
#: Upper bound of the share of time in longer periods of odometry, and minimum of judged periods.
MAX_IRREGULAR_SHARE = 0.2
MIN_PERIODS = 10
#: Rate [Hz] that is always sufficient, even if other robots publish faster.
SUFFICIENT_RATE = 6.0
#: Upper bounds of a period, relative to the median of the other robots and, for odometry, to the
#: robot's own scans. The rate of scans depends on the view, so their bound is wide.
SLOW_ODOMETRY = 1.8
SLOW_SCANS = 3.0
SLOWER_THAN_SCANS = 1.5
#: Maximum number of steps back whose cause is looked for: two publishers on a topic make more.
MAX_STEPS_BACK = 100
COARSE_STAMPS = 'coarse_stamps'
#: Causes and cures of stamps that step back, which only regular odometry distinguishes.
PASSED_TWICE = (
    ', to a time that was recorded before: its clock was set back, or recordings were joined',
    'synchronise the clock before recording; correct the stamps, or replay each part on its own')
WRITTEN_LATE = (
    ', to a time without other messages: these were recorded late',
    'sort the messages by stamp, or raise max_delay')
OTHER_STEPS = (
    '', 'stamp with a clock that never goes back, and do not play or record a bag in a loop')


def check(survey: Survey, settings: CommonSettings) -> Iterator[Finding]:
    """Yield problems of the stamps of single topics."""
    for name, series in survey.topics.items():
        yield from _order(name, series, settings)
        yield from _coarse(name, series)
    moving = survey.moving(settings)
    for robot in settings.robots:
        stamps = survey.odometry(robot.name).stamps
        if stamps and robot.name not in moving:
            yield error(
                'no_odometry', f'{robot.name}/odom', 'all messages have the same stamp',
                'stamp each message with the time of its measurement', len(stamps), stamps[0])
    periods = {name: topic.period() for name, topic in moving.items()}
    for name, topic in moving.items():
        yield from _rate(name, periods, survey.observations(f'{name}/landmarks'), settings)
        yield from _irregular(f'{name}/odom', topic, settings)
        times = topic.times()
        yield from _gaps(
            f'{name}/odom', times, _shortest_gap(np.diff(times), settings),
            (settings.stale_after + settings.max_delay) * NS,
            'look for a lossy link, a recorder that drops messages, a clock that was set forward')
    landmarks = [f'{robot.name}/landmarks' for robot in settings.robots]
    yield from _scans({
        where: survey.observations(where).without_future(settings.future_limit * NS)
        for where in landmarks})


def _order(name: str, topic: TopicSeries, settings: CommonSettings) -> Iterator[Finding]:
    stamps = np.array(topic.stamps, np.int64)
    unset = int((stamps == 0).sum())
    if unset > 1:
        yield error(
            'unset_stamp', name, f'{unset} of {len(stamps)} messages have the stamp 0',
            'fill header.stamp with the time of the measurement before publishing', unset)
    back = np.flatnonzero(np.diff(stamps) < 0)
    if len(back):
        largest = int(-np.diff(stamps).min())
        is_harmless = largest <= settings.max_delay * NS or name.endswith('/ground_truth')
        cause, cure = OTHER_STEPS
        if name.endswith('/odom') and 0 < len(steps_back(stamps)) <= MAX_STEPS_BACK:
            cause, cure = PASSED_TWICE if breaks(stamps) else WRITTEN_LATE
        yield error_if(not is_harmless)(
            'stamps_go_back', name,
            f'{len(back)} messages have an earlier stamp than the one recorded before, by up to'
            f' {seconds(largest)}{cause}', cure, len(back), int(stamps[back[0] + 1]))


def _coarse(name: str, topic: OdometrySeries | ObservationSeries) -> Iterator[Finding]:
    step = coarse_step(*topic.positions())
    if step is not None:
        shared = len(topic.stamps) - len(topic.times())
        is_odometry = isinstance(topic, OdometrySeries)
        yield error_if(NS / step < SUFFICIENT_RATE and not name.endswith('/ground_truth'))(
            COARSE_STAMPS, name,
            f'{shared} of {len(topic.stamps)} messages have the stamp of another, in steps of'
            f' {seconds(step)}, while the robot drives on: their times are wrong by up to a step'
            + (', and only the first one at each is used' if is_odometry else ''),
            'record header.stamp with nanoseconds; export tables with all digits of the time',
            shared)


def _rate(
    name: str, periods: Mapping[str, float], scans: TopicSeries, settings: CommonSettings
) -> Iterator[Finding]:
    period = periods[name]
    slow = partial(warning, 'slow_odometry', f'{name}/odom')
    what = f'its period is {seconds(period)}'
    others = [other for robot, other in periods.items() if robot != name]
    scan_period = scans.period() if len(scans.times()) > 2 else np.inf
    if others and period > settings.stale_after * NS:
        yield error(
            'slow_odometry', f'{name}/odom',
            f'{what}, longer than the estimator waits for it (stale_after,'
            f' {settings.stale_after:g} s)', 'publish odometry at 5 Hz or more')
    elif period > SLOWER_THAN_SCANS * scan_period and NS / period < SUFFICIENT_RATE:
        yield slow(
            f'{what}, that of its scans {seconds(scan_period)}',
            'publish odometry at least as often as scans')
    elif others and _is_slow(period, others, SLOW_ODOMETRY):
        yield slow(
            f'{what}, that of other robots {seconds(median(others))}',
            'publish odometry as often as the other robots, or find what drops messages')


def _is_slow(period: float, others: Sequence[float], factor: float) -> bool:
    return period > factor * median(others) and NS / period < SUFFICIENT_RATE


def _irregular(where: str, topic: TopicSeries, settings: CommonSettings) -> Iterator[Finding]:
    period, steps = topic.period(), np.diff(topic.times())
    is_long = steps > max(REGULAR_PERIODS * period, settings.max_delay * NS)
    is_long &= steps <= _shortest_gap(steps, settings)
    share = float(steps[is_long].sum() / steps.sum())
    if share > MAX_IRREGULAR_SHARE and len(steps) >= MIN_PERIODS:
        yield warning(
            'irregular_rate', where,
            f'its median period is {seconds(period)}, but {100 * share:.0f} % of the time is in'
            f' periods longer than {REGULAR_PERIODS:g} times that',
            'look for an overloaded computer, a lossy link or a recorder that drops messages',
            int(is_long.sum()), int(topic.times()[int(np.argmax(is_long))]))


def _shortest_gap(steps: Stamps, settings: CommonSettings) -> float:
    return float(max(GAP_PERIODS * np.median(steps), 0.5 * settings.stale_after * NS))


def _gaps(
    where: str, times: Stamps, shortest: float, longest_wait: float, cure: str
) -> Iterator[Finding]:
    steps = np.diff(times)
    gaps = np.flatnonzero(steps > shortest)
    if len(gaps):
        longest = int(steps.max())
        is_stale = longest > longest_wait
        yield error_if(is_stale)(
            'gap', where, f'{counted(len(gaps), "gap")}, the longest of {seconds(longest)}'
            + (', longer than the estimator waits for a robot' if is_stale else ''), cure,
            len(gaps), int(times[gaps[0]]))


def _scans(topics: Mapping[str, TopicSeries]) -> Iterator[Finding]:
    """Yield gaps and low rates of sensors with a fixed rate; others may have had no detection."""
    regular = {
        where: topic for where, topic in topics.items() if _is_regular(np.diff(topic.times()))}
    periods = {where: topic.period() for where, topic in regular.items()}
    for where, topic in regular.items():
        yield from _gaps(
            where, topic.times(), max(GAP_PERIODS * periods[where], MIN_SCAN_GAP), np.inf,
            'look for a sensor that stops; publish an empty scan if nothing is detected')
        others = [period for other, period in periods.items() if other != where]
        if others and _is_slow(periods[where], others, SLOW_SCANS):
            yield warning(
                'slow_scans', where,
                f'their period is {seconds(periods[where])}, that of other robots'
                f' {seconds(median(others))}', 'find what drops messages or slows the detector')


def _is_regular(steps: Stamps) -> bool:
    return len(steps) >= MIN_SCAN_PERIODS and bool(
        np.quantile(steps, REGULAR_SHARE) <= REGULAR_PERIODS * np.median(steps))
