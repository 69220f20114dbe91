# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Page, CSV and JSON of the levels of noise hold the same values and the verdict."""

import json

import numpy as np
import pytest

from fej_slam_ros.experiments.liu import noise, noise_report
from helpers.reports import ENTRIES, rows_of

CASE = ['environment', 'landmarks', 'odometry_m', 'odometry_deg', 'sighting_m']


def samples(fej=(1.5, 2.5), invariant=(1.0, 1.2)):
    """Return runs whose entries have the same values in all cases."""
    by_filter = {'standard': (3.0, 4.0), 'fej': fej, 'ideal': (1.0, 1.1), 'invariant': invariant}
    return {
        case: {name: dict.fromkeys(ENTRIES, np.array(values))
               for name, values in by_filter.items()}
        for case in noise.cases(noise.NOISE_CONFIGURATIONS)}


def test_csv_and_json_hold_the_same_values():
    means = noise.means(samples())

    of_json = json.loads(json.dumps(noise_report.summary(means), allow_nan=False))

    assert [*of_json[0]['filters']] == ['standard', 'fej', 'ideal', 'invariant', 'invariant - fej']
    expected = [
        [*(str(case[name]) for name in CASE), name, entry,
         *(repr(statistics[key]) for key in ('value', 'runs', 'error', 'margin'))]
        for case in of_json for name, entries in case['filters'].items()
        for entry, statistics in entries.items()]
    assert [[*row.values()] for row in rows_of(noise_report.csv_rows(means))] == expected


def test_the_table_of_runs_has_each_run_alone_under_its_number():
    rows = rows_of(noise_report.runs_csv_rows(samples(), first=7))

    assert len(rows) == 8 * 4 * 2
    last = rows[-1]
    assert [last[name] for name in CASE] == ['2', '20', '1.0', '10.0', '1.0']
    assert (last['run'], last['filter'], last['r2_nees']) == ('8', 'invariant', '1.2')


def test_a_row_of_the_page_has_means_with_their_intervals():
    page = noise_report.markdown(noise.means(samples()), 'About it.')

    # Of 1.5 and 2.5 the standard error is 0.5, and t of one degree of freedom is 12.706.
    assert '|  |  | FEJ | 2.00 ± 6.35 | 2.000 ± 6.353 | 2.0000 ± 6.3531 | 2.00 ± 6.35 |' in page
    assert '| 0.3 m, 4 deg; 0.6 m | 2 | standard | 3.50 ± 6.35 |' in page
    # Of 1.0 - 1.5 and 1.2 - 2.5 it is 0.4.
    assert '| invariant - FEJ |  | -0.900 (0.400) | -0.9000 (0.4000) |  | -0.900 (0.400) |' in page
    assert page.index('## Environment 1, 20 landmarks') < page.index('## Environment 2, 20')


@pytest.mark.parametrize(('fej', 'invariant', 'consistent', 'no_worse'), [
    ((1.5, 2.5), (1.0, 1.2), 16, 40), ((1.5, 2.5), (1.3, 1.5), 0, 40),
    ((1.0, 1.0), (1.0, 1.2), 16, 40), ((0.6, 0.4), (1.0, 1.2), 16, 0)])
def test_the_page_counts_how_often_the_invariant_filter_meets_its_requirements(
    fej, invariant, consistent, no_worse
):
    sentence = noise_report.verdict(noise.means(samples(fej, invariant)))

    assert f'within 0.9 to 1.35 in {consistent} of 16 cases' in sentence
    assert f'standard errors of the difference in {no_worse} of 40 entries' in sentence


def test_a_single_run_has_no_intervals():
    means = noise.means(samples(fej=(2.0,), invariant=(1.25,)))

    assert '| invariant | 1.25 | 1.250 | 1.2500 |' in noise_report.markdown(means, '')
    row = next(row for row in rows_of(noise_report.csv_rows(means)) if row['filter'] == 'fej')
    assert (row['mean'], row['standard_error'], row['margin_95']) == ('2.0', '', '')


def test_values_of_a_diverged_filter_are_in_exponential_notation():
    means = noise.means(samples(fej=(1.23456e9, 1.23456e9)))

    assert '| 1.2e+09 ± ' in noise_report.markdown(means, '')
