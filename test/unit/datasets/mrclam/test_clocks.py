# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows whose stamps step back are sorted, brought to one clock or left out, and counted."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest

from fej_slam_ros.datasets.mrclam.clock_evidence import ClockEvidence
from fej_slam_ros.datasets.mrclam.clock_parts import ClockPart
from fej_slam_ros.datasets.mrclam.clocks import in_order
from fej_slam_ros.datasets.series import joined, Series

S = 1_000_000_000
ROBOTS = range(1, 6)
LANDMARKS = {6 + k: point for k, point in enumerate([(2, 1), (3, -1), (0, 2), (-2, -2), (1, -3)])}
#: A row follows the one before after 20 ms, which is how exactly a shift can be known.
PERIOD = 0.02
UNUSED = Series(np.zeros(0, np.int64), np.zeros((0, 3)))


def drive(seed, seconds=120.0):
    """Return commands at 50 Hz, observations of the nearest landmark at 2 Hz, and true poses."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, PERIOD)
    # New speeds each 2 s; the robot turns on the spot or drives small circles.
    commands = np.repeat(
        np.column_stack([rng.uniform(0.02, 0.2, 200), rng.uniform(-0.6, 0.6, 200)]),
        round(2.0 / PERIOD), axis=0)[:len(times)]
    poses = [np.zeros(3)]
    for v, w in commands[:-1]:
        x, y, phi = poses[-1]
        middle = phi + w * PERIOD / 2.0
        poses.append(np.array(
            [x + v * PERIOD * np.cos(middle), y + v * PERIOD * np.sin(middle), phi + w * PERIOD]))
    observations = []
    for row in range(7, len(times), 25):
        x, y, phi = poses[row]
        subject, (px, py) = min(
            LANDMARKS.items(), key=lambda item: np.hypot(item[1][0] - x, item[1][1] - y))
        bearing = np.arctan2(py - y, px - x) - phi
        observations.append((times[row], subject, np.hypot(px - x, py - y), bearing))
    stamps = np.rint(times * S).astype(np.int64) + 1000 * S
    seen = np.array(observations)
    return (
        Series(stamps, commands),
        Series(np.rint(seen[:, 0] * S).astype(np.int64) + 1000 * S, seen[:, 1:]),
        Series(stamps[::50], np.array(poses)[::50]))


def at(seconds):
    return round((1000 + seconds) * S)


def cut(series, *edges):
    """Return the parts of a series between times [s]."""
    return [series[(at(a) <= series.stamps) & (series.stamps < at(b))]
            for a, b in pairwise(edges)]


def ordered(commands, observations, truth=UNUSED, others=None):
    counts = Counter()
    evidence = ClockEvidence(truth, ROBOTS, 1, others or {})
    found = in_order(commands, observations, evidence, counts)
    return found.commands, found.observations, +counts


def assert_equal(found, expected):
    np.testing.assert_array_equal(found.stamps, expected.stamps)
    np.testing.assert_array_equal(found.rows, expected.rows)


def test_a_log_in_order_is_unchanged():
    commands, observations, truth = drive(1)

    found, seen, counts = ordered(commands, observations, truth)

    assert_equal(found, commands)
    assert_equal(seen, observations)
    assert counts == {}


def test_a_buffer_that_is_written_late_is_sorted_in():
    series = drive(2)[:2]
    late = [joined([a, c, b, d]) for a, b, c, d in (
        cut(s, 0, 40, 50, 60, 200) for s in series)]

    found, seen, counts = ordered(*late)

    assert_equal(found, series[0])
    assert_equal(seen, series[1])
    assert counts == {'stamp steps back (put in order)': 2}


def test_a_stretch_that_is_in_both_of_two_logs_is_used_once():
    series = drive(3)[:2]
    glued = [joined([s[s.stamps < at(70)], s[s.stamps >= at(50)]]) for s in series]

    found, seen, counts = ordered(*glued)

    assert_equal(found, series[0])
    assert_equal(seen, series[1])
    assert counts['row repeated'] == sum(len(cut(s, 50, 70)[0]) for s in series)


@pytest.mark.parametrize('back', [0.7, 5.0, 3000.0])
@pytest.mark.parametrize('when', [25.0, 90.0])
@pytest.mark.parametrize('right', ['before', 'after'])
def test_a_clock_that_was_set_back_goes_on_as_true_poses_tell(back, when, right):
    *series, truth = drive(4)
    # The stamps before were right and those after lag, or those before were ahead.
    before, after = (0.0, -back) if right == 'before' else (back, 0.0)
    stepped = [joined([
        s[s.stamps < at(when)].shifted(round(before * S)),
        s[s.stamps >= at(when)].shifted(round(after * S))]) for s in series]

    found, seen, counts = ordered(*stepped, truth)

    for result, expected in zip((found, seen), series):
        np.testing.assert_array_equal(result.rows, expected.rows)
        assert np.abs(result.stamps - expected.stamps).max() <= PERIOD * S
    (shifted,) = [reason for reason in counts if reason.startswith('row shifted by')]
    assert abs(float(shifted.split()[3])) == pytest.approx(back, abs=PERIOD)


@pytest.mark.parametrize(('back', 'known', 'is_same_drive'), [
    (0.3, False, True), (4.0, False, True), (12.0, False, False), (12.0, True, True)])
@pytest.mark.parametrize('right', ['before', 'after'])
def test_where_landmarks_differ_a_step_of_seconds_or_true_poses_show_that_the_robot_drives_on(
        back, known, is_same_drive, right):
    *series, truth = drive(4)
    before, after = (0.0, -back) if right == 'before' else (back, 0.0)
    commands, observations = (joined([
        s[s.stamps < at(60)].shifted(round(before * S)),
        s[s.stamps >= at(60)].shifted(round(after * S))]) for s in series)
    # As by odometry that turned by 2 rad too much meanwhile.
    observations.rows[np.count_nonzero(series[1].stamps < at(60)):, 2] += 2.0

    _, _, counts = ordered(commands, observations, truth if known else UNUSED)

    assert ('command of another recording' in counts) != is_same_drive
    assert any('its clock was set back' in reason for reason in counts) == is_same_drive


@pytest.mark.parametrize('forward', [2.0, 30.0])
@pytest.mark.parametrize('right', ['before', 'after'])
def test_a_clock_that_was_set_forward_goes_on_as_true_poses_tell(forward, right):
    *series, truth = drive(4)
    before, after = (0.0, forward) if right == 'before' else (-forward, 0.0)
    stepped = [joined([
        s[s.stamps < at(60)].shifted(round(before * S)),
        s[s.stamps >= at(60)].shifted(round(after * S))]) for s in series]

    found, seen, counts = ordered(*stepped, truth)

    for result, expected in zip((found, seen), series):
        np.testing.assert_array_equal(result.rows, expected.rows)
        assert np.abs(result.stamps - expected.stamps).max() <= PERIOD * S
    (shifted,) = counts
    assert abs(float(shifted.split()[3])) == pytest.approx(forward, abs=PERIOD)


@pytest.mark.parametrize('edge', [0.007, -0.013])
def test_observations_at_the_edges_of_the_gap_of_a_clock_set_forward_go_with_the_nearer_commands(
        edge):
    commands, seen, truth = drive(4)
    # Of a clock apart: the first one after the step is before its command, the last one after its.
    nearest = int(np.abs(seen.stamps - at(60)).argmin())
    stamps = seen.stamps.copy()
    stamps[nearest] = at(60) - round(edge * S)
    seen = Series(stamps, seen.rows)
    boundary = at(60) - (PERIOD * S / 2 if edge > 0.0 else 0)
    later = seen.stamps >= boundary if edge > 0.0 else seen.stamps > stamps[nearest]
    forward = 25 * S
    stepped = [
        joined([commands[commands.stamps < at(60)], commands[commands.stamps >= at(60)].shifted(
            forward)]),
        joined([seen[~later], seen[later].shifted(forward)])]

    found, result, counts = ordered(*stepped, truth)

    np.testing.assert_array_equal(found.rows, commands.rows)
    assert np.abs(result.stamps - seen.stamps).max() <= PERIOD * S
    (shifted,) = counts
    assert abs(float(shifted.split()[3])) == pytest.approx(25.0, abs=PERIOD)


@pytest.mark.parametrize(('begin', 'end'), [(60, 70), (20, 320), (70, 370), (150, 390)])
@pytest.mark.parametrize('known', ['all the time', 'but in the gap', 'never'])
@pytest.mark.parametrize('seed', [4, 5])
def test_a_gap_in_a_log_is_no_clock_that_was_set_forward(known, begin, end, seed):
    *series, truth = drive(seed, seconds=400.0)
    with_gap = [s[(s.stamps < at(begin)) | (s.stamps >= at(end))] for s in series]
    if known == 'but in the gap':
        truth = joined([cut(truth, 0, begin)[0], cut(truth, end, 400)[0]])

    found, seen, counts = ordered(*with_gap, UNUSED if known == 'never' else truth)

    assert_equal(found, with_gap[0])
    assert_equal(seen, with_gap[1])
    assert counts == {}


def test_a_clock_that_may_have_been_set_forward_is_kept_where_nothing_tells():
    commands, observations, _ = drive(4)
    forward = commands.shifted(5 * S)
    stepped = joined([
        commands[commands.stamps < at(60)], forward[forward.stamps >= at(65)]])

    found, _, counts = ordered(stepped, observations[observations.stamps < at(60)])

    assert_equal(found, stepped)
    assert counts == {}


def meetings(truth, other, subject):
    """Return observations of another robot at the stamps of true poses."""
    x, y, phi = truth.rows.T
    dx, dy = other.rows[:, 0] - x, other.rows[:, 1] - y
    return Series(truth.stamps, np.column_stack([
        np.full(len(truth), subject), np.hypot(dx, dy), np.arctan2(dy, dx) - phi]))


@pytest.mark.parametrize('observer', ['itself', 'the other'])
@pytest.mark.parametrize('right', ['before', 'after'])
def test_without_true_poses_the_robots_that_are_met_tell_which_clock_was_right(right, observer):
    commands, landmarks, truth = drive(4, seconds=300.0)
    *other, other_truth = drive(9, seconds=300.0)
    if observer == 'itself':
        landmarks = joined([landmarks, meetings(truth, other_truth, 2)]).in_order()
    else:
        other[1] = joined([other[1], meetings(other_truth, truth, 1)]).in_order()
    # The wrong part is the longer one.
    when, before, after = (100.0, 0, -8 * S) if right == 'before' else (200.0, 8 * S, 0)
    stepped = [joined([
        s[s.stamps < at(when)].shifted(before),
        s[s.stamps >= at(when)].shifted(after)]) for s in (commands, landmarks)]

    found, seen, counts = ordered(*stepped, others={2: ClockPart(*other)})

    for result, expected in zip((found, seen), (commands, landmarks)):
        assert np.abs(result.stamps - expected.stamps).max() <= PERIOD * S
    (shifted,) = [reason for reason in counts if reason.startswith('row shifted by')]
    assert 'nothing tells' not in shifted


def test_without_true_poses_the_longer_part_keeps_its_stamps():
    series = drive(5)[:2]
    stepped = [joined([
        s[s.stamps < at(90)], s[s.stamps >= at(90)].shifted(-10 * S)])
        for s in series]

    found, _, counts = ordered(*stepped)

    assert found.stamps[0] == series[0].stamps[0]
    assert counts[
        'row shifted by +10.000 s (its clock was set back, nothing tells which was right)'] == sum(
        len(s[s.stamps >= at(90)]) for s in series)


def test_another_recording_at_the_same_time_is_left_out():
    series, others = drive(6)[:2], drive(7)[:2]
    glued = [joined([s, cut(other, 20, 70)[0].shifted(30 * S)])
             for s, other in zip(series, others)]

    found, seen, counts = ordered(*glued)

    assert_equal(found, series[0])
    assert_equal(seen, series[1])
    assert counts['command of another recording'] == len(cut(others[0], 20, 70)[0])
    assert counts['observation of another recording'] == len(cut(others[1], 20, 70)[0])


def test_observations_stay_with_a_recording_to_whose_commands_those_of_another_are_joined():
    commands, observations, _ = drive(7)
    other, *_ = drive(8)
    other = other[other.stamps < at(60)]

    found, seen, counts = ordered(joined([commands, other]), observations)

    assert_equal(found, commands)
    assert_equal(seen, observations)
    assert counts == {'stamp steps back': 1, 'command of another recording': len(other)}


def test_where_only_commands_step_back_observations_in_the_repeated_time_are_left_out():
    commands, observations, _ = drive(8)
    stepped = joined([
        commands[commands.stamps < at(60)],
        commands[commands.stamps >= at(60)].shifted(-4 * S)])

    found, seen, counts = ordered(stepped, observations)

    # By the clock of the commands the time from 56 to 60 s was passed twice.
    assert counts['observation at a repeated time'] == len(cut(observations, 56, 60)[0])
    # Nothing disappears without a count, whether the two parts fit or not.
    assert len(found) + counts['command of another recording'] == len(commands)
    assert len(seen) + counts['observation of another recording'] + counts[
        'observation at a repeated time'] == len(observations)


def test_of_two_recordings_at_the_same_time_the_longer_one_is_used():
    series, others = drive(6)[:2], drive(7)[:2]
    glued = [joined([cut(other, 20, 70)[0].shifted(30 * S), s])
             for s, other in zip(series, others)]

    found, seen, counts = ordered(*glued)

    assert_equal(found, series[0])
    assert_equal(seen, series[1])
    assert counts['command of another recording'] == len(cut(others[0], 20, 70)[0])


def test_rows_of_another_recording_that_are_equal_by_chance_are_not_repeated_ones():
    series, others = drive(6)[:2], drive(7)[:2]
    other, observations = (cut(s, 20, 70)[0] for s in others)
    equal = [0, 500, 1000, 1500, 2000]
    other.rows[equal] = cut(series[0], 20, 70)[0].rows[equal]

    _, _, counts = ordered(joined([series[0], other]), joined([series[1], observations]))

    assert counts['command of another recording'] == len(other)
    assert 'row repeated' not in counts


def test_robots_that_were_met_elsewhere_before_and_after_a_break_are_no_other_recording():
    commands, _, truth = drive(4)
    # The other robot drives from one side to the other within 20 s, unseen.
    side = np.where(truth.stamps < at(60), 3.0, -3.0)
    met = meetings(truth, Series(truth.stamps, np.column_stack([side, 0 * side])), 2)
    met = joined([cut(met, 0, 50)[0], cut(met, 70, 120)[0]])
    stepped = [joined([s[s.stamps < at(60)], s[s.stamps >= at(60)].shifted(-12 * S)])
               for s in (commands, met)]

    _, _, counts = ordered(*stepped)

    assert 'command of another recording' not in counts


def test_observations_within_a_gap_of_commands_show_that_no_clock_was_set_forward():
    commands, observations, truth = drive(4)
    stepped = joined([
        commands[commands.stamps < at(60)],
        commands[commands.stamps >= at(60)].shifted(30 * S)])

    found, seen, counts = ordered(stepped, observations, truth)

    assert_equal(found, stepped)
    assert_equal(seen, observations)
    assert counts == {}
