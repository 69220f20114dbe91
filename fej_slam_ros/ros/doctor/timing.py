# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rates, gaps, order and clocks: what stamps say by themselves and beside the log time."""

from collections.abc import Iterator, Mapping, Sequence
from statistics import median, median_low

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.geometry import Flags
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.ros.doctor.findings import counted, ERROR, Finding, seconds, WARNING
from fej_slam_ros.ros.doctor.survey import Survey, TopicSeries

#: A gap is longer than so many periods.
GAP = 3.5
#: A pause of a sensor that scans regularly is longer than this [ns].
PAUSE = 2 * NS
#: A period is regular up to so many medians; of a regular scanner most are.
REGULAR = 1.5
MOST = 0.9
#: Part of the time that longer periods of odometry may take.
IRREGULAR = 0.2
#: A rate [Hz] that is high enough, and one that is low beside those of the team.
HIGH_RATE = 6.0
SLOWER = 1.8
SLOWER_SCANS = 3.0
SLOWER_THAN_SCANS = 1.5
SYNCHRONISE = (
    'synchronise the clocks of the robots (chrony, PTP), or shift the stamps of one before'
    ' estimating')
#: Part of the time of the team in which a robot may be silent at the begin or end.
SILENT = 0.25


def check(survey: Survey, settings: Settings) -> Iterator[Finding]:
    """Yield what is wrong with the times of a team."""
    odometry = {
        robot.name: _credible(survey.motion(robot.name), settings) for robot in settings.robots}
    told = {name: topic for name, topic in odometry.items() if len(topic.times()) > 1}
    for name, topic in survey.topics.items():
        yield from _order(name, topic, settings)
    for name, topic in odometry.items():
        if len(topic.times()) == 1:
            yield Finding(
                ERROR, 'no_odometry', f'{name}/odom', 'all messages have one stamp',
                'stamp each message with the time of its measurement', len(topic.stamps),
                topic.stamps[0])
    for name, topic in told.items():
        yield from _rate(name, told, survey, settings)
        yield from _irregular(f'{name}/odom', topic, settings)
        yield from _gaps(f'{name}/odom', topic, settings)
    yield from _scans({
        f'{robot.name}/landmarks': _credible(survey.sight(f'{robot.name}/landmarks'), settings)
        for robot in settings.robots})
    yield from _spans(told)
    yield from _clocks(told, settings)
    yield from _late(survey, settings, told)


def _credible(topic: TopicSeries, settings: Settings) -> TopicSeries:
    """Return a topic without what is stamped far ahead of the rest, which is refused."""
    delays = topic.delays()
    if not len(delays):
        return topic
    known = delays >= np.median(delays) - settings.future_limit * NS
    return TopicSeries(
        np.array(topic.stamps)[known].tolist(), np.array(topic.logged)[known].tolist())


def _period(topic: TopicSeries) -> float:
    return float(np.median(np.diff(topic.times())))


def _order(name: str, topic: TopicSeries, settings: Settings) -> Iterator[Finding]:
    stamps = np.array(topic.stamps, np.int64)
    unset = int((stamps == 0).sum())
    if unset > 1:
        yield Finding(
            ERROR, 'unset_stamp', name, f'{unset} of {len(stamps)} messages are stamped 0',
            'fill header.stamp with the time of the measurement before publishing', unset)
    back = np.flatnonzero(np.diff(stamps) < 0)
    if len(back):
        most = int(-np.diff(stamps).min())
        is_harmless = most <= settings.max_delay * NS or name.endswith('/ground_truth')
        yield Finding(
            WARNING if is_harmless else ERROR, 'stamps_go_back', name,
            f'{len(back)} messages are stamped before the one recorded ahead of them, by up to'
            f' {seconds(most)}',
            'stamp with a clock that never goes back, and do not play or record a bag in a loop;'
            ' what max_delay allows for is put in order', len(back), int(stamps[back[0] + 1]))


def _rate(
    name: str, team: Mapping[str, TopicSeries], survey: Survey, settings: Settings
) -> Iterator[Finding]:
    """Yield whether odometry is slow, or slower than others or what it carries."""
    periods = {robot: _period(topic) for robot, topic in team.items()}
    where, period = f'{name}/odom', periods[name]
    told = f'it comes every {seconds(period)}'
    others = [other for robot, other in periods.items() if robot != name]
    scans = survey.sight(f'{name}/landmarks').times()
    scan_period = float(np.median(np.diff(scans))) if len(scans) > 2 else np.inf
    if others and period > settings.stale_after * NS:
        yield Finding(
            ERROR, 'slow_odometry', where,
            f'{told}, later than others wait for (stale_after, {settings.stale_after:g} s)',
            'publish odometry at 5 Hz or more')
    elif period > SLOWER_THAN_SCANS * scan_period and NS / period < HIGH_RATE:
        yield Finding(
            WARNING, 'slow_odometry', where, f'{told}, its scans every {seconds(scan_period)}',
            'publish odometry at least as often as scans: between its stamps a scan is placed by'
            ' interpolation')
    elif others and _is_slow(period, others, SLOWER):
        yield Finding(
            WARNING, 'slow_odometry', where,
            f'{told}, that of the others every {seconds(median(others))}',
            'publish odometry as often as the others do, or look for what drops messages')


def _is_slow(period: float, others: Sequence[float], slower: float) -> bool:
    return period > slower * median(others) and NS / period < HIGH_RATE


def _irregular(where: str, topic: TopicSeries, settings: Settings) -> Iterator[Finding]:
    period, steps = _period(topic), np.diff(topic.times())
    is_long = steps > max(REGULAR * period, settings.max_delay * NS)
    is_long &= ~_are_gaps(steps, settings)
    part = float(steps[is_long].sum() / steps.sum())
    if part > IRREGULAR and len(steps) >= 10:
        yield Finding(
            WARNING, 'irregular_rate', where,
            f'it comes every {seconds(period)} in the median, but for {100 * part:.0f} % of the'
            ' time more seldom than every one and a half of that',
            'look for a loaded computer, a lossy link or a recorder that drops messages',
            int(is_long.sum()), int(topic.times()[int(np.argmax(is_long))]))


def _are_gaps(steps: NDArray[np.int64], settings: Settings) -> Flags:
    return steps > max(GAP * np.median(steps), 0.5 * settings.stale_after * NS)


def _gaps(where: str, topic: TopicSeries, settings: Settings) -> Iterator[Finding]:
    times = topic.times()
    steps = np.diff(times)
    waited = (settings.stale_after + settings.max_delay) * NS
    gaps = np.flatnonzero(_are_gaps(steps, settings))
    if not len(gaps):
        return
    longest = int(steps[gaps].max())
    is_long = longest > waited
    what = f'{counted(len(gaps), "gap")}, the longest of {seconds(longest)}'
    yield Finding(
        ERROR if is_long else WARNING, 'gap', where,
        f'{what}, beyond which nobody waits for the robot' if is_long else what,
        'look for a lossy link or a recorder that drops messages: over a gap the robot only knows'
        ' where its odometry has it at the end', len(gaps), int(times[gaps[0]]))


def _scans(by_topic: Mapping[str, TopicSeries]) -> Iterator[Finding]:
    """Yield where sensors that scan regularly do not; others may just have seen nothing."""
    regular = {
        where: topic.times() for where, topic in by_topic.items() if _is_regular(topic.times())}
    periods = {where: float(np.median(np.diff(times))) for where, times in regular.items()}
    for where, times in regular.items():
        yield from _pauses(where, times)
        others = [period for other, period in periods.items() if other != where]
        if others and _is_slow(periods[where], others, SLOWER_SCANS):
            yield Finding(
                WARNING, 'slow_scans', where,
                f'they come every {seconds(periods[where])}, those of the others every'
                f' {seconds(median(others))}',
                'look for what drops messages or slows the detector')


def _is_regular(times: NDArray[np.int64]) -> bool:
    steps = np.diff(times)
    return len(steps) >= 5 and bool(np.quantile(steps, MOST) <= REGULAR * np.median(steps))


def _pauses(where: str, times: NDArray[np.int64]) -> Iterator[Finding]:
    steps = np.diff(times)
    pauses = np.flatnonzero(steps > max(GAP * np.median(steps), PAUSE))
    if len(pauses):
        yield Finding(
            WARNING, 'gap', where,
            f'{counted(len(pauses), "pause")} in regular scans, the longest of'
            f' {seconds(steps.max())}',
            'look for a sensor or detector that stops; publish an empty scan where nothing is'
            ' seen', len(pauses), int(times[pauses[0]]))


def _spans(told: Mapping[str, TopicSeries]) -> Iterator[Finding]:
    """Yield which robots are not there with the others, or only for a part of the time."""
    spans = _ends(told)
    if len(spans) < 2:
        return
    begin, end = (median(span[k] for span in spans.values()) for k in (0, 1))
    for name, (first, last) in spans.items():
        others = [span for other, span in spans.items() if other != name]
        if all(last < other[0] or first > other[1] for other in others):
            yield Finding(
                ERROR, 'no_overlap', f'{name}/odom',
                f'it reaches from {seconds(first)} to {seconds(last)}, while no other robot'
                ' sends', 'synchronise the clocks of the robots, or shift the stamps of this one,'
                ' before the runs are taken for one', stamp=first)
            continue
        late, early = first - begin, end - last
        for silent, when in ((late, 'begins'), (early, 'ends')):
            if silent > SILENT * (end - begin):
                yield Finding(
                    WARNING, 'silent', f'{name}/odom',
                    f'it {when} {seconds(abs(silent))} {"after" if silent is late else "before"}'
                    ' the others', 'check that the robot was on for the whole run, and its clock',
                    stamp=first if silent is late else last)


def _ends(told: Mapping[str, TopicSeries]) -> dict[str, tuple[int, int]]:
    """Return the first and last stamp of each topic [ns]."""
    return {name: (int(topic.times()[0]), int(topic.times()[-1])) for name, topic in told.items()}


def _clocks(told: Mapping[str, TopicSeries], settings: Settings) -> Iterator[Finding]:
    """Yield how clocks differ, as far as the delays of odometry tell."""
    offsets = {name: _offset(topic.delays()) for name, topic in told.items()}
    if not offsets:
        return
    middle = median(offsets.values())
    limit = settings.max_delay * NS
    is_skewed = max(offsets.values()) - min(offsets.values()) > limit
    if is_skewed:
        yield from _skew(offsets, limit)
    elif not any(topic.delays().any() for topic in told.values()):
        yield from _shifts(told, settings)
    elif abs(middle) > settings.clock_limit * NS:
        yield Finding(
            WARNING, 'clock_offset', ', '.join(offsets),
            f'stamps and log time differ by {seconds(abs(middle))}',
            'set use_sim_time where time is simulated, or the clock of the recorder')
    for name, topic in told.items():
        delays = topic.delays()
        third = len(delays) // 3
        drift = _offset(delays[-third:]) - _offset(delays[:third]) if third > 10 else 0.0
        if abs(drift) > limit:
            yield Finding(
                WARNING, 'clock_drift', name,
                f'its stamps and the log time drift apart by {seconds(abs(drift))}',
                'synchronise its clock while it runs (chrony, PTP)')


def _skew(offsets: Mapping[str, float], limit: float) -> Iterator[Finding]:
    """Yield whose clock is not that of the others; of two nobody knows which is right."""
    if len(offsets) == 2:
        (first, here), (second, there) = offsets.items()
        side = 'ahead of' if here > there else 'behind'
        yield Finding(
            ERROR, 'clock_skew', f'{first}, {second}',
            f'stamps of {second} lie {seconds(abs(here - there))} {side} those of {first}, by the'
            ' log time', SYNCHRONISE)
        return
    for name, offset in offsets.items():
        apart = offset - median(offsets.values())
        if abs(apart) > limit:
            side = 'behind' if apart > 0 else 'ahead of'
            yield Finding(
                ERROR, 'clock_skew', name,
                f'its stamps lie {seconds(abs(apart))} {side} those of the others, by the log'
                ' time', SYNCHRONISE)


def _shifts(told: Mapping[str, TopicSeries], settings: Settings) -> Iterator[Finding]:
    """Yield who both begins and ends so much after others, in a bag whose log times are stamps."""
    spans = _ends(told)
    begin, end = (median_low(span[k] for span in spans.values()) for k in (0, 1))
    for name, (first, last) in spans.items():
        late = first - begin
        is_shifted = abs(late - (last - end)) < _period(told[name])
        if is_shifted and abs(late) > settings.stale_after * NS:
            yield Finding(
                WARNING, 'clock_skew', f'{name}/odom',
                f'it begins and ends {seconds(abs(late))} {"after" if late > 0 else "before"} the'
                ' others, as if its clock was another', SYNCHRONISE, stamp=first)


def _late(
    survey: Survey, settings: Settings, told: Mapping[str, TopicSeries]
) -> Iterator[Finding]:
    """Yield which topics come later than the estimator waits, whether it needed to wait or not."""
    for name, topic in survey.topics.items():
        robot, _, kind = name.rpartition('/')
        if robot not in told or kind == 'ground_truth' or not topic.stamps:
            continue
        credible = _credible(topic, settings)
        delays = credible.delays() - _offset(told[robot].delays())
        ahead = -float(np.median(delays))
        if ahead > settings.max_delay * NS:
            yield Finding(
                ERROR, 'clock_skew', name,
                f'its stamps lie {seconds(ahead)} ahead of those of {robot}/odom, by the log time',
                'stamp scans with the time of their measurement, by the clock that odometry is'
                ' stamped by')
        late = np.flatnonzero(delays > settings.max_delay * NS)
        if len(late):
            yield Finding(
                WARNING, 'delayed', name,
                f'{len(late)} of {len(delays)} messages were recorded up to'
                f' {seconds(delays.max())} after their stamp, the usual delay of {robot}'
                ' subtracted',
                f'raise max_delay (now {settings.max_delay:g} s), or make the way of the messages'
                ' shorter', len(late), int(credible.stamps[late[0]]))


def _offset(delays: NDArray[np.int64]) -> float:
    """Return the delay that a clock and the way of the messages usually have."""
    return float(np.median(delays))
