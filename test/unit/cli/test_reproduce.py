# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`reproduce`: its files, independence of the number of jobs, and error messages."""

import json
import os
from pathlib import Path
import re
import signal

import pytest

from helpers.processes import OnTerminal
from helpers.ros import csv_rows, run_verb
from helpers.slow import slow

PNG = b'\x89PNG\r\n\x1a\n'
CSAM = {
    'csam.md', 'csam.csv', 'csam.json', 'csam_figure_5.png', 'csam_figure_6.png',
    'csam_exchange.png'}
NOISE = {'noise.md', 'noise.csv', 'noise.json', 'noise_runs.csv', 'noise.png'}
ROW = ('environment', 'landmarks', 'filter')


@pytest.fixture
def reproduce(tmp_path, capsys):
    """Return a function that reproduces a part and returns status, output and error output."""
    def run(part, *options, output='out'):
        status = run_verb('reproduce', part, '--output', tmp_path / output, *options)
        return status, *capsys.readouterr()
    return run


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_tables_are_written_as_markdown_csv_and_json(reproduce, tmp_path):
    status, out, _ = reproduce('tables', '--only', '1/20', '2/60', '--runs', '2')

    tables = json.loads((tmp_path / 'out' / 'tables.json').read_text(encoding='utf-8'))
    assert status == 0
    assert (tmp_path / 'out' / 'tables.md').read_text(encoding='utf-8') in out
    assert len(tables) == 2 * 3 * 8
    assert {entry['runs'] for entry in tables.values()} == {2}
    assert {
        '/'.join([*(row[name] for name in ROW), row['entry']]): float(row['ours'])
        for row in csv_rows(tmp_path / 'out' / 'tables.csv')
    } == {key: entry['ours'] for key, entry in tables.items()}


@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_jobs(reproduce, tmp_path):
    for jobs in ('1', '3'):
        reproduce('tables', '--only', '2/20', '--runs', '4', '--jobs', jobs, output=jobs)

    assert contents(tmp_path / '1') == contents(tmp_path / '3')


def test_a_run_can_be_repeated_by_its_number(reproduce, tmp_path):
    reproduce('tables', '--only', '2/20', '--runs', '3', '--seed', '5', output='all')
    reproduce('tables', '--only', '2/20', '--run', '3', '--seed', '5', output='one')

    last = [row for row in csv_rows(tmp_path / 'all' / 'runs.csv') if row['run'] == '3']
    assert csv_rows(tmp_path / 'one' / 'runs.csv') == last
    assert len(last) == 3


def test_another_seed_gives_other_noise(reproduce, tmp_path):
    for seed in ('1', '2'):
        reproduce('tables', '--only', '2/20', '--runs', '1', '--seed', seed, output=seed)

    one, other = (csv_rows(tmp_path / seed / 'runs.csv') for seed in ('1', '2'))
    assert all(a['r1_pos'] != b['r1_pos'] for a, b in zip(one, other, strict=True))


@pytest.mark.slow
def test_figures_have_the_numbers_of_the_paper(reproduce, tmp_path):
    status, *_ = reproduce('figures', '--only', '1/20', '2/60', '--runs', '1')

    pictures = contents(tmp_path / 'out')
    assert status == 0
    assert set(pictures) == {
        'figure_2.png', 'figure_3.png', 'figure_4_20.png', 'figure_5_60.png'}
    assert all(picture.startswith(PNG) for picture in pictures.values())


def test_observability_is_reported_for_any_number_of_robots_and_landmarks(reproduce, tmp_path):
    status, out, _ = reproduce('observability', '--robots', '4', '--landmarks', '3')

    rows = csv_rows(tmp_path / 'out' / 'observability.csv')
    assert status == 0
    assert {(row['robots_seen'], row['filter'], row['rank']) for row in rows} == {
        (seen, name, rank) for seen in '01' for name, rank in (
            ('standard', '16'), ('ideal', '15'), ('fej', '15'), ('invariant', '15'))}
    assert '| 4 | 3 | no | fej | 18 | 15 |' in out
    assert (tmp_path / 'out' / 'observability.png').read_bytes().startswith(PNG)


def test_options_without_effect_are_named(reproduce):
    status, out, _ = reproduce(
        'observability', '--robots', '1', '--landmarks', '3', '--runs', '2', '--only', '1/20')

    assert status == 0
    assert out.splitlines()[:2] == [
        '--only has no effect on observability', '--runs has no effect on observability']


def test_a_single_robot_has_no_case_with_robot_observations(reproduce, tmp_path):
    reproduce('observability', '--robots', '1', '--landmarks', '3')

    rows = csv_rows(tmp_path / 'out' / 'observability.csv')
    assert {row['robots_seen'] for row in rows} == {'0'}


@pytest.mark.slow
def test_csam_is_written_in_all_forms_independently_of_the_jobs(reproduce, tmp_path):
    for jobs in ('1', '2'):
        status, out, _ = reproduce(
            'csam', '--runs', '1', '--seed', '5', '--jobs', jobs, output=jobs)
        assert status == 0

    files = contents(tmp_path / '1')
    assert set(files) == CSAM
    assert files == contents(tmp_path / '2')
    assert files['csam.md'].decode() in out
    assert [(row['experiment'], row['seed']) for row in csv_rows(tmp_path / '1' / 'csam.csv')] == [
        ('map_joining', '5'), ('sensor_extension', '5')]
    assert set(json.loads(files['csam.json'])) == {'map_joining', 'sensor_extension'}
    assert all(files[name].startswith(PNG) for name in files if name.endswith('.png'))


@pytest.mark.slow
def test_noise_is_written_in_all_forms_independently_of_the_jobs(reproduce, tmp_path):
    for jobs in ('1', '2'):
        status, out, _ = reproduce(
            'noise', '--only', '2/20', '--runs', '2', '--jobs', jobs, output=jobs)
        assert status == 0

    files = contents(tmp_path / '1')
    assert set(files) == NOISE
    assert files == contents(tmp_path / '2')
    assert files['noise.md'].decode() in out
    assert files['noise.png'].startswith(PNG)
    assert [case['sighting_m'] for case in json.loads(files['noise.json'])] == [0.6, 0.6, 0.6, 1.0]


@pytest.mark.slow
def test_noise_contains_the_runs_of_the_tables(reproduce, tmp_path):
    for part in ('noise', 'tables'):
        reproduce(part, '--only', '1/20', '--run', '3', output=part)

    by_filter = {row['filter']: row for row in csv_rows(tmp_path / 'noise' / 'noise_runs.csv')[:4]}
    for row in csv_rows(tmp_path / 'tables' / 'runs.csv'):
        ours = by_filter[{'std': 'standard'}.get(row['filter'], row['filter'])]
        assert ours['run'] == row['run'] == '3'
        # The mean NEES of a run differs by rounding only.
        assert float(ours['r2_nees']) == pytest.approx(float(row['r2_nees']), rel=1e-14)


@pytest.mark.slow
def test_all_without_data_is_every_part_that_needs_none(reproduce, tmp_path):
    status, out, _ = reproduce('all', '--only', '2/20', '--runs', '1')

    assert status == 0
    assert 'victoria_park is left out: it needs --data' in out
    assert set(contents(tmp_path / 'out')) == {
        'tables.md', 'tables.csv', 'tables.json', 'runs.csv', 'figure_3.png', 'figure_5_20.png',
        'observability.md', 'observability.csv', 'observability.json', 'observability.png', *CSAM,
        *NOISE}


def test_victoria_park_is_written_with_its_figure_and_all_solutions(
    reproduce, tmp_path, data, victoria_park, monkeypatch,
):
    result, _ = victoria_park
    results = {data / 'fej_ekf_paper': result}
    monkeypatch.setattr(
        'fej_slam_ros.experiments.liu.victoria_park.reproduce', lambda folder, _: results[folder])

    status, out, _ = reproduce('victoria_park', '--data', data / 'fej_ekf_paper')

    summary = json.loads((tmp_path / 'out' / 'victoria_park.json').read_text(encoding='utf-8'))
    assert status == 0
    assert 'FEJ is **not** better than the standard filter in all entries' in out
    assert summary['batch']['two_robot_batch']['cost'] == pytest.approx(156914.948, abs=1e-3)
    assert (tmp_path / 'out' / 'figure_6.png').read_bytes().startswith(PNG)
    solutions = {row['solution'] for row in csv_rows(tmp_path / 'out' / 'victoria_park_poses.csv')}
    assert solutions == {
        'two_robot_batch', 'one_robot_batch', 'standard', 'fej', 'invariant', 'ideal'}


@pytest.mark.parametrize(('words', 'status', 'sentence'), [
    (['tables', '--runs', '0'], 2, '--runs: 0 is not an integer of at least 1'),
    (['tables', '--runs', 'many'], 2, '--runs: many is not an integer of at least 1'),
    (['tables', '--jobs', '-1'], 2, '--jobs: -1 is not an integer of at least 1'),
    (['observability', '--robots', '2'], 2,
     '--robots and --landmarks go together: give both or none'),
    (['tables', '--runs', '2', '--run', '5'], 2, '--run 5 is none of --runs 2'),
    (['victoria_park'], 2,
     ('victoria_park needs --data: the folder with Zstate_VicPark_6898_loops.mat or'
      ' VicPark_clean_data.mat')),
    (['tables', '--data', 'nowhere'], 2,
     'no folder nowhere: give the one with the MT_Parameters files'),
    (['victoria_park', '--data', 'nowhere'], 2,
     'no folder nowhere: give the one with the Victoria Park data'),
])
def test_a_usage_error_is_one_sentence_and_writes_nothing(
    reproduce, tmp_path, words, status, sentence
):
    assert reproduce(*words) == (status, '', f'reproduce: {sentence}\n')
    assert not (tmp_path / 'out').exists() or not contents(tmp_path / 'out')


@pytest.mark.parametrize('part', [['tables', '--only', '1/20'], ['victoria_park']])
def test_an_unreadable_data_file_is_named(reproduce, tmp_path, part):
    for name in ('MT_Parameters_20fea_1.mat', 'Zstate_VicPark_6898_loops.mat'):
        (tmp_path / name).write_text('<html>404</html>', encoding='utf-8')

    status, out, errors = reproduce(*part, '--data', tmp_path)

    assert (status, out) == (1, '')
    assert re.fullmatch(
        r'reproduce: .*\.mat: cannot be read as a MATLAB file .*\n', errors)


def test_missing_data_of_one_part_end_all_before_the_first(reproduce, tmp_path):
    (tmp_path / 'data').mkdir()

    status, out, errors = reproduce('all', '--runs', '1', '--data', tmp_path / 'data')

    assert (status, out) == (1, '')
    assert 'holds no associated Victoria Park data' in errors
    assert not (tmp_path / 'out').exists()


def test_an_output_that_is_not_a_folder_is_rejected(reproduce, tmp_path):
    (tmp_path / 'out').write_text('', encoding='utf-8')

    status, _, errors = reproduce('observability')

    assert status == 2
    assert errors == (
        f'reproduce: {tmp_path / "out"} is a file: choose a folder for the results\n')


def test_earlier_results_are_replaced_only_with_force(reproduce, tmp_path):
    size = '--robots', '1', '--landmarks', '2'
    reproduce('observability', *size)
    before = contents(tmp_path / 'out')

    status, _, errors = reproduce('observability', *size, '--seed', '2')
    assert status == 2
    assert 'observability.md exists: choose another path, or --force' in errors
    assert contents(tmp_path / 'out') == before

    assert reproduce('observability', *size, '--seed', '2', '--force')[0] == 0
    assert contents(tmp_path / 'out') != before


@pytest.mark.slow
def test_a_killed_worker_changes_no_number(reproduce, tmp_path):
    runs = 'tables', '--only', '2/20', '--runs', '24'
    assert reproduce(*runs)[0] == 0
    process = OnTerminal('reproduce', *runs, '--output', tmp_path / 'killed', stream='stderr')
    try:
        for count in 2, 6:
            process.until(lambda count=count: re.search(
                rf' (?:[{count}-9]|1\d)/24 ', process.shown()))
            workers = [pid for pid in process.members() if b'spawn_main' in command_of(pid)]
            os.kill(workers[0], signal.SIGKILL)
        process.until(lambda: process.process.poll() is not None)

        assert process.process.returncode == 0
        assert '2 worker processes ended; their runs' in process.process.stdout.read()
    finally:
        process.close()
    for name in 'runs.csv', 'tables.csv':
        assert (tmp_path / 'killed' / name).read_bytes() == (tmp_path / 'out' / name).read_bytes()


def command_of(pid):
    return Path(f'/proc/{pid}/cmdline').read_bytes()


@pytest.mark.parametrize(('number', 'to_all'), [
    (signal.SIGINT, True), slow(signal.SIGTERM, False)])
def test_an_interrupt_ends_the_workers_and_keeps_finished_runs(tmp_path, number, to_all):
    process = OnTerminal(
        'reproduce', 'tables', '--only', '2/20', '--runs', '1000', '--output', tmp_path / 'out',
        stream='stderr')
    try:
        process.until(lambda: re.search(r' [1-9]\d*/1000 ', process.shown()))
        (os.killpg if to_all else os.kill)(process.process.pid, number)
        process.until(lambda: process.process.poll() is not None)
        process.until(lambda: not process.family())

        tables = json.loads((tmp_path / 'out' / 'tables.json').read_text(encoding='utf-8'))
        (runs,) = {entry['runs'] for entry in tables.values()}
        assert process.process.returncode == 130
        assert 1 <= runs < 1000
        assert f'{runs} of 1000 runs are finished and kept' in process.process.stdout.read()
    finally:
        process.close()
