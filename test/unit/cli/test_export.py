# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`export`: graphs and tables of a bag, which `convert` makes a bag with the same estimates of."""

from dataclasses import replace
import json
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.records import (
    Observation, Odometry, PosePrior, RobotObservation, RobotScan, Scan)
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.session import simulation
from helpers.optional import is_installed, optional
from helpers.paths import BAGS
from helpers.records import odometry, robot_scan, scan, without_ids
from helpers.ros import (
    assert_one_sentence, csv_rows, raw_record, run_verb, write_bag, write_parameters)

gtsam = optional('gtsam')

SHIPPED = {name: BAGS / name for name in ('two_circles', 'rendezvous')}
#: Rounding of integrated odometry, of inverted covariances and of quaternions, over 127 steps.
ROUNDING = 1e-9


@pytest.fixture(params=SHIPPED)
def bag(request):
    return SHIPPED[request.param]


def bag_without_ids(folder):
    path = folder / 'without_ids'
    write_bag(path, map(raw_record, without_ids(simulation.parse({
        'loops': 2, 'landmarks': 30, 'seed': 3, 'landmark_sigma': [0.03, 0.03]}).records())))
    write_parameters(folder / f'{path.name}.yaml')
    return path


def estimates(bag, params, folder):
    """Return all numbers of the trajectories of a run, by file."""
    assert run_verb('replay', bag, '--params', params, '--output', folder) == 0
    return {
        path.name: np.array([
            [float(x) for name, x in row.items() if name != 'frame'] for row in csv_rows(path)])
        for path in folder.glob('trajectory_*.csv')}


def exported(kind, bag, folder, *options):
    output = folder / f'exported.{kind}'
    status = run_verb(
        'export', kind, bag, '--params', f'{bag}.yaml', '--output', output, *options)
    return status, output


@pytest.mark.parametrize('kind', ['g2o', 'csv'])
def test_no_input_is_replaced_by_an_export(kind, tmp_path, capsys):
    bag = bag_without_ids(tmp_path)
    params = tmp_path / 'params.yaml'
    params.write_bytes(Path(f'{bag}.yaml').read_bytes())

    into_bag = run_verb('export', kind, bag, '--params', params, '--output', bag, '--force')
    assert_one_sentence((into_bag, *capsys.readouterr()), 2, 'is the bag to read')
    beside = run_verb(
        'export', kind, bag, '--params', params, '--output', tmp_path / 'params', '--force')
    assert_one_sentence((beside, *capsys.readouterr()), 2, 'is the parameter file to read')


@pytest.mark.parametrize('kind', ['g2o', 'csv'])
def test_an_export_converted_back_gives_the_same_estimates(bag, kind, tmp_path):
    expected = estimates(bag, f'{bag}.yaml', tmp_path / 'expected')
    status, output = exported(kind, bag, tmp_path)
    assert status == 0
    assert run_verb('convert', kind, '--input', output, '--output', tmp_path / 'back') == 0

    got = estimates(tmp_path / 'back', f'{output}.yaml', tmp_path / 'got')

    assert got.keys() == expected.keys()
    for name, rows in expected.items():
        assert_allclose(got[name], rows, rtol=0.0, atol=ROUNDING)


def test_measurements_of_a_robot_that_was_not_recorded_are_counted_and_left_out(tmp_path, capsys):
    path = tmp_path / 'bag'
    write_bag(path, (m for m in bags.read(SHIPPED['rendezvous']) if m.topic != 'q/odom'))
    Path(f'{path}.yaml').write_text(Path(f"{SHIPPED['rendezvous']}.yaml").read_text())
    expected = estimates(path, f'{path}.yaml', tmp_path / 'expected')
    capsys.readouterr()

    status, output = exported('csv', path, tmp_path)

    assert status == 0
    assert 'q: without odometry, not exported: ' in capsys.readouterr().out
    assert run_verb('convert', 'csv', '--input', output, '--output', tmp_path / 'back') == 0
    got = estimates(tmp_path / 'back', f'{output}.yaml', tmp_path / 'got')
    assert {name for name, rows in got.items() if len(rows)} == {
        name for name, rows in expected.items() if len(rows)}
    assert_allclose(
        got['trajectory_p.csv'], expected['trajectory_p.csv'], rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize('name', [*SHIPPED, 'without_ids'])
def test_the_chi_square_of_the_graph_is_that_of_the_smoother(name, tmp_path, capsys):
    bag = SHIPPED.get(name) or bag_without_ids(tmp_path)
    run_verb('smooth', bag, '--params', f'{bag}.yaml', '--output', tmp_path / 'smoothed')
    solved, = json.loads(
        (tmp_path / 'smoothed' / 'alignment.json').read_text(encoding='utf-8'))['maps']
    capsys.readouterr()

    _, output = exported('g2o', bag, tmp_path)

    said = f'chi-square of all edges at the estimates: {solved["chi_square"]:.6g}\n'
    assert said in capsys.readouterr().out
    poses, points = errors(output)
    # The file has all digits; the heading of an observed robot adds less than 1e-11.
    assert cost(poses) + cost(points) == pytest.approx(solved['chi_square'], rel=1e-9)


@pytest.mark.skipif(not is_installed('gtsam'), reason='gtsam is not installed')
def test_gtsam_reads_the_same_relative_poses(bag, tmp_path):
    _, output = exported('g2o', bag, tmp_path)

    factors, values = gtsam.readG2o(str(output), False)

    poses, _ = errors(output)
    # Its error is the logarithm of the pose that is the error of g2o.
    logarithms = [(gtsam.Pose2.Logmap(gtsam.Pose2(*e)), upper) for e, upper in poses]
    assert factors.size() == len(poses)
    assert 2.0 * factors.error(values) == pytest.approx(cost(logarithms), rel=1e-9)


def errors(path):
    """Return error and information of the edges between poses, and to landmarks, as in g2o."""
    lines = [line.split() for line in path.read_text(encoding='utf-8').splitlines()]
    vertices = {
        words[1]: np.array(words[2:], float) for words in lines if words[0].startswith('VERTEX')}
    poses, points = [], []
    for tag, *words in lines:
        if not tag.startswith('EDGE'):
            continue
        x, y, phi = vertices[words[0]]
        end, numbers = vertices[words[1]], np.array(words[2:], float)
        error = np.exp(-1j * phi) * complex(end[0] - x, end[1] - y) - complex(*numbers[:2])
        if tag == 'EDGE_SE2_XY':
            points.append(([error.real, error.imag], numbers[2:]))
        else:
            error *= np.exp(-1j * numbers[2])
            turned = (end[2] - phi - numbers[2] + np.pi) % (2 * np.pi) - np.pi
            poses.append(([error.real, error.imag, turned], numbers[3:]))
    return poses, points


def cost(edges):
    """Return the sum of e^T I e over errors e and the upper triangles of I."""
    total = 0.0
    for error, upper in edges:
        matrix = np.zeros((len(error), len(error)))
        matrix[np.triu_indices(len(error))] = upper
        total += error @ (matrix + np.triu(matrix, 1).T) @ error
    return total


def test_what_is_applied_to_the_data_is_left_out_of_their_parameters(tmp_path):
    applied = {
        'r1.sensor_pose': [0.25, 0.0, 1.0], 'r1.odometry_scale': [0.9, 1.1],
        'odometry_turn_bias': 0.01, 'observation_noise_growth': 0.2,
        'landmark_noise_scale': 2.0, 'r2.odometry_noise_scale': 0.5,
        'r2.use_odometry_covariance': False, 'max_delay': 0.2}
    params = write_parameters(tmp_path / 'p.yaml', robots=['r1', 'r2'], **applied)
    left = {}
    for kind in 'g2o', 'csv':
        output = tmp_path / kind
        assert run_verb(
            'export', kind, SHIPPED['two_circles'], '--params', params, '--output', output) == 0
        left[kind] = parameters.load_values(
            tmp_path / f'{kind}.yaml', ['estimator']).keys() - {'robots'}

    ids = {'r1.id', 'r2.id'}
    assert left == {
        'g2o': {'max_delay', 'r1.max_speed', 'r2.max_speed'} | ids,
        'csv': applied.keys() - {'r1.sensor_pose'} | ids}


def test_scans_before_time_0_by_a_delay_are_left_out_of_tables(tmp_path, capsys):
    params = write_parameters(tmp_path / 'p.yaml', robots=['r1', 'r2'], **{
        'r1.sensor_delay': 1.5, 'max_delay': 2.0})
    expected = estimates(SHIPPED['two_circles'], params, tmp_path / 'expected')
    output = tmp_path / 'csv'
    assert run_verb(
        'export', 'csv', SHIPPED['two_circles'], '--params', params, '--output', output) == 0

    # Those at 1.0, 1.2 and 1.4 s.
    assert 'r1: scans before time 0, not exported: 3\n' in capsys.readouterr().out
    assert run_verb('convert', 'csv', '--input', output, '--output', tmp_path / 'back') == 0

    got = estimates(tmp_path / 'back', f'{output}.yaml', tmp_path / 'got')
    for name, rows in expected.items():
        assert_allclose(got[name], rows, rtol=0.0, atol=ROUNDING)


def test_poses_on_initialpose_are_those_of_their_robot(tmp_path):
    prior = raw_record(PosePrior('r2', 10**9, np.array([1.0, 2.0, 0.5]), 0.1 * np.eye(3)))
    write_bag(tmp_path / 'bag', [
        *(raw_record(odometry(robot, 1000)) for robot in ('r1', 'r2')),
        replace(prior, topic='initialpose')])
    params = write_parameters(
        tmp_path / 'p.yaml', robots=['r1', 'r2'], initialpose_robot='r2')

    assert run_verb(
        'export', 'csv', tmp_path / 'bag', '--params', params, '--output', tmp_path / 'csv') == 0

    row, = csv_rows(tmp_path / 'csv' / 'pose_priors.csv')
    assert (row['robot'], float(row['y'])) == ('r2', 2.0)


def facing_team(names, cameras=1):
    """Return records of robots in a row that see the others and some landmarks, and drive on."""
    rng, R = np.random.default_rng(1), 0.0025 * np.eye(2)
    points = {100 + k: np.array(p) for k, p in enumerate(rng.uniform(-6.0, 6.0, (8, 2)))}
    places = {name: np.array([0.0, 2.0 * k]) for k, name in enumerate(names)}
    for step in range(30):
        for name, place in places.items():
            x, t = np.array([0.05 * step, 0.0]), 10**9 + step * 10**8
            yield Odometry(name, t, np.append(x, 0.0), 1e-4 * np.eye(3))
            for _ in range(cameras):
                yield Scan(name, t, tuple(
                    Observation(id_, point - place - x + rng.normal(0.0, 0.05, 2), R)
                    for id_, point in points.items()))
            yield RobotScan(name, t, tuple(
                RobotObservation(other, position - place + rng.normal(0.0, 0.05, 2), R)
                for other, position in places.items() if other != name))


@pytest.mark.parametrize('kind', ['g2o', 'csv'])
@pytest.mark.parametrize('cameras', [1, 2])
@pytest.mark.parametrize('ids', [{}, {'zoe.id': 7, 'bob.id': 1, 'amy.id': 2}])
def test_ids_of_robots_and_scans_of_several_sensors_survive_the_round_trip(
    kind, cameras, ids, tmp_path
):
    names = ['zoe', 'bob', 'amy']
    numbers = {name: ids.get(f'{name}.id', k) for k, name in enumerate(names, start=1)}
    bag = write_bag(tmp_path / 'bag', [
        raw_record(record, numbers) for record in facing_team(names, cameras)])
    write_parameters(tmp_path / 'bag.yaml', robots=names, gate_probability=1.0, **ids)
    expected = estimates(bag, f'{bag}.yaml', tmp_path / 'expected')
    _, output = exported(kind, bag, tmp_path)
    assert run_verb('convert', kind, '--input', output, '--output', tmp_path / 'back') == 0

    got = estimates(tmp_path / 'back', f'{output}.yaml', tmp_path / 'got')

    assert got.keys() == expected.keys() == {f'trajectory_{name}.csv' for name in names}
    for name, rows in expected.items():
        assert_allclose(got[name], rows, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize('kind', ['g2o', 'csv'])
def test_an_earlier_export_is_replaced_only_if_forced(kind, tmp_path, capsys):
    bag = SHIPPED['two_circles']
    exported(kind, bag, tmp_path)
    capsys.readouterr()

    status, output = exported(kind, bag, tmp_path)
    assert_one_sentence((status, *capsys.readouterr()), 2, f'{output} exists', '--force')
    assert exported(kind, bag, tmp_path, '--force')[0] == 0


def test_tables_of_an_earlier_export_that_are_not_replaced_are_deleted(tmp_path):
    _, output = exported('csv', SHIPPED['rendezvous'], tmp_path)
    assert (output / 'robots.csv').exists()

    exported('csv', SHIPPED['two_circles'], tmp_path, '--force')

    assert sorted(path.name for path in output.iterdir()) == [
        'ground_truth.csv', 'ground_truth_landmarks.csv', 'landmarks.csv', 'odometry.csv']


def test_observations_that_a_graph_cannot_have_are_counted(tmp_path, capsys):
    records = [odometry('r1', 0), odometry('r2', 0), odometry('r1', 100)]
    bag = write_bag(tmp_path / 'bag', [
        raw_record(record) for record in (*records, scan('r1', 100, [(-1, (1, 2)), (5, (2, 1))]))])

    status = run_verb(
        'export', 'g2o', bag, '--params', write_parameters(tmp_path / 'p.yaml'),
        '--output', tmp_path / 'graph.g2o')

    assert status == 0
    assert 'r1: poses: 2, observations: 1\n' in (said := capsys.readouterr().out)
    assert 'r1: rejected as no_identity: 1\n' in said


def test_observations_between_maps_that_are_not_joined_are_counted(tmp_path, capsys):
    records = [odometry(name, ms) for ms in (0, 100) for name in ('r1', 'r2')]
    bag = write_bag(tmp_path / 'bag', [
        raw_record(record, {'r1': 1, 'r2': 2})
        for record in (*records, robot_scan('r1', 100, [('r2', (2, 1))]))])

    status = run_verb(
        'export', 'g2o', bag, '--params', write_parameters(tmp_path / 'p.yaml'),
        '--output', tmp_path / 'graph.g2o')

    assert status == 0
    assert 'between maps that are not joined, not exported: 1\n' in capsys.readouterr().out


@pytest.mark.usefixtures('interrupted_write')
@pytest.mark.parametrize('kind', ['g2o', 'csv'])
def test_an_interrupt_while_an_export_is_written_leaves_all_of_it(kind, tmp_path):
    status, output = exported(kind, SHIPPED['two_circles'], tmp_path)

    assert status == 130
    assert Path(f'{output}.yaml').exists()
    assert run_verb('convert', kind, '--input', output, '--output', tmp_path / 'back') == 0
