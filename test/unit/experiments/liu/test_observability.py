# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lemma 1 of [Liu] along runs of the estimator, and its report."""

import csv
from dataclasses import replace
import io
import json

import pytest

from fej_slam_ros.errors import UsageError
from fej_slam_ros.experiments.liu.observability import (
    csv_rows, markdown, measure, Observability, ObservabilityCase, ObservabilityWindow, reproduce,
    summary)
from fej_slam_ros.experiments.liu.observability_figure import draw

#: A result with exact zeros, and with a rank that is not the same for all m.
MADE_UP = Observability('fej', 1, 2, False, 7, 4, (
    ObservabilityWindow(1, 4, 3, 2e-16, (1.0, 0.5, 0.2, 1e-3, 1e-17, 0.0, 0.0)),
    ObservabilityWindow(2, 5, 2, 1.0, (1.0, 0.5, 0.2, 1e-3, 1e-4, 0.0, 0.0))))

CASES = [ObservabilityCase(2, 2), ObservabilityCase(2, 2, True), ObservabilityCase(1, 3)]


@pytest.fixture(scope='module')
def results():
    return reproduce(CASES, steps=3, seed=1)


@pytest.mark.parametrize('robots_seen', [False, True])
@pytest.mark.parametrize(
    ('filter_name', 'rank'), [('standard', 8), ('ideal', 7), ('fej', 7), ('invariant', 7)])
def test_two_robots_and_two_landmarks_have_the_ranks_of_the_paper(filter_name, rank, robots_seen):
    result = measure(filter_name, ObservabilityCase(2, 2, robots_seen), steps=10, seed=1)

    assert [window.m for window in result.windows] == list(range(1, 11))
    assert {window.rank for window in result.windows} == {result.lemma_1} == {rank}


@pytest.mark.parametrize(
    ('filter_name', 'extra'), [('standard', 1), ('ideal', 0), ('fej', 0), ('invariant', 0)])
@pytest.mark.parametrize(
    'case', [ObservabilityCase(*case) for case in ((1, 2), (1, 9), (3, 4), (5, 2), (5, 2, True))])
@pytest.mark.parametrize('seed', [1, 2])
def test_only_the_standard_filter_gains_a_direction(filter_name, extra, case, seed):
    result = measure(filter_name, case, steps=2, seed=seed)

    expected = 3 * case.robots + 2 * case.landmarks - 3 + extra
    assert [window.rank for window in result.windows] == [expected, expected]
    assert result.lemma_1 == expected
    assert result.unknowns == 3 * case.robots + 2 * case.landmarks


@pytest.mark.parametrize(
    ('filter_name', 'size'), [('standard', 2), ('ideal', 3), ('fej', 3), ('invariant', 3)])
@pytest.mark.parametrize('case', [
    ObservabilityCase(*case) for case in ((2, 2), (3, 4), (2, 2, True), (3, 4, True))])
def test_rigid_motions_of_the_whole_team_stay_unobservable(filter_name, size, case):
    windows = measure(filter_name, case, steps=5, seed=1).windows

    assert {window.null_space for window in windows} == {size}
    # Rounding over the smallest singular value that counts, 1e-4.
    assert max(window.sine for window in windows) < 1e-8


def test_each_m_adds_a_step_even_beyond_a_loop():
    windows = measure('fej', ObservabilityCase(1, 2), steps=63, seed=1).windows

    assert len({window.singular_values for window in windows}) == 63


def test_the_same_seed_gives_the_same_result(results):
    assert reproduce(CASES, steps=3, seed=1) == results
    assert reproduce(CASES, steps=3, seed=2) != results


def test_observations_of_robots_are_part_of_m(results):
    without, seen = (
        [r.windows for r in results if (r.robots, r.robots_seen) == (2, also)]
        for also in (False, True))

    assert all(a != b for a, b in zip(without, seen, strict=True))


def test_every_case_has_a_result_of_each_filter(results):
    cases = [(r.robots, r.landmarks, r.robots_seen, r.filter) for r in results]

    assert cases == [
        (*case, name) for case in [(2, 2, False), (2, 2, True), (1, 3, False)]
        for name in ('standard', 'ideal', 'fej', 'invariant')]


def test_the_table_has_a_row_for_each_case_and_filter(results):
    lines = markdown(results).splitlines()

    rows = [line for line in lines if line.startswith('|')][2:]
    assert [row[:row.rindex('|', 0, -1)] for row in rows[:5]] == [
        '| 2 | 2 | no | standard | 10 | 8 | 8 | 2 ',
        '| 2 | 2 | no | ideal | 10 | 7 | 7 | 3 ',
        '| 2 | 2 | no | fej | 10 | 7 | 7 | 3 ',
        '| 2 | 2 | no | invariant | 10 | 7 | 7 | 3 ',
        '| 2 | 2 | yes | standard | 10 | 8 | 8 | 2 ']
    assert len(rows) == len(results)
    assert 'm = 1 to 3. ' in markdown(results)


def test_a_rank_that_depends_on_m_is_listed_for_each_m():
    *_, row = (line for line in markdown([MADE_UP]).splitlines() if line.startswith('|'))

    assert row == (
        '| 1 | 2 | no | fej | 7 | 4 (m = 1), 5 (m = 2) | 4 | 3 (m = 1), 2 (m = 2) | 1e+00 |')


def test_csv_has_a_row_for_each_m():
    file = io.StringIO()
    csv.writer(file).writerows(csv_rows([MADE_UP]))

    first, second = csv.DictReader(io.StringIO(file.getvalue()))

    assert first == {
        'robots': '1', 'landmarks': '2', 'robots_seen': '0', 'filter': 'fej', 'unknowns': '7',
        'm': '1', 'rank': '4', 'lemma_1': '4', 'null_space': '3', 'sine': '2e-16'}
    assert [second[name] for name in ('m', 'rank', 'null_space', 'sine')] == ['2', '5', '2', '1.0']


def test_json_keeps_everything(results):
    read = json.loads(json.dumps(summary(results)))

    assert [
        Observability(**{**result, 'windows': tuple(
            ObservabilityWindow(**{**window, 'singular_values': tuple(window['singular_values'])})
            for window in result['windows'])})
        for result in read] == results


@pytest.mark.slow
@pytest.mark.filterwarnings('error')
def test_the_figure_is_a_picture_even_of_exact_zeros(results):
    file = io.BytesIO()

    draw(file, [*results, *(replace(MADE_UP, filter=name) for name in 'abcd')])

    assert file.getvalue().startswith(b'\x89PNG')


@pytest.mark.parametrize(('case', 'steps', 'message'), [
    (ObservabilityCase(0, 2), 3, 'robots: 0 are too few to observe anything, use 1 or more'),
    (ObservabilityCase(2, 2), 0, 'steps: 0 are too few to observe anything, use 1 or more'),
    (ObservabilityCase(2, 1), 3, 'landmarks: 1 are too few for a common start, use 2 or more'),
])
def test_too_few_robots_steps_or_landmarks_are_rejected(case, steps, message):
    with pytest.raises(UsageError) as rejected:
        measure('fej', case, steps, seed=1)

    assert str(rejected.value) == message
