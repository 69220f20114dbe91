# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`smooth`: smoothed trajectories and maps of a bag, and error messages."""

from dataclasses import replace
import json
import shutil

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.cli import offline_run
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.offline_matching import match
from fej_slam_ros.core.records import NO_ID, NS, Odometry, Scan
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import deserialize
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.ros.session.smoother_session import SmootherSession
from helpers.paths import BAGS
from helpers.records import odometry, robot_scan, scan, team, without_ids
from helpers.ros import (
    assert_one_sentence, csv_rows, decoded, feed, meeting, odometry_message, raw, raw_record,
    run_settings, run_verb, save, summary_of, write_bag, write_parameters)


#: Two robots that observe the same landmarks, and two that observe each other.
CIRCLES = [raw_record(record) for record in simulation.parse(
    {'loops': 1, 'steps_per_loop': 20, 'landmarks': 12}).records()]
RENDEZVOUS = list(bags.read(BAGS / 'rendezvous'))
MEETING = [raw_record(record) for record in meeting()]


@pytest.fixture
def smooth(places, capsys):
    """Return a function that smooths messages and returns status, output and error output."""
    bag, params, output = places

    def run(messages, *options, **parameters):
        if parameters:
            write_parameters(params, **parameters)
        write_bag(bag, messages)
        status = run_verb('smooth', bag, '--params', params, '--output', output, *options)
        return status, *capsys.readouterr()

    return run


@pytest.fixture
def met(smooth, places):
    """Return the output folder of two robots that met."""
    status, _, error = smooth(
        RENDEZVOUS, '--bag', robots=['p', 'q'], shared_landmark_ids=False)
    assert (status, error) == (0, '')
    return places[2]


def alignment_of(folder):
    return json.loads((folder / 'alignment.json').read_text(encoding='utf-8'))


def test_output_is_that_of_the_team_smoother_given_the_records(smooth, places):
    direct = TeamSmoother(team())
    for message in CIRCLES:
        direct.add(decoded(message), message.received)
        list(direct.take())
    list(direct.close())
    direct.adopt(solve(direct.task()))

    assert smooth(CIRCLES)[::2] == (0, '')

    assert summary_of(places[2])['state_hash'] == direct.state_hash()
    rows = csv_rows(places[2] / 'trajectory_r2.csv')
    for row, estimate in zip(rows, direct.trajectories['r2'].estimates(), strict=True):
        assert int(row['stamp_ns']) == estimate.stamp
        assert [float(row[name]) for name in ('x', 'y', 'yaw')] == estimate.pose.tolist()
        assert float(row['cov_xyaw']) == estimate.P[0, 2]
        assert row['frame'] == 'map'


def test_all_files_are_written(met):
    assert {path.name for path in met.iterdir()} == {
        'trajectory_p.csv', 'trajectory_q.csv', 'p.tum', 'q.tum', 'landmarks.csv', 'ids.csv',
        'summary.json', 'alignment.json', 'bag'}


def test_the_summary_has_the_keys_of_replay_except_innovations_and_matches(smooth, places):
    smooth(CIRCLES)
    replayed = places[2].with_name('replayed')
    assert run_verb('replay', *places[:1], '--params', places[1], '--output', replayed) == 0

    assert summary_of(replayed).keys() - summary_of(places[2]).keys() == {
        'nis', 'parameter_changes', 'without_identity'}
    assert summary_of(places[2])['counts'] == summary_of(replayed)['counts']
    assert summary_of(places[2])['rmse'].keys() == {'r1', 'r2', 'landmarks'}


def test_the_alignment_has_base_node_fit_and_associations(met):
    joint, = alignment_of(met)['maps']
    rows = csv_rows(met / 'trajectory_q.csv')

    assert (joint['frame'], joint['robots']) == ('map', ['p', 'q'])
    base = joint['base_nodes']['q']
    # The base node is the first pose of the other robot.
    assert_allclose(base['pose'], [float(rows[0][name]) for name in ('x', 'y', 'yaw')])
    assert_allclose(base['covariance'][0], [
        float(rows[0][name]) for name in ('cov_xx', 'cov_xy', 'cov_xyaw')], rtol=1e-6)
    # Chi-square of 4000 degrees of freedom exceeds this with probability 1e-4.
    assert joint['chi_square'] / joint['dof'] < 1.09
    assert all([robot for robot, _ in pair] == ['p', 'q'] for pair in joint['associations'])


def slipping():
    """
    Return records of r1 among landmarks, which observes r2, at 1 m/s and one step a second.

    Between 10 and 12 s the wheels of r2 turn, while it stands still.

    """
    for k in range(31):
        x, slipped = float(k), float(np.clip(k - 10, 0, 2))
        for robot in ('r1', 'r2'):
            yield odometry(robot, 1000 * k, [x, 0.0, 0.0], 1e-4 * np.eye(3))
        yield scan('r1', 1000 * k, [(i, (10.0 * i - x, 5.0)) for i in range(4)])
        yield robot_scan('r1', 1000 * k, [('r2', (-slipped, 3.0))])


def test_released_odometry_is_stated_with_its_time(smooth, places):
    records = [raw_record(record, {'r1': 1, 'r2': 2}) for record in slipping()]

    status, printed, error = smooth(records, robots=['r1', 'r2'])

    assert (status, error) == (0, '')
    line, = [line for line in printed.splitlines() if line.startswith('released')]
    assert line == (
        'released odometry of r2 from 10.0 to 12.0 s: 15 observations contradicted it. The'
        ' wheels slipped, or the robot was carried')
    released, = alignment_of(places[2])['released_odometry']
    assert released == {
        'robot': 'r2', 'intervals_ns': [[10 * NS, 12 * NS]], 'observations': 15}
    # The position of r2 at the end, by the last observation of it.
    end = csv_rows(places[2] / 'trajectory_r2.csv')[-1]
    assert_allclose([float(end['x']), float(end['y'])], [28.0, 3.0], atol=0.01)


def long_and_short():
    """Return records of two robots at rest; all ranges of r2 are 4 % too short."""
    rng, corners = np.random.default_rng(0), [(3.0, 4.0), (-5.0, 2.0), (-4.0, -3.0), (6.0, -4.0)]
    for k in range(31):
        for robot, scale in (('r1', 1.0), ('r2', 0.96)):
            yield odometry(robot, 1000 * k, [0.0, 0.0, 0.0], 1e-4 * np.eye(3))
            yield scan(robot, 1000 * k, [
                (i, scale * np.array(p) + rng.normal(0.0, 0.1, 2)) for i, p in enumerate(corners)])


def test_a_join_of_maps_of_different_scales_is_stated(smooth, places):
    records = [raw_record(record, {'r1': 1, 'r2': 2}) for record in long_and_short()]

    status, printed, error = smooth(records, robots=['r1', 'r2'])

    assert (status, error) == (0, '')
    join, = alignment_of(places[2])['scaled_joins']
    assert (join['robots'], join['others']) == (['r1'], ['r2'])
    # The standard error of lengths of 5 m by 31 observations is 0.3 %.
    assert join['scale'] == pytest.approx(1.0 / 0.96, abs=0.01)
    assert f'the map of r1 was {join["scale"] - 1.0:.1%} larger than that of r2' in printed


def test_ids_list_the_merged_landmarks(met):
    names = {}
    for row in csv_rows(met / 'ids.csv'):
        names.setdefault(row['landmark'], []).append([row['robot'], int(row['id'])])

    assert names.keys() == {row['id'] for row in csv_rows(met / 'landmarks.csv')}
    joint, = alignment_of(met)['maps']
    assert sorted(sorted(pair) for pair in names.values() if len(pair) > 1) == sorted(
        joint['associations'])


def test_the_bag_has_the_final_poses_at_their_stamps(met):
    rows = csv_rows(met / 'trajectory_q.csv')
    poses = [m for m in bags.read(met / 'bag') if m.topic == 'q/pose']

    decoded_poses = [deserialize(m.raw, m.type_name) for m in poses]
    assert [m.received for m in poses] == [int(row['stamp_ns']) for row in rows]
    assert [m.pose.pose.position.x for m in decoded_poses] == [float(row['x']) for row in rows]
    topics = bags.topics(met / 'bag')
    assert topics.keys() == {
        'p/pose', 'q/pose', 'p/path', 'q/path', 'q/base_node', 'smoother/landmarks',
        'smoother/markers', 'diagnostics'}
    assert {name for name, topic in topics.items() if topic.latched} == {
        'q/base_node', 'smoother/landmarks'}


def test_the_table_lists_maps_base_nodes_and_message_sizes(smooth):
    status, said, _ = smooth(RENDEZVOUS, robots=['p', 'q'], shared_landmark_ids=False)

    assert status == 0
    assert 'p, q in map: chi-square' in said
    assert 'landmarks associated' in said
    lines = said.splitlines()
    base = next(k for k, line in enumerate(lines) if line.startswith('base node'))
    assert lines[base + 1].startswith('q ')
    sizes = next(k for k, line in enumerate(lines) if line.startswith('message from'))
    assert [line.split()[-1] for line in lines[sizes + 1:]] == ['subset', 'subset']


@pytest.mark.parametrize(('scale', 'said_so'), [(1.0, False), (0.3, True)])
def test_a_chi_square_far_above_its_degrees_of_freedom_is_said(smooth, scale, said_so):
    _, said, _ = smooth(
        CIRCLES, robots=['r1', 'r2'], odometry_noise_scale=scale, landmark_noise_scale=scale)

    # Standard deviations of 0.3 of the true ones: 1 / 0.09.
    assert ('times its degrees of freedom: covariances are too small' in said) == said_so


def test_robots_that_did_not_meet_are_reported(smooth, places):
    status, said, _ = smooth(CIRCLES, robots=['r1', 'r2'], shared_landmark_ids=False)

    assert status == 0
    assert 'r1 is not in map: it has no rendezvous with another robot' in said
    frames = {row['frame'] for row in csv_rows(places[2] / 'landmarks.csv')}
    assert frames == {'r1/map', 'r2/map'}
    assert 'rmse' not in summary_of(places[2])


@pytest.mark.parametrize(('kinds', 'reason'), [
    (['odom'], 'it has observed no landmark or robot'),
    (['odom', 'landmarks'], 'it is the only robot, and stays in its own frame')])
def test_a_robot_alone_has_not_missed_a_rendezvous(smooth, caplog, kinds, reason):
    own = [m for m in CIRCLES if m.topic in {f'r1/{kind}' for kind in kinds}]

    status, said, _ = smooth(own, robots=['r1'])

    assert status == 0
    assert f'r1 is not in map: {reason}\n' in said
    assert ('has no observations of landmarks or robots' in caplog.text) == (kinds == ['odom'])


def test_a_robot_alone_is_drawn_with_its_map_in_its_own_frame(smooth, places, monkeypatch):
    pytest.importorskip('matplotlib', reason='matplotlib is not installed')
    drawn = []
    monkeypatch.setattr(offline_run, 'write_figure', lambda *figure: drawn.append(figure))

    status, *_ = smooth(CIRCLES, '--picture', robots=['r1'])

    ((_, _, title, result, robots, *_),) = drawn
    rows = csv_rows(places[2] / 'landmarks.csv')
    assert (status, robots) == (0, ['r1'])
    assert 'estimates in r1/map' in title
    assert {*result.landmarks.ids} == {int(row['id']) for row in rows}
    assert len(result.trajectories['r1'].poses) == len(csv_rows(places[2] / 'trajectory_r1.csv'))


def test_smoothing_again_gives_the_same_bytes(smooth, places):
    smooth(CIRCLES)
    first = {path.name: path.read_bytes() for path in places[2].iterdir()}

    assert run_verb('smooth', *places[:1], '--params', places[1], '--output', places[2],
                    '--force') == 0

    assert {path.name: path.read_bytes() for path in places[2].iterdir()} == first


def test_exact_odometry_is_counted_as_a_bad_covariance(smooth, places):
    exact = odometry_message(450, twist_covariance=np.diag([0.1, 0.0, 0, 0, 0, 0.1]))

    smooth([*MEETING, raw('r1/odom', exact, 450)])

    summary = summary_of(places[2])
    assert summary['robots']['r1']['refusals'] == {'bad_covariance': 1}
    assert summary['robots']['r1']['steps'] == 5


@pytest.mark.parametrize('name', ['odometry_sigma', 'r2.odometry_sigma'])
def test_odometry_without_noise_is_explained_by_its_parameter(smooth, name):
    given = {'robots': ['r1', 'r2'], name: [0.1, 0.0, 0.1]}

    assert_one_sentence(
        smooth(MEETING, **given), 2, f"parameter '{name}' contains 0", 'above 0')


def test_results_are_not_overwritten_without_force(smooth, places):
    places[2].mkdir()
    (places[2] / 'alignment.json').write_text('mine')

    assert_one_sentence(smooth(MEETING), 2, 'alignment.json exists', '--force')
    assert (places[2] / 'alignment.json').read_text() == 'mine'


def test_a_bag_of_other_robots_is_reported(smooth):
    assert_one_sentence(
        smooth(RENDEZVOUS), 1, 'none of the topics r1/odom, r2/odom', 'parameter robots')


@pytest.mark.parametrize('node', ['/**', 'smoother', 'estimator'])
def test_parameters_may_be_those_of_the_estimator(places, node):
    bag, params, output = places
    write_bag(bag, MEETING)
    write_parameters(params, node, robots=['r1', 'r2'])

    assert run_verb('smooth', bag, '--params', params, '--output', output) == 0


def test_a_checkpoint_of_a_live_run_is_continued_only_by_the_option(smooth, places):
    saved = places[2].parent / 'saved'
    team = {'robots': ['p', 'q'], 'shared_landmark_ids': False}
    live = SmootherSession(
        run_settings('p', 'q', shared_landmark_ids=False, checkpoint=str(saved)), None)
    feed(live, RENDEZVOUS[:300])
    save(live)
    supervised = {**team, 'checkpoint': str(saved), 'restore': str(saved)}

    assert smooth(RENDEZVOUS, **supervised)[0] == 0
    whole = summary_of(places[2])
    shutil.rmtree(places[0])
    assert smooth(RENDEZVOUS[300:], '--force', '--restore', str(saved), **team)[0] == 0
    rest = summary_of(places[2])

    assert 'duplicate' not in whole['robots']['p']['refusals']
    assert rest['robots'] == whole['robots']
    assert rest['not_in_map'] == {}


def test_input_that_a_checkpoint_has_used_already_is_no_error(smooth, places):
    saved = places[2].parent / 'saved'
    live = SmootherSession(run_settings('r1', 'r2', checkpoint=str(saved)), None)
    feed(live, MEETING)
    save(live)

    status, _, error = smooth(MEETING, '--restore', str(saved), robots=['r1', 'r2'])

    assert (status, error) == (0, '')


def test_a_missing_checkpoint_is_one_sentence(smooth):
    assert_one_sentence(
        smooth(MEETING, '--restore', '/nowhere/saved', robots=['r1', 'r2']), 1,
        'cannot read the checkpoint /nowhere/saved', 'No such file')


def test_without_ids_the_result_is_that_of_the_matched_observations_with_their_ids(
        smooth, places):
    records = [*simulation.parse({
        'loops': 2, 'landmarks': 30, 'seed': 3, 'landmark_sigma': [0.03, 0.03]}).records()]
    stripped = without_ids(records)
    matches = match(team(), [(r, None) for r in stripped if isinstance(r, (Odometry, Scan))])

    status, printed, error = smooth(map(raw_record, stripped))
    found = np.loadtxt(places[2] / 'r2.tum')
    shutil.rmtree(places[0])
    smooth([raw_record(known(r, matches)) for r in records], '--force')

    assert (status, error) == (0, '')
    assert 'observations without ID matched landmarks' in printed
    # Rounding of two solutions in which landmarks have another order.
    assert_allclose(found, np.loadtxt(places[2] / 'r2.tum'), atol=1e-6)


def known(record, matches):
    """Return a record with the true IDs of the matched observations alone."""
    if not isinstance(record, Scan):
        return record
    return replace(record, observations=tuple(
        o for o in record.observations
        if (record.robot, record.stamp, o.z.tobytes()) in matches.ids))


def test_with_unmatched_observations_alone_a_scan_is_no_step(smooth):
    _, printed, _ = smooth(map(raw_record, [
        odometry('r1', 0), odometry('r1', 100), scan('r1', 100, [(NO_ID, (1.0, 0.0))])]))

    assert 'rejected messages and single observations: no_identity 1' in printed


def test_a_map_without_redundant_measurements_has_no_ratio_of_chi_square(smooth):
    status, printed, error = smooth([
        message for message in CIRCLES if message.topic.endswith('/odom')])

    assert (status, error) == (0, '')
    assert ', 0 degrees of freedom' in printed
