# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of the paper come out of our runs, and every form of them tells the same."""

import csv
from io import StringIO
import json
from math import sqrt
import os
from pathlib import Path

import numpy as np
import pytest

from fej_slam_ros.experiments import executor, tables
from fej_slam_ros.experiments.campaign import gathered, tasks
from fej_slam_ros.experiments.monte_carlo import Errors, simulate
from fej_slam_ros.experiments.paper import (
    Configuration, CONFIGURATIONS, own_world, published, Range)

ENTRIES = [
    'r1_nees', 'r1_pos', 'r1_head', 'r2_nees', 'r2_pos', 'r2_head', 'f_nees', 'f_pos']
CHANCE = Range(mean=2.0, sd100=0.5, lo95=1.0, hi95=3.0, lo997=0.5, hi997=3.5)


def runs_of(*values):
    """Return runs whose squared errors and NEES are the same everywhere: a value for each run."""
    def filled(steps):
        return np.array(values)[:, None, None] * np.ones((3, steps))

    return Errors({'r1': filled(4), 'r2': filled(5)}, filled(6)[:, :2])


def by_filter(*values):
    """Return such runs of each filter: the ideal one's are twice, the FEJ's thrice as large."""
    return {
        name: runs_of(*(scale * value for value in values))
        for name, scale in (('std', 1.0), ('ideal', 2.0), ('fej', 3.0))}


def entries(runs, chance=CHANCE):
    return tables.entries(runs, lambda row, errors: dict.fromkeys(ENTRIES, chance))


def rows_of(lines):
    """Return what a CSV file of these lines holds, by the names of its columns."""
    file = StringIO()
    csv.writer(file).writerows(lines)
    return list(csv.DictReader(StringIO(file.getvalue())))


@pytest.mark.parametrize(('ours', 'is_outside'), [
    (0.49, True), (0.5, False), (2.0, False), (3.5, False), (3.51, True)])
def test_an_entry_is_marked_outside_of_its_997_range(ours, is_outside):
    assert tables.Entry(2.1, ours, 100, CHANCE).is_outside == is_outside


@pytest.mark.parametrize(('ours', 'runs', 'variance'), [
    (2.7, 100, 1.0 + 0.05), (1.3, 100, 1.0 + 0.05), (2.7, 2000, 0.05 + 0.05), (2.7, 25, 4.05)])
def test_deviations_take_in_the_chance_of_both_sides(ours, runs, variance):
    entry = tables.Entry(2.1, ours, runs, CHANCE)

    assert entry.deviations == pytest.approx(0.7 / (0.5 * sqrt(variance)))


def test_entries_are_means_over_runs_beside_the_printed_values():
    made = entries({Configuration(1, 60): by_filter(1.0, 4.0, 4.0)})

    assert list(made) == [
        f'1/60/{name}/{entry}' for name in ('std', 'ideal', 'fej') for entry in ENTRIES]
    nees, position = made['1/60/ideal/r2_nees'], made['1/60/fej/f_pos']
    assert (nees.paper, nees.ours, nees.runs, nees.chance) == (1.0827, 6.0, 3, CHANCE)
    assert (position.paper, position.ours) == (0.4297, pytest.approx(3.0))


def test_the_keys_of_all_experiments_are_those_of_the_published_tables():
    made = entries({configuration: by_filter(1.0) for configuration in CONFIGURATIONS})

    assert list(made) == list(published())


def test_csv_and_json_tell_the_same():
    made = entries({Configuration(1, 60): by_filter(1.0, 4.0), Configuration(2, 20): by_filter(0.3)})

    of_json = json.loads(json.dumps(tables.as_json(made)))

    assert of_json['2/20/std/r1_nees'] == {
        'paper': 2.6083, 'ours': 0.3, 'runs': 1, 'mean': 2.0, 'sd100': 0.5, 'lo95': 1.0,
        'hi95': 3.0, 'lo997': 0.5, 'hi997': 3.5, 'outside': True}
    assert {
        '/'.join(row.pop(name) for name in ('environment', 'landmarks', 'filter', 'entry')): row
        for row in rows_of(tables.csv_rows(made))
    } == {key: {name: repr(value) for name, value in row.items()} for key, row in of_json.items()}


def test_the_table_of_runs_has_each_run_alone_under_its_number():
    runs = {Configuration(1, 60): by_filter(1.0, 4.0), Configuration(2, 20): by_filter(16.0)}

    rows = rows_of(tables.runs_csv_rows(runs, first=7))

    told = [(row['environment'], row['landmarks'], row['run'], row['filter']) for row in rows]
    assert told == [
        *(('1', '60', number, name) for name in ('std', 'ideal', 'fej') for number in '78'),
        *(('2', '20', '7', name) for name in ('std', 'ideal', 'fej'))]
    assert [rows[1][entry] for entry in ENTRIES] == [
        '4.0', '2.0', '2.0', '4.0', '2.0', '2.0', '4.0', '2.0']
    assert [row['r1_nees'] for row in rows] == [
        '1.0', '4.0', '2.0', '8.0', '3.0', '12.0', '16.0', '32.0', '48.0']


def test_the_page_has_paper_ours_and_range_of_each_filter():
    page = tables.markdown(entries({Configuration(2, 20): by_filter(0.25, 1.75)}), 'About it.')

    assert page.startswith('# Tables 1 and 2 of [Liu]\n\nAbout it.\n\n## Table 2: environment 2\n')
    assert 'environment 1' not in page
    rows = [line for line in page.splitlines() if line.startswith('|')][2:]
    assert rows[:3] == [
        '| 20 | standard | paper | 2.6083 | 3.0072 | 0.0819 | 2.2871 | 2.3172 | 0.0724 | 4.2160 |'
        ' 2.2272 |',
        f'| |  | ours, 2 runs |{8 * " **1.0000** |"}'.replace('| |', '|  |'),
        f'|  |  | 95 % |{8 * " 1 to 3 |"}']
    assert len(rows) == 9


def test_the_page_marks_and_counts_what_is_outside_and_far():
    made = {
        f'1/20/std/{entry}': tables.Entry(2.0, ours, 100, CHANCE)
        for entry, ours in zip(ENTRIES, [3.4, 3.6, 0.4, 3.53, 3.6, 4.5, 4.6, 2.0])}

    page = tables.markdown(made, '')

    assert '| **3.4000** | **3.6000**! | **0.4000**! |' in page
    # 3 and 5 standard deviations of 0.5 sqrt(1.05) are 1.54 and 2.56.
    assert page.endswith(
        'Outside of the 99.7 % range: 6 of 8 entries. Farther than 3 / 5 standard deviations from'
        ' the mean of such entries: 5 / 1.\n')


# Which runs there are

WORLDS = {c: own_world(c) for c in (Configuration(1, 20), Configuration(2, 60))}


def test_a_run_is_decided_by_seed_experiment_and_number_alone():
    found = tasks(WORLDS, 5, range(1, 4))

    assert [task.seed for task in found] == [
        (5, 1, 20, 1), (5, 1, 20, 2), (5, 1, 20, 3), (5, 2, 60, 1), (5, 2, 60, 2), (5, 2, 60, 3)]
    assert [task.seed for task in tasks(WORLDS, 5, [3])] == [found[2].seed, found[5].seed]


def test_each_run_is_of_its_world_and_its_noise_and_all_filters():
    first, second = tasks(WORLDS, 5, [1])

    assert (first.world, second.world) == tuple(WORLDS.values())
    assert (first.sensors.landmark_sigma, second.sensors.landmark_sigma) == ((0.5, 0.5), (0.6, 0.6))
    assert first.filters == second.filters == ('standard', 'ideal', 'fej')


@pytest.mark.parametrize(('finished', 'found'), [
    (0, {}), (1, {(1, 20): [0]}), (2, {(1, 20): [0, 1]}), (3, {(1, 20): [0, 1], (2, 60): [2]}),
    (4, {(1, 20): [0, 1], (2, 60): [2, 3]})])
def test_of_a_campaign_that_was_interrupted_the_finished_runs_are_kept(finished, found):
    def run(value):
        return Errors({'r1': np.full((3, 4), value), 'r2': np.full((3, 5), value)}, np.eye(2))

    done = [
        {'standard': run(k), 'ideal': run(k + 10), 'fej': run(k + 20)} for k in range(finished)]

    runs = gathered(WORLDS, done, 2)

    assert {
        configuration: {name: errors.poses['r2'][:, 0, 0].tolist() for name, errors in of.items()}
        for configuration, of in runs.items()
    } == {
        configuration: {
            'std': values, 'ideal': [v + 10 for v in values], 'fej': [v + 20 for v in values]}
        for configuration, values in found.items()}
