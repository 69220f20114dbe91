# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tables 1 and 2 from our runs, with the same values in every file."""

import json
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from fej_slam_ros.experiments.common import executor
from fej_slam_ros.experiments.liu import tables
from fej_slam_ros.experiments.liu.configurations import (
    Configuration, CONFIGURATIONS, EntryRange, own_world, published)
from fej_slam_ros.experiments.liu.monte_carlo import (
    Errors, simulate, stack, table_runs, table_tasks)
from helpers.reports import ENTRIES, rows_of

CHANCE = EntryRange(mean=2.0, sd100=0.5, lo95=1.0, hi95=3.0, lo997=0.5, hi997=3.5)
WORLDS = {c: own_world(c) for c in (Configuration(1, 20), Configuration(2, 60))}


def one(value):
    """Return a run whose squared errors and NEES all have a value."""
    poses = {'r1': np.full((3, 4), value), 'r2': np.full((3, 5), value)}
    return Errors(poses, np.full((2, 6), value))


def runs_of(*values):
    """Return such runs, a value for each."""
    return stack([one(value) for value in values])


def by_filter(*values):
    """Return such runs of each filter: the ideal one's are twice, the FEJ's thrice as large."""
    return {
        name: runs_of(*(scale * value for value in values))
        for name, scale in (('std', 1.0), ('ideal', 2.0), ('fej', 3.0))}


def entries(runs, chance=CHANCE):
    return tables.entries(runs, lambda row, errors: dict.fromkeys(ENTRIES, chance))


@pytest.mark.parametrize(('ours', 'is_outside'), [
    (0.49, True), (0.5, False), (2.0, False), (3.5, False), (3.51, True)])
def test_an_entry_is_marked_outside_of_its_997_range(ours, is_outside):
    assert tables.TableEntry(2.1, ours, 100, CHANCE).is_outside == is_outside


@pytest.mark.parametrize(('runs', 'variance'), [(100, 1.05), (2000, 0.1), (25, 4.05)])
def test_distances_include_the_variance_of_our_runs_and_of_the_2000(runs, variance):
    sd = 0.5 * sqrt(variance)

    for sign in (-1.0, 1.0):
        entry = tables.TableEntry(2.1, 2.0 + sign * 3.0 * sd, runs, CHANCE)
        assert entry.is_farther(2.999)
        assert not entry.is_farther(3.001)


def test_entries_are_means_over_runs_beside_the_printed_values():
    table = entries({Configuration(1, 60): by_filter(1.0, 4.0, 4.0)})

    assert list(table) == [
        f'1/60/{name}/{entry}' for name in ('std', 'ideal', 'fej') for entry in ENTRIES]
    nees, position = table['1/60/ideal/r2_nees'], table['1/60/fej/f_pos']
    assert (nees.paper, nees.ours, nees.runs, nees.expected) == (1.0827, 6.0, 3, CHANCE)
    assert (position.paper, position.ours) == (0.4297, pytest.approx(3.0))


def test_the_keys_of_all_experiments_are_those_of_the_published_tables():
    table = entries({configuration: by_filter(1.0) for configuration in CONFIGURATIONS})

    assert list(table) == list(published())


def test_csv_and_json_hold_the_same_values():
    table = entries({
        Configuration(1, 60): by_filter(1.0, 4.0), Configuration(2, 20): by_filter(0.3)})

    of_json = json.loads(json.dumps(tables.summary(table)))

    assert of_json['2/20/std/r1_nees'] == {
        'paper': 2.6083, 'ours': 0.3, 'runs': 1, 'mean': 2.0, 'sd100': 0.5, 'lo95': 1.0,
        'hi95': 3.0, 'lo997': 0.5, 'hi997': 3.5, 'outside': False}
    assert {
        '/'.join(row.pop(name) for name in ('environment', 'landmarks', 'filter', 'entry')): row
        for row in rows_of(tables.csv_rows(table))
    } == {key: {name: repr(value) for name, value in row.items()} for key, row in of_json.items()}


def test_the_table_of_runs_has_each_run_alone_under_its_number():
    runs = {Configuration(1, 60): by_filter(1.0, 4.0), Configuration(2, 20): by_filter(16.0)}

    rows = rows_of(tables.runs_csv_rows(runs, first=7))

    labels = [(row['environment'], row['landmarks'], row['run'], row['filter']) for row in rows]
    assert labels == [
        *(('1', '60', number, name) for name in ('std', 'ideal', 'fej') for number in '78'),
        *(('2', '20', '7', name) for name in ('std', 'ideal', 'fej'))]
    assert [rows[1][entry] for entry in ENTRIES] == [
        '4.0', '2.0', '2.0', '4.0', '2.0', '2.0', '4.0', '2.0']
    assert [row['r1_nees'] for row in rows] == [
        '1.0', '4.0', '2.0', '8.0', '3.0', '12.0', '16.0', '32.0', '48.0']


def test_the_page_has_a_table_of_each_environment_that_was_run():
    both = {Configuration(1, 20): by_filter(1.0), Configuration(2, 60): by_filter(1.0)}

    page = tables.markdown(entries(both), 'About it.')
    head, first, second = page.split('## ')

    assert head == '# Tables 1 and 2 of [Liu]\n\nAbout it.\n\n'
    assert first.startswith('Table 1: environment 1\n\n| landmarks | EKF |  | R1 NEES/3 | R1 pos')
    assert second.startswith('Table 2: environment 2\n\n')
    assert [('| 20 |' in table, '| 60 |' in table) for table in (first, second)] == [
        (True, False), (False, True)]


def test_a_table_has_paper_ours_and_range_of_each_filter():
    page = tables.markdown(entries({Configuration(2, 20): by_filter(0.25, 1.75)}), '')

    cells = [line[2:-2].split(' | ') for line in page.splitlines() if line.startswith('|')][2:]
    assert [row[:3] for row in cells] == [
        row for name in ('standard', 'ideal', 'FEJ')
        for row in (['20', name, 'paper'], ['', '', 'ours, 2 runs'], ['', '', '95 %'])]
    assert cells[0][3:] == [
        '2.6083', '3.0072', '0.0819', '2.2871', '2.3172', '0.0724', '4.2160', '2.2272']
    assert cells[1][3:] == 8 * ['**1.0000**']
    assert cells[2][3:] == 8 * ['1 to 3']


def test_entries_outside_are_marked_and_far_ones_counted():
    table = {
        f'1/20/std/{entry}': tables.TableEntry(2.0, ours, 100, CHANCE)
        for entry, ours in zip(ENTRIES, [3.4, 3.6, 0.4, 3.53, 3.6, 4.5, 4.6, 2.0])}

    assert '| **3.4000** | **3.6000**! | **0.4000**! |' in tables.markdown(table, '')
    # 3 and 5 standard deviations of 0.5 sqrt(1.05) are 1.54 and 2.56.
    assert tables.verdict(table) == (
        'Outside of the 99.7 % range: 6 of the 8 entries made of 100 runs or more.'
        ' Farther than 3 standard deviations from the mean of the independent runs: 5 of all 8,'
        ' farther than 5: 1.')


def test_few_runs_are_not_compared_with_the_range_of_a_hundred():
    table = {'1/20/std/r1_nees': tables.TableEntry(2.0, 9.0, 99, CHANCE)}

    assert not table['1/20/std/r1_nees'].is_outside
    assert 'Outside of the 99.7 % range: 0 of the 0 entries' in tables.verdict(table)
    assert 'farther than 5: 1.' in tables.verdict(table)


def test_in_the_authors_worlds_the_range_is_published_and_the_page_has_a_verdict():
    source = tables.authors(Path('without files'))

    found = source.ranges_of('2/60/fej', runs_of(1.0, 2.0))

    assert list(found) == ENTRIES
    assert all(found[entry] == published()[f'2/60/fej/{entry}'].expected for entry in ENTRIES)
    table = {'2/60/fej/r1_pos': tables.TableEntry(2.0, 3.6, 100, CHANCE)}
    assert 'Outside of the 99.7 % range: 1 of the 1 entries' in source.about(table)
    assert 'Outside' not in tables.OWN_WORLDS.about(table)


def test_in_our_own_worlds_the_range_comes_from_the_runs_and_is_always_the_same():
    runs = runs_of(1.0, 2.0, 4.0)

    found = tables.OWN_WORLDS.ranges_of('1/20/std', runs)

    assert found == tables.OWN_WORLDS.ranges_of('1/20/std', runs)
    assert found != tables.OWN_WORLDS.ranges_of('1/20/fej', runs)
    # The sd of 1, 2, 4 is sqrt(14) / 3; 2000 draws of 100 know it to 1.6 %, taken 4 times.
    assert found['r2_nees'].sd100 == pytest.approx(sqrt(14.0) / 30.0, rel=0.064)


def test_a_run_depends_on_seed_experiment_and_number_only():
    found = table_tasks(WORLDS, 5, range(1, 4))

    assert [task.seed for task in found] == [
        (5, 1, 20, 1), (5, 1, 20, 2), (5, 1, 20, 3), (5, 2, 60, 1), (5, 2, 60, 2), (5, 2, 60, 3)]
    assert [task.seed for task in table_tasks(WORLDS, 5, [3])] == [found[2].seed, found[5].seed]


def test_each_run_is_of_its_world_its_noise_and_all_filters():
    first, second = table_tasks(WORLDS, 5, [1])

    assert (first.world, second.world) == tuple(WORLDS.values())
    assert first.sensors.landmark_sigma == (0.5, 0.5)
    assert second.sensors.landmark_sigma == (0.6, 0.6)
    assert first.filters == second.filters == ('standard', 'ideal', 'fej')


@pytest.mark.parametrize(('finished', 'found'), [
    (0, {}), (1, {(1, 20): [0]}), (2, {(1, 20): [0, 1]}), (3, {(1, 20): [0, 1], (2, 60): [2]}),
    (4, {(1, 20): [0, 1], (2, 60): [2, 3]})])
def test_an_interrupted_campaign_keeps_its_finished_runs(finished, found):
    done = [
        {name: one(scale * k) for name, scale in (('standard', 1), ('ideal', 10), ('fej', 100))}
        for k in range(finished)]

    runs = table_runs(WORLDS, done, 2)

    assert runs.keys() == found.keys()
    for configuration, numbers in found.items():
        for name, scale in (('std', 1), ('ideal', 10), ('fej', 100)):
            errors = runs[configuration][name]
            assert errors.landmarks[:, 0, 0].tolist() == [scale * k for k in numbers]
            assert errors.poses['r2'][:, 2, 4].tolist() == [scale * k for k in numbers]


def reproduced(source, configurations, runs):
    """Return the entries of runs with seed 1."""
    worlds = {configuration: source.world(configuration) for configuration in configurations}
    todo = table_tasks(worlds, 1, range(1, runs + 1))
    with executor.processes(2) as workers:
        finished = list(executor.in_order(workers, simulate, todo))
    return tables.entries(table_runs(worlds, finished, runs), source.ranges_of)


@pytest.fixture(scope='module')
def authors(data):
    return tables.authors(data / 'fej_ekf_paper')


def test_a_few_runs_in_the_authors_worlds_are_near_the_paper(authors):
    table = reproduced(authors, [Configuration(1, 20), Configuration(2, 60)], 8)

    assert len(table) == 2 * 3 * 8
    assert [key for key, entry in table.items() if entry.is_farther(3.0)] == []


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_100_runs_in_the_authors_worlds_are_within_their_ranges(authors):
    table = reproduced(authors, CONFIGURATIONS, 100)

    assert list(table) == list(published())
    assert sum(entry.is_outside for entry in table.values()) <= 2


@pytest.fixture(scope='module')
def own():
    """Return the entries of 100 runs in our own worlds."""
    return reproduced(tables.OWN_WORLDS, CONFIGURATIONS, 100)


def nees(table, name):
    """Return the NEES of robots and map that a filter has in each experiment."""
    return {
        key: entry.ours for key, entry in table.items()
        if f'/{name}/' in key and key.endswith('_nees')}


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_in_our_own_worlds_the_ideal_filter_is_consistent(own):
    found = nees(own, 'ideal')

    assert len(found) == 18
    assert {key: value for key, value in found.items() if not 0.85 <= value <= 1.25} == {}


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_in_our_own_worlds_fej_is_consistent_but_for_a_heavy_tail(own):
    found = nees(own, 'fej')

    # In environment 2 with 20 landmarks a run may diverge: the mean has a heavy tail.
    highest = {key: 3.5 if key.startswith('2/20/') else 1.25 for key in found}
    assert len(found) == 18
    assert {
        key: value for key, value in found.items() if not 0.85 <= value <= highest[key]} == {}


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_in_our_own_worlds_fej_is_better_than_the_standard_filter(own):
    for key, fej in own.items():
        if '/fej/' in key:
            standard = own[key.replace('fej', 'std')]
            assert fej.ours < standard.ours or fej.expected.hi95 >= standard.expected.lo95, key
