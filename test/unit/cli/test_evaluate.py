# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`evaluate`: errors and consistency of runs, their files, and the error messages."""

from dataclasses import replace
from io import BytesIO
import json
import shutil
from unittest import mock

import numpy as np
import pytest

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.geometry import compose
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.csv_rows import TRAJECTORY_COLUMNS
from fej_slam_ros.ros.files.run_files import tum_line
from fej_slam_ros.ros.messages import outgoing
from helpers.paths import BAGS
from helpers.ros import (
    assert_one_sentence, meeting_truth, raw, raw_record, run_verb, write_bag)


@pytest.fixture(scope='module')
def replayed(tmp_path_factory):
    """Return a folder with the replays of the shipped bags, output topics included."""
    folder = tmp_path_factory.mktemp('replayed')
    for name in ('two_circles', 'rendezvous'):
        assert run_verb(
            'replay', BAGS / name, '--params', BAGS / f'{name}.yaml', '--output', folder / name,
            '--bag') == 0
    return folder


@pytest.fixture
def evaluate(tmp_path, capsys):
    """Return a function that evaluates and returns status, evaluation.json and output."""
    def run(path, *options):
        out = tmp_path / 'evaluation'
        status = run_verb('evaluate', path, '--output', out, *options)
        file = out / 'evaluation.json'
        return status, json.loads(file.read_text()) if file.exists() else None, capsys.readouterr()

    return run


@pytest.mark.parametrize('name', ['two_circles', 'rendezvous'])
def test_errors_and_consistency_are_those_in_the_summary_of_the_run(replayed, evaluate, name):
    _, report, _ = evaluate(replayed / name, '--no-plots')

    own = json.loads((replayed / name / 'summary.json').read_text())
    for robot, evaluated in report['robots'].items():
        ape = evaluated['ape']['unaligned']
        assert ape['samples'] == own['rmse'][robot]['steps']
        assert ape['position']['rmse'] == pytest.approx(own['rmse'][robot]['position'], abs=1e-12)
        assert ape['heading']['rmse'] == pytest.approx(own['rmse'][robot]['heading'], abs=1e-12)
        assert evaluated['nees']['mean'] == pytest.approx(own['nees'][robot], rel=1e-9)
        assert evaluated['nis']['mean'] == pytest.approx(own['nis'][robot]['per_dof'])
    landmarks = report['landmarks'].get('unaligned', {}).get('rmse')
    assert landmarks == pytest.approx(own['rmse'].get('landmarks'), abs=1e-12)


def test_a_run_without_ground_truth_is_judged_by_nis(replayed, evaluate, tmp_path):
    untrue = write_bag(tmp_path / 'bag', [
        message for message in bags.read(BAGS / 'two_circles') if 'truth' not in message.topic])

    status, _, printed = evaluate(replayed / 'two_circles', '--no-plots', '--truth', untrue)

    assert status == 1
    assert 'NIS/dof judges the consistency: nis in summary.json' in printed.err
    assert printed.err.count('\n') == 1


def test_the_folder_beside_a_bag_is_printed_relative_to_the_current_one(
        replayed, tmp_path, monkeypatch, capsys):
    shutil.copytree(replayed / 'two_circles' / 'bag', tmp_path / 'bag')
    monkeypatch.chdir(tmp_path)

    assert run_verb('evaluate', tmp_path / 'bag', '--truth', BAGS / 'two_circles',
                    '--no-plots') == 0

    *tables, last = capsys.readouterr().out.splitlines()
    assert last == 'wrote bag_evaluation'
    assert max(len(line) for line in tables if line.startswith(('robot', 'r1'))) <= 100


def test_a_bag_gives_the_same_result_as_the_folder(replayed, evaluate):
    folder = replayed / 'two_circles'
    _, of_folder, _ = evaluate(folder, '--no-plots')
    _, of_bag, _ = evaluate(folder / 'bag', '--no-plots', '--force')

    for robot in ('r1', 'r2'):
        # The heading is rounded by its quaternion.
        for kind in ('position', 'heading'):
            assert of_bag['robots'][robot]['ape']['unaligned'][kind]['rmse'] == pytest.approx(
                of_folder['robots'][robot]['ape']['unaligned'][kind]['rmse'], abs=1e-12)
        # NIS is rounded in /diagnostics.
        assert of_bag['robots'][robot]['nis']['mean'] == pytest.approx(
            of_folder['robots'][robot]['nis']['mean'], abs=1e-5)
    assert of_bag['landmarks'] == of_folder['landmarks']


def diagnostics(ms, name, **values):
    """Return a message with the status of a robot."""
    status = outgoing.diagnostic_status(name, 0, '', values, 'r1')
    return raw('diagnostics', outgoing.diagnostics(0, [status]), ms)


def pose(ms, x):
    estimate = PoseEstimate('r1', 10**6 * ms, 'map', np.array([x, 0.0, 0.0]), np.eye(3))
    return raw('r1/pose', outgoing.pose(estimate, 0.0), ms)


def test_a_run_of_a_single_file_is_compared_with_the_truth_in_it(replayed, evaluate, tmp_path):
    file = BAGS / 'two_circles' / 'two_circles.mcap'
    params = BAGS / 'two_circles.yaml'
    assert run_verb('replay', file, '--params', params, '--output', tmp_path / 'run') == 0

    _, of_file, _ = evaluate(tmp_path / 'run', '--no-plots')
    _, of_bag, _ = evaluate(replayed / 'two_circles', '--no-plots', '--force')

    assert of_file['robots'] == of_bag['robots']


def test_messages_of_other_nodes_and_invalid_ones_are_left_out(replayed, evaluate, tmp_path):
    messages = list(bags.read(replayed / 'two_circles' / 'bag'))
    _, expected, _ = evaluate(replayed / 'two_circles' / 'bag', '--no-plots')
    ms = messages[-1].received // 10**6 + 1
    ours = {'received': 9, 'used': 9, 'sightings_used': 9}
    others = [
        diagnostics(ms, 'motor: r1', nis=1e9, nis_dof=3),
        diagnostics(ms, 'r1', **ours, nis=1e9, nis_dof=3),
        diagnostics(ms, 'other: r1', **ours, nis=1e9, nis_dof=3),
        diagnostics(ms, 'estimator: r1', **ours, nis='x', nis_dof=3),
        diagnostics(ms, 'estimator: r1', **ours, nis='nan', nis_dof=3),
        diagnostics(ms, 'estimator: r1', **ours, nis=1e9, nis_dof=3.5)]
    invalid = [
        pose(ms, np.nan), pose(ms, np.inf), pose(ms, 1e300),
        *(replace(message, raw=message.raw[:30]) for message in (pose(ms, 0.0), others[0]))]
    write_bag(tmp_path / 'bag', [*messages, *others, *invalid])

    truth = '--truth', BAGS / 'two_circles'
    status, report, printed = evaluate(tmp_path / 'bag', '--no-plots', '--force', *truth)

    assert (status, printed.err, report['invalid_messages']) == (0, '', 5)
    for name in 'robots', 'landmarks':
        assert report[name] == expected[name]


@pytest.mark.parametrize('summary', [
    '[' * 100_000, '[1]', '5', '{"nis": 5}', '{"nis": {"r1": {"sum": "x", "dof": 3}}}',
    '{"nis": {"r1": []}}', '{"remap": 5}', '{"remap": [[]]}', '{"namespace": [1]}',
    '{"bag": [1]}'])
def test_a_summary_that_no_run_writes_is_one_sentence(replayed, evaluate, tmp_path, summary):
    shutil.copytree(replayed / 'two_circles', tmp_path / 'run')
    (tmp_path / 'run' / 'summary.json').write_text(summary)

    truth = '--truth', BAGS / 'two_circles'
    status, _, printed = evaluate(tmp_path / 'run', '--no-plots', *truth)

    assert_one_sentence((status, *printed), 1, 'summary.json cannot be read')


def test_a_frame_of_the_map_may_end_as_that_of_a_robot_does(replayed, evaluate, tmp_path):
    params = tmp_path / 'p.yaml'
    params.write_text(
        (BAGS / 'two_circles.yaml').read_text()
        + '/estimator:\n  ros__parameters: {map_frame: site/map}\n')
    assert run_verb(
        'replay', BAGS / 'two_circles', '--params', params, '--output', tmp_path / 'run',
        '--bag') == 0

    _, renamed, _ = evaluate(tmp_path / 'run' / 'bag', '--no-plots')
    _, usual, _ = evaluate(replayed / 'two_circles' / 'bag', '--no-plots', '--force')

    assert renamed['robots'] == usual['robots']
    assert renamed['landmarks'] == usual['landmarks']


def test_moving_the_truth_changes_unaligned_errors_only(replayed, evaluate, tmp_path):
    folder, moved = replayed / 'two_circles', tmp_path / 'moved'
    motion = np.array([30.0, -20.0, 2.7])
    moved.mkdir()
    _, report, said = evaluate(folder, '--no-plots')
    assert 'in another frame' not in said.out
    for robot in ('r1', 'r2'):
        lines = []
        for line in (tmp_path / 'evaluation' / f'{robot}_truth.tum').read_text().splitlines():
            t, x, y, _, _, _, sine, cosine = map(float, line.split())
            at = np.array([x, y, 2.0 * np.arctan2(sine, cosine)])
            lines.append(tum_line(round(t * 1e9), compose(motion, at)))
        (moved / f'{robot}.tum').write_text('\n'.join(lines))

    _, after, said = evaluate(folder, '--no-plots', '--force', '--truth', moved)

    assert 'in another frame than map' in said.out
    for kind in ('team_aligned', 'robot_aligned'):
        assert after['all']['ape'][kind]['position']['rmse'] == pytest.approx(
            report['all']['ape'][kind]['position']['rmse'], abs=1e-9)
    assert after['all']['ape']['unaligned']['position']['rmse'] > 20.0
    assert after['all']['rpe']['1']['position']['rmse'] == pytest.approx(
        report['all']['rpe']['1']['position']['rmse'], abs=1e-9)


def test_covariances_and_nees_are_written_for_each_pose(replayed, evaluate, tmp_path):
    _, report, _ = evaluate(replayed / 'two_circles', '--no-plots')

    rows = (tmp_path / 'evaluation/r1_covariance.csv').read_text().splitlines()
    assert rows[0].split(',')[:2] == ['stamp_ns', 'cov_xx']
    assert len(rows) - 1 == report['robots']['r1']['compared']
    values = [float(row.split(',')[-1]) for row in rows[1:] if row[-1] != ',']
    assert np.mean(values) == pytest.approx(report['robots']['r1']['nees']['mean'])


def test_figures_are_drawn(replayed, evaluate, tmp_path):
    evaluate(replayed / 'rendezvous')

    for name in ('ways', 'errors', 'nees'):
        picture = (tmp_path / f'evaluation/{name}.png').read_bytes()
        assert BytesIO(picture).read(8) == b'\x89PNG\r\n\x1a\n'


def test_missing_matplotlib_is_reported_with_a_cure(replayed, evaluate):
    with mock.patch('fej_slam_ros.cli.arguments.find_spec', return_value=None):
        status, _, printed = evaluate(replayed / 'two_circles')
        without_plots, *_ = evaluate(replayed / 'two_circles', '--no-plots')

    assert status == 1
    assert '--no-plots' in printed.err
    assert without_plots == 0


@pytest.mark.parametrize(('damage', 'sentence'), [
    (lambda folder: (folder / 'trajectory_r1.csv').write_text('a,b\n1,2\n'), 'lacks the column'),
    (lambda folder: (folder / 'landmarks.csv').write_text(
        'id,x,y,var_x,cov_xy,var_y,frame\n1,nan,0,1,0,1,map\n'), 'row 2 is damaged'),
    (lambda folder: (folder / 'landmarks.csv').write_text(
        f'id,x,y,var_x,cov_xy,var_y,frame\n{10**20},0,0,1,0,1,map\n'), 'row 2 is damaged'),
    (lambda folder: (folder / 'trajectory_r1.csv').write_text(
        ','.join(TRAJECTORY_COLUMNS) + f'\n{10**20},0,0,0,1,0,0,1,0,1,map\n'),
        'row 2 is damaged'),
    (lambda folder: (folder / 'summary.json').write_text('{'), 'run again to replace it'),
    (lambda folder: (folder / 'summary.json').write_text(
        '{"nis": {"r1": {"sum": 1, "dof": NaN}}}'), 'run again to replace it'),
    (lambda folder: (folder / 'summary.json').unlink(), 'give the truth with --truth'),
    (lambda folder: [file.unlink() for file in folder.glob('trajectory_*')], 'give the folder'),
])
def test_a_damaged_folder_is_reported_in_one_sentence(
        replayed, evaluate, tmp_path, damage, sentence):
    folder = tmp_path / 'damaged'
    shutil.copytree(replayed / 'two_circles', folder, ignore=shutil.ignore_patterns('bag'))
    damage(folder)

    status, report, printed = evaluate(folder, '--no-plots')

    assert (status, report) == (1, None)
    assert sentence in printed.err
    assert printed.err.count('\n') == 1


def test_a_folder_of_no_run_is_not_asked_for_its_ground_truth(evaluate, tmp_path):
    (tmp_path / 'empty').mkdir()

    status, _, printed = evaluate(tmp_path / 'empty', '--no-plots')

    assert status == 1
    assert f'{tmp_path / "empty"} has no trajectory_<robot>.csv and is no rosbag2' in printed.err
    assert printed.err.count('\n') == 1


def test_a_run_is_no_ground_truth_of_its_own(replayed, evaluate):
    run = replayed / 'two_circles'

    status, _, printed = evaluate(run, '--no-plots', '--truth', run)

    assert_one_sentence((status, *printed), 1, f'--truth: {run} is the run itself')
    assert not (run / 'evaluation').exists()


@pytest.mark.parametrize(('files', 'sentence'), [
    ({'r1.tum': '\ufeff1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 0 2\n'},
     'row 2 has a quaternion whose norm is not 1'),
    ({'r1.tum': '1.0 0 0 0\n'}, 'row 1 has 4 columns, not 8: time [s], x, y, z, qx, qy, qz, qw'),
    ({'r1.tum': '1.7e9 0 0 0 0 0 0 1\n1.7e9 1 0 0 0 0 0 1\n'},
     'r1.tum has two poses at 1700000000.000000000 s'),
    ({'r1.tum': '1.0 0 0 0 0 0 0 1\n', 'landmarks.csv': 'id,x,y\n8,1,2\n8,1,2\n8,50,50\n'},
     'landmarks.csv has two positions of landmark 8'),
])
def test_a_truth_that_is_damaged_or_contradicts_itself_is_reported(
        replayed, evaluate, tmp_path, files, sentence):
    (tmp_path / 'truth').mkdir()
    for name, text in files.items():
        (tmp_path / 'truth' / name).write_text(text, encoding='utf-8')

    status, *printed = evaluate(
        replayed / 'two_circles', '--no-plots', '--truth', tmp_path / 'truth')

    assert (status, printed[-1].err.count('\n')) == (1, 1)
    assert sentence in printed[-1].err


def test_invalid_messages_of_ground_truth_are_counted(replayed, evaluate, tmp_path):
    truth = list(bags.read(BAGS / 'two_circles'))
    poses = [m for m in truth if m.topic.endswith('r1/ground_truth')]
    write_bag(tmp_path / 'truth', [*truth, *(replace(m, raw=m.raw[:30]) for m in poses[:7])])

    status, report, printed = evaluate(
        replayed / 'two_circles', '--no-plots', '--truth', tmp_path / 'truth')

    assert (status, report['invalid_true_messages']) == (0, 7)
    assert '7 invalid messages of ground truth in' in printed.out


def test_true_poses_that_contradict_earlier_ones_of_their_stamps_are_counted(
        replayed, evaluate, tmp_path):
    truth = list(bags.read(BAGS / 'two_circles'))
    r1, r2 = (
        [m for m in truth if m.topic.endswith(f'{name}/ground_truth')] for name in ('r1', 'r2'))
    wrong = [replace(m, topic=r1[0].topic, raw=m.raw) for m in r2[1:5]]
    write_bag(tmp_path / 'truth', [*truth, *wrong, r1[0]])

    status, report, _ = evaluate(
        replayed / 'two_circles', '--no-plots', '--truth', tmp_path / 'truth')

    # The message that is there twice contradicts nothing.
    assert (status, report['invalid_true_messages']) == (0, 4)


@pytest.mark.parametrize(('records', 'sentence'), [
    ([], 'no topic <robot>/ground_truth'),
    (meeting_truth(), 'covers no estimated pose (of p, q)'),
])
def test_a_truth_without_matching_poses_is_reported(
        replayed, evaluate, tmp_path, records, sentence):
    truth = write_bag(tmp_path / 'truth', [raw_record(record) for record in records])

    status, _, printed = evaluate(replayed / 'rendezvous', '--no-plots', '--truth', truth)

    assert status == 1
    assert sentence in printed.err


def test_results_are_not_overwritten_without_force(replayed, evaluate):
    assert evaluate(replayed / 'two_circles', '--no-plots')[0] == 0

    status, _, printed = evaluate(replayed / 'two_circles', '--no-plots')

    assert status == 2
    assert '--force' in printed.err


@pytest.mark.parametrize('name', [
    'r2.tum', 'r1_truth.tum', 'r1_covariance.csv', 'ways.png', 'errors.png', 'nees.png'])
def test_no_file_of_another_run_is_overwritten_without_force(replayed, evaluate, tmp_path, name):
    """The output may be the folder of a run, which has ``<robot>.tum`` too."""
    if name.endswith('.png'):
        pytest.importorskip('matplotlib', reason='matplotlib is not installed')
    other = tmp_path / 'evaluation' / name
    other.parent.mkdir()
    other.write_text('of another run')

    plots = [] if name.endswith('.png') else ['--no-plots']
    status, report, printed = evaluate(replayed / 'two_circles', *plots)

    assert (status, report) == (2, None)
    assert f'{name} exists' in printed.err
    assert [*other.parent.iterdir()] == [other]
    assert other.read_text() == 'of another run'


def test_force_deletes_what_an_earlier_evaluation_has_left(replayed, evaluate, tmp_path):
    output = tmp_path / 'evaluation'
    output.mkdir()
    for name in ('nees.png', 'r9_truth.tum', 'r9_covariance.csv', 'r9.tum', 'notes.txt'):
        (output / name).write_text('of an earlier one')

    status, _, _ = evaluate(replayed / 'two_circles', '--no-plots', '--force')

    assert status == 0
    assert {path.name for path in output.iterdir()} == {
        'evaluation.json', 'r9.tum', 'notes.txt', *(
            f'{robot}{end}' for robot in ('r1', 'r2')
            for end in ('.tum', '_truth.tum', '_covariance.csv'))}


@pytest.mark.parametrize('length', ['0', '-1', 'far', 'inf'])
def test_a_bad_length_is_a_usage_error(replayed, evaluate, length):
    assert evaluate(replayed / 'two_circles', '--delta', length)[0] == 2


def test_output_of_the_smoother_is_evaluated(evaluate, tmp_path):
    assert run_verb(
        'smooth', BAGS / 'rendezvous', '--params', BAGS / 'rendezvous.yaml', '--output',
        tmp_path / 'smoothed') == 0

    status, report, _ = evaluate(tmp_path / 'smoothed', '--no-plots')

    own = json.loads((tmp_path / 'smoothed/summary.json').read_text())
    assert status == 0
    for robot in ('p', 'q'):
        assert report['robots'][robot]['ape']['unaligned']['position']['rmse'] == pytest.approx(
            own['rmse'][robot]['position'], abs=1e-12)


@pytest.mark.usefixtures('interrupted_write')
def test_an_interrupt_while_files_are_written_leaves_all_of_them(replayed, evaluate):
    status, written, _ = evaluate(replayed / 'two_circles', '--no-plots')

    assert (status, written is None) == (130, False)
