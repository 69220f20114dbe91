# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`doctor` finds faults planted in copies of the shipped bags, and nothing in correct bags."""

from dataclasses import replace
import json
from math import nan

import numpy as np
import pytest

from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.records import Odometry
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.doctor.trial import REASONS_OF_THE_RUN
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.ros.session.rejection_cures import CURES
from helpers.faults import (
    at, BAGS, both, columns, crowded, delayed, each, entries, exchanged, floating_ids, framed,
    in_degrees, in_map, in_whole_seconds, kept, looped, moved, NS, of_type_pose, out_of_order,
    planted, positions, recorded_late, scaled, shifted, turned, twice, twist_covariance, with_pose,
    with_poses, without, without_cov_xy)
from helpers.ros import empty_cloud, raw_record, run_verb, write_bag, write_parameters
from helpers.slow import slow

C, R = 'two_circles', 'rendezvous'

#: Bag, fault, exit status, and the name, place and a word of the cure of the finding.
FAULTS = {
    'odometry missing': (C, without('r2/odom'), 1, 'no_odometry', 'r2/odom', 'remap'),
    'landmarks missing': (C, without('r2/landmarks'), 1, 'no_landmarks', 'r2/landmarks', 'remap'),
    'landmarks of a robot missing that observes others': (
        R, without('q/landmarks'), 0, 'no_landmarks', 'q/landmarks', ''),
    'wrong type': (C, of_type_pose, 1, 'wrong_type', 'r2/odom', 'nav_msgs/msg/Odometry'),
    'gap': (C, without('r1/odom', slice(40, 65)), 1, 'gap', 'r1/odom', 'link'),
    'gap at 2 Hz': (R, without('p/odom', slice(20, 30)), 1, 'gap', 'p/odom', 'link'),
    'gap in scans': (C, without('r1/landmarks', slice(40, 65)), 0, 'gap', 'r1/landmarks', ''),
    'slow odometry': (C, kept('r2/odom', 5), 0, 'slow_odometry', 'r2/odom', 'often'),
    'half of the odometry': (C, kept('r2/odom', 2), 0, 'slow_odometry', 'r2/odom', 'often'),
    'short gap': (C, without('r1/odom', slice(50, 54)), 0, 'gap', 'r1/odom', 'link'),
    'slow odometry towards the end': (
        C, without('r1/odom', slice(95, None, 2)), 0, 'irregular_rate', 'r1/odom', 'recorder'),
    'odometry too slow to wait for': (
        C, kept('r2/odom', 10), 1, 'slow_odometry', 'r2/odom', '5 Hz'),
    'slow scans': (C, kept('r2/landmarks', 6), 0, 'slow_scans', 'r2/landmarks', 'detector'),
    'half of the messages lost': (
        C, both(without('r1/odom', slice(10, 60, 2)), without('r1/odom', slice(50, 70, 3))), 0,
        'irregular_rate', 'r1/odom', 'recorder'),
    'clock ahead': (
        C, each('r2/odom r2/landmarks r2/ground_truth', lambda e: shifted(e, 3.0)), 1,
        'clock_skew', 'r2', 'chrony'),
    'clock ahead in stamps and log times': (
        C, each('r2/odom r2/landmarks r2/ground_truth', lambda e: shifted(e, 3.0, log=True)), 0,
        'clock_skew', 'r2/odom', 'chrony'),
    'clock half a second behind': (
        R, each('q/odom q/landmarks q/robots', lambda e: shifted(e, -0.5)), 1, 'clock_skew', 'q',
        'chrony'),
    'sensor clock ahead': (
        C, each('r1/landmarks', lambda e: shifted(e, 0.5)), 1, 'clock_skew', 'r1/landmarks',
        'stamp scans'),
    'sensor clock of another epoch': (
        C, each('r1/odom r2/odom r2/landmarks', lambda e: shifted(e, 1e6)), 1, 'clock_skew',
        'r1/landmarks', 'clock of the odometry'),
    'no overlap in time': (
        C, each('r2/odom r2/landmarks r2/ground_truth', lambda e: shifted(e, 100.0, log=True)), 0,
        'no_overlap', 'r2/odom', 'clock'),
    'late': (C, each('r1/odom', delayed(2.0), every=10), 1, 'late', 'r1/odom', 'max_delay'),
    'late scans': (R, each('p/landmarks', delayed(3.0), 8), 1, 'late', 'p/landmarks', 'max_delay'),
    'duplicate': (C, twice('r1/odom', 5), 0, 'duplicate', 'r1/odom', 'once'),
    'duplicate scans': (R, twice('q/landmarks', 5), 0, 'duplicate', 'q/landmarks', 'once'),
    'conflicting': (C, twice('r1/odom', 5, moved(1.0)), 1, 'conflicting', 'r1/odom', 'one node'),
    'time goes back': (C, looped, 1, 'time_jump', 'all robots', 'loop'),
    'stamps out of order': (
        C, out_of_order('r1/landmarks'), 1, 'stamps_go_back', 'r1/landmarks', 'never goes back'),
    'clock set back': (
        C, each('r1/odom', lambda e: shifted(e, -3.0), begin=60), 1, 'stamps_go_back', 'r1/odom',
        'each part'),
    'odometry recorded late': (
        C, recorded_late('r1/odom', slice(40, 60), 4.0), 1, 'stamps_go_back', 'r1/odom', 'sort'),
    'stamps not set': (
        R, each('p/landmarks', lambda e: shifted(e, -e.message.header.stamp.sec
                - e.message.header.stamp.nanosec / NS)), 1, 'unset_stamp', 'p/landmarks',
        'header.stamp'),
    'future': (C, each('r1/odom', lambda e: shifted(e, 3600.0), 9), 1, 'future', 'r1/odom',
               'clock'),
    'frame of scans': (
        C, each('r1/landmarks', framed('camera')), 1, 'wrong_frame', 'r1/landmarks',
        'sensor_frame'),
    'frame of another robot': (
        R, each('p/landmarks', framed('q/base_link')), 1, 'wrong_frame', 'p/landmarks',
        'p/base_link'),
    'odometry of another robot': (
        C, each('r1/odom', framed(child='r2/base_link')), 1, 'wrong_frame', 'r1/odom',
        'r1/base_link'),
    'bare frames': (
        C, each('r1/odom r2/odom', framed('odom', 'base_link')), 0, 'shared_frame', 'r1/odom',
        'begin the frames'),
    'frame of no robot': (
        C, each('r2/odom', framed('banana')), 0, 'wrong_frame', 'r2/odom', 'r2/odom'),
    'no ids': (C, each('r2/landmarks', columns(id=lambda i: -1 + 0 * i)), 1, 'no_identity',
               'r2/landmarks', 'IDs'),
    'no ids of one robot': (
        C, each('r2/landmarks', columns(id=lambda i: -1 + 0 * i)), 1, 'never_joins', 'r2',
        'give its landmarks IDs, as those of r1 have'),
    'bare base frame': (
        C, each('r1/odom', framed(child='base_footprint')), 0, 'wrong_frame', 'r1/odom',
        'set child_frame_id to r1/base_footprint'),
    'no ids, mirrored': (
        C, both(
            each('r1/landmarks r2/landmarks', columns(id=lambda i: -1 + 0 * i)),
            each('r2/landmarks', columns(y=lambda y: -y))), 1, 'never_joins', 'r2',
        'reversed_beams'),
    'id twice': (
        R, each('p/landmarks', columns(
            id=lambda i: np.where(i == i.max(initial=-9), i[:1], i)), 3), 1, 'duplicate_id',
        'p/landmarks', 'own'),
    'negative ids': (C, each('r1/landmarks', columns(id=lambda i: -5 - i), 4), 1, 'bad_id',
                     'r1/landmarks', 'from 0'),
    'floating ids': (C, each('r1/landmarks', floating_ids), 1, 'bad_cloud', 'r1/landmarks',
                     'int32'),
    'raw cloud': (C, each('r1/landmarks', crowded), 1, 'too_large', 'r1/landmarks', '(now 500)'),
    'new id each time': (
        C, (lambda found: [
            columns(id=lambda i, k=k: 1000 * (k + 1) + i)(e) or e
            if e.topic == 'r2/landmarks' else e for k, e in enumerate(found)]), 1,
        'never_seen_again', 'r2/landmarks', 'always the same'),
    'swapped ids': (C, each('r2/landmarks', columns(
        id=lambda i: np.where(np.isin(i, (1, 2)), 3 - i, i)), begin=60), 1, 'contradicted_id',
                    'r2/landmarks', 'swapped'),
    'unknown robot': (R, each('p/robots', columns(id=lambda i: 7 + 0 * i)), 1, 'unknown_robot',
                      'p/robots', '.id'),
    'observation of itself': (
        R, each('p/robots', columns(id=lambda i: 1 + 0 * i)), 1, 'self_sighting', 'p/robots',
        'p.id'),
    'odometry covariance zero': (
        C, each('r1/odom', twist_covariance(np.zeros_like)), 0, 'unknown_covariance', 'r1/odom',
        'odometry_sigma'),
    'observation covariance zero': (
        R, each('p/landmarks', columns(**dict.fromkeys(
            ('var_x', 'cov_xy', 'var_y'), np.zeros_like))), None, 'unknown_covariance',
        'p/landmarks', 'landmark_sigma'),
    'variances without cov_xy': (
        R, each('p/landmarks', without_cov_xy), None, 'unknown_covariance', 'p/landmarks',
        'landmark_sigma'),
    'coarse observations': (
        C, each('r1/landmarks', columns(**dict.fromkeys(
            ('var_x', 'cov_xy', 'var_y'), lambda v: 64 * v))), None, 'coarse_observations',
        'r1/landmarks', 'invariant'),
    'odometry covariance huge': (
        C, each('r2/odom', twist_covariance(at(0, 1e6))), 1, 'absurd_covariance', 'r2/odom',
        'variances'),
    'odometry covariance of a driver that knows none': (
        C, each('r2/odom', twist_covariance(at(35, 1e3))), 1, 'absurd_covariance', 'r2/odom',
        'variances'),
    'odometry covariance that only avoids zero': (
        C, each('r2/odom', twist_covariance(lambda c: 1e-9 * np.eye(6).ravel())), 1,
        'absurd_covariance', 'r2/odom', 'variances'),
    'odometry covariance tiny': (
        C, each('r2/odom', twist_covariance(lambda c: 1e-12 * np.eye(6).ravel())), 1,
        'absurd_covariance', 'r2/odom', 'variances'),
    'odometry covariance of simulators': (
        C, each('r1/odom r2/odom', twist_covariance(lambda c: 1e-5 * np.eye(6).ravel())), 1,
        'optimistic_odometry', 'r2/odom', 'use_odometry_covariance'),
    'odometry covariance with all elements': (
        C, each('r2/odom', twist_covariance(lambda c: np.full(36, 0.1))), 1,
        'singular_covariance', 'r2/odom', 'diagonal'),
    'odometry that cannot move sideways': (
        C, each('r1/odom', twist_covariance(at(7, 0.0))), 0, 'exact_odometry', 'r1/odom',
        'use_odometry_covariance'),
    'odometry covariance not definite': (
        R, each('q/odom', twist_covariance(at(0, -0.1))), 1, 'bad_covariance', 'q/odom', ''),
    'observation covariance tiny': (
        C, each('r1/landmarks', columns(
            var_x=lambda v: 0 * v + 1e-10, var_y=lambda v: 0 * v + 1e-10, cov_xy=np.zeros_like)),
        1, 'absurd_covariance', 'r1/landmarks', 'm^2'),
    'observation covariance huge': (
        R, each('p/landmarks', columns(var_x=lambda v: 0 * v + 1e6)), 1, 'absurd_covariance',
        'p/landmarks', 'm^2'),
    'observation covariance too small by 100': (
        C, each('r1/landmarks r2/landmarks', columns(
            **dict.fromkeys(('var_x', 'cov_xy', 'var_y'), lambda v: 0.01 * v))), 1, None, '',
        'calibrate'),
    'never join': (C, each('r2/landmarks', columns(id=lambda i: i + 1000)), 1, 'never_joins',
                   'r2', 'start_pose'),
    'two landmarks shared': (
        C, both(
            each('r2/landmarks', columns(id=lambda i: i + 1000)),
            # After step 0, which may join robots by two.
            each('r2/landmarks', columns(
                id=lambda i: np.where(np.isin(i, [1001, 1002]), i - 1000, i)), begin=20)), 1,
        'never_joins', 'r2', 'set join_min_landmarks: 2'),
    'never observe each other': (
        R, without('p/robots q/robots'), 1, 'never_joins', 'q', 'start_pose'),
    'blind anchor': (C, without('r1/landmarks'), 1, 'blind_anchor', 'r1', 'anchor'),
    'teleport': (C, each('r1/odom', moved(30.0), begin=60), 1, 'jump', 'r1/odom', 'reset'),
    'small teleport': (R, each('p/odom', moved(1.5), begin=40), 1, 'jump', 'p/odom', 'reset'),
    'bad quaternion': (C, each('r1/odom', turned(), 7), 1, 'bad_quaternion', 'r1/odom', 'w'),
    'tilted': (R, each('p/odom', turned(x=0.7071068, w=0.7071068), 5), 1, 'tilted', 'p/odom', ''),
    'not finite': (C, each('r2/odom', moved(nan), 11), 1, 'not_finite', 'r2/odom', ''),
    'millimetres': (C, each('r1/landmarks', columns(
        x=lambda x: 1e3 * x, y=lambda y: 1e3 * y)),
                    1, 'range', 'r1/landmarks', 'metres'),
    'odometry in millimetres': (C, each('r1/odom', scaled(1e3)), 1, 'speed', 'r1/odom', 'metres'),
    'y to the right': (
        R, each('p/landmarks', columns(y=lambda y: -y)), 1, 'sensor_mirrored', 'p/landmarks',
        'left'),
    'observations in map': (
        R, in_map('p/landmarks'), 1, 'does_not_move', 'p/landmarks', 'not in map'),
    'bearings in degrees': (
        R, each('q/landmarks', in_degrees), 1, 'bearings', 'q/landmarks', 'radians'),
    'exchanged topics': (
        R, exchanged('p/landmarks', 'p/robots'), 1, 'exchanged_topics', 'p/robots',
        '--remap /p/robots:=/p/landmarks /p/landmarks:=/p/robots'),
    'landmarks on the topic of robots': (
        C, exchanged('r1/landmarks', 'r1/robots'), 1, 'exchanged_topics', 'r1/robots',
        '--remap /r1/robots:=/r1/landmarks'),
    'pose in the frame of the odometry': (
        C, with_pose('r2/set_pose', 'r2/odom', np.eye(6)), 1, 'wrong_frame', 'r2/set_pose',
        'map_frame'),
    'pose without variances': (
        C, with_pose('r2/set_pose', 'map', np.zeros((6, 6))), 1, 'bad_covariance', 'r2/set_pose',
        'above zero'),
    'poses of GPS': (
        C, with_poses('r2/set_pose', 'map', np.eye(6), 10), None, 'repeated_poses', 'r2/set_pose',
        'GPS'),
    'pose of RViz for none of several robots': (
        C, with_pose('initialpose', 'map', np.eye(6)), 0, 'not_used', 'initialpose',
        'initialpose_robot'),
    'stands still': (C, each('r1/odom', scaled(0.0)), 1, None, '', ''),
}


#: Changes of the first bag that cost nothing.
HARMLESS = {
    'odometry begins late': without('r1/odom', slice(1)),
    'odometry ends early': without('r2/odom', slice(-2, None)),
    'no truth': without('r1/ground_truth r2/ground_truth ground_truth/landmarks'),
    'one robot': without('r2/odom r2/landmarks r2/ground_truth'),
    'one robot without IDs': both(
        without('r2/odom r2/landmarks r2/ground_truth'),
        each('r1/landmarks', columns(id=lambda i: -1 + 0 * i))),
    'one robot with slow odometry': both(
        without('r2/odom r2/landmarks r2/ground_truth'), kept('r1/odom', 2),
        kept('r1/landmarks', 2)),
    'scans at 1 Hz': both(kept('r1/landmarks', 5), kept('r2/landmarks', 5)),
    'recorded later': each('r1/odom r2/odom r1/landmarks r2/landmarks', delayed(0.05)),
}


@pytest.fixture
def doctor(tmp_path, capsys):
    """Return a function that checks a bag and returns status, findings and output."""
    def run(bag, *options):
        file = tmp_path / 'findings.json'
        status = run_verb('doctor', bag, '--json', file, '--force', *options)
        findings = json.loads(file.read_text()) if file.exists() else None
        return status, findings, capsys.readouterr()

    return run


@pytest.mark.parametrize('with_parameters', [True, False])
@pytest.mark.parametrize('name', [C, R])
def test_a_correct_bag_has_no_findings(doctor, name, with_parameters):
    options = ('--params', BAGS / f'{name}.yaml') if with_parameters else ()

    status, found, printed = doctor(BAGS / name, *options)

    assert (status, found) == (0, [])
    assert '0 errors, 0 warnings' in printed.out


def test_other_counts_in_the_metadata_are_found(doctor, tmp_path):
    path = planted(tmp_path / 'other', entries(C))
    metadata = path / 'metadata.yaml'
    listed = metadata.read_text()
    metadata.write_text(listed.replace('message_count: 127', 'message_count: 128', 1))

    status, (finding,), _ = doctor(path)

    assert (status, finding['name'], finding['where']) == (0, 'message_count', 'r1/odom')
    assert finding['what'] == 'metadata.yaml lists 128 messages, the files have 127'


@pytest.mark.parametrize('storage', ['mcap', slow('sqlite3')])
@pytest.mark.parametrize('change', HARMLESS)
def test_a_harmless_change_has_no_findings(doctor, tmp_path, change, storage):
    path = planted(tmp_path / 'other', HARMLESS[change](entries(C)), storage)

    status, found, _ = doctor(path)

    expected = ['no_checksum'] if storage == 'sqlite3' else []
    assert (status, [finding['name'] for finding in found]) == (0, expected)


def one_of_each_finding(faults):
    """Yield the faults; further ones of a finding are for `make test-all` only."""
    findings = set()
    for fault, (_, _, _, finding, *_) in faults.items():
        yield pytest.param(fault, marks=[pytest.mark.slow] if finding in findings else [])
        findings.add(finding)


def has_finding(found, name, where, cure):
    return any(
        f['name'] == (name or f['name']) and where in f['where'] and cure in f['cure']
        for f in found)


@pytest.mark.parametrize('fault', list(one_of_each_finding(FAULTS)))
def test_a_planted_fault_is_found_with_its_cure(doctor, tmp_path, fault):
    bag, plant, status, *expected = FAULTS[fault]
    path = planted(tmp_path / 'faulty', plant(entries(bag)))

    got, found, _ = doctor(path, '--params', BAGS / f'{bag}.yaml')

    assert status in {None, got}
    assert has_finding(found, *expected)
    assert all(f['cure'] for f in found)


@pytest.mark.parametrize('coarse', [['r1/odom', 'r1/landmarks'], ['r1/odom'], ['r1/landmarks']])
def test_stamps_in_whole_seconds_are_named_and_not_what_they_cause(doctor, tmp_path, coarse):
    plant = each(' '.join(coarse), in_whole_seconds)
    path = planted(tmp_path / 'faulty', plant(entries(C)))

    status, found, _ = doctor(path, '--params', BAGS / f'{C}.yaml')

    assert status == 1
    assert [(f['name'], f['where']) for f in found] == [
        ('coarse_stamps', topic) for topic in coarse]


@pytest.mark.parametrize('fault', [
    'gap', 'never join', *map(slow, (
        'odometry missing', 'clock ahead', 'late', 'duplicate', 'frame of scans',
        'odometry covariance huge', 'teleport', 'negative ids'))])
def test_a_fault_is_found_without_parameters(doctor, tmp_path, fault):
    bag, plant, status, *expected = FAULTS[fault]

    got, found, _ = doctor(planted(tmp_path / 'faulty', plant(entries(bag))))

    assert got == status
    assert has_finding(found, *expected)


def test_an_anchor_that_joins_by_what_others_observe_of_it_is_not_blind(doctor, tmp_path):
    path = planted(tmp_path / 'observed', without('p/landmarks p/robots')(entries(R)))

    _, found, _ = doctor(path, '--params', BAGS / f'{R}.yaml')

    assert {f['name'] for f in found} == {'no_landmarks'}


def test_a_robot_that_is_lost_at_the_end_is_not_said_to_have_never_joined(doctor, tmp_path):
    fault = both(
        each('r2/odom', moved(30.0), begin=-10), without('r2/landmarks', slice(-10, None)))
    path = planted(tmp_path / 'lost', fault(entries(C)))

    _, found, _ = doctor(path, '--params', BAGS / f'{C}.yaml')

    (lost,) = [finding for finding in found if finding['name'] == 'never_joins']
    assert lost['what'].startswith('it leaves map and is outside at the end: ')


@pytest.mark.parametrize(('change', 'cause'), [
    slow(each('r1/odom r2/odom', scaled(100.0)), 'speed'),
    (each('r1/landmarks r2/landmarks', columns(x=lambda x: 100 * x, y=lambda y: 100 * y)),
     'range')])
def test_centimetres_are_not_taken_for_a_wrong_place_of_the_sensor(
        doctor, tmp_path, change, cause):
    path = planted(tmp_path / 'faulty', change(entries(C)))

    _, found, _ = doctor(path, '--params', BAGS / f'{C}.yaml')

    names = {finding['name'] for finding in found}
    assert cause in names
    assert not names & {'sensor_pose', 'does_not_move'}


def test_landmark_ids_that_are_not_shared_are_recognised(doctor, tmp_path):
    params = write_parameters(tmp_path / 'params.yaml', robots=['p', 'q'])

    status, found, printed = doctor(BAGS / R, '--params', params)

    assert (status, [f['name'] for f in found]) == (1, ['wrong_ids'])
    assert 'set the parameter shared_landmark_ids to false' in printed.out


def observing_each_other(tmp_path):
    """Return a bag of two robots that are observed precisely, and the parameters for it."""
    world = write_parameters(
        tmp_path / 'world.yaml', steps_per_loop=200, loops=1, rate=10.0, landmarks=40, seed=3,
        odometry_sigma=[0.01, 0.01, 0.003], landmark_sigma=[0.05, 0.05],
        robot_sigma=[0.05, 0.05])
    run_verb('simulate', '--params', world, '--output', tmp_path / 'bag')
    return tmp_path / 'bag', write_parameters(tmp_path / 'team.yaml', robots=['r1', 'r2'])


def test_observations_of_robots_that_contradict_the_map_are_named_as_such(doctor, tmp_path):
    bag, params = observing_each_other(tmp_path)
    other = both(
        kept('r1/landmarks', 4), each('r1/robots', lambda e: positions(e, lambda z: z + 3.0)))

    _, found, _ = doctor(planted(tmp_path / 'other', other(entries(bag))), '--params', params)

    (finding,) = [f for f in found if f['name'] == 'does_not_fit']
    assert (finding['where'], 'most of them of robots' in finding['what']) == ('r1', True)
    assert '<robot>.id' in finding['cure']


def test_maps_that_agree_are_not_said_to_have_other_ids(doctor, tmp_path):
    # Late stamps turn the maps of robots on circles, which contradicts their robot observations.
    bag, params = observing_each_other(tmp_path)
    late = each('r1/landmarks r2/landmarks', lambda e: shifted(e, 0.4, log=True))

    _, found, _ = doctor(
        planted(tmp_path / 'late', late(entries(bag))), '--params', params)

    assert 'wrong_ids' not in [f['name'] for f in found]


@pytest.mark.parametrize('degrees', [30, 180])
def test_a_camera_that_is_turned_is_named_and_not_what_it_causes(doctor, tmp_path, degrees):
    bag, params = observing_each_other(tmp_path)
    turn = each('r1/landmarks', lambda e: positions(
        e, lambda z: z * np.exp(1j * np.radians(degrees))))

    status, found, _ = doctor(
        planted(tmp_path / 'turned', turn(entries(bag))), '--params', params)

    assert status == 1
    assert [(f['severity'], f['name'], f['where']) for f in found] == [
        ('error', 'sensor_pose', 'r1/landmarks')]


def without_ids(e):
    return columns(id=lambda i: -1 + 0 * i)(e)


@pytest.mark.parametrize(('fault', 'start', 'sigma'), [
    # r2 starts at (0, -18.5, 0): it turns the map with its wrong heading, or is lost and restarts,
    # or its observations may be of several landmarks.
    (without('r2/landmarks', slice(25)), [0.0, -18.5, 0.4], 0.02),
    (without('r2/landmarks', slice(1)), [9.0, 9.0, 2.0], 0.0),
    slow(each('r1/landmarks r2/landmarks', without_ids), [5.0, -12.0, 0.6], 0.5)])
def test_a_wrong_start_pose_is_named(doctor, tmp_path, fault, start, sigma):
    path = planted(tmp_path / 'late', fault(entries(C)))
    params = write_parameters(tmp_path / 'params.yaml', robots=['r1', 'r2'], **{
        'r2.start_pose': start, 'r2.start_sigma': [sigma] * 3})

    status, found, printed = doctor(path, '--params', params)

    assert (status, [f['name'] for f in found]) == (1, ['wrong_start'])
    assert 'start_pose' in printed.out


@pytest.mark.parametrize(('robot', 'parameter', 'start'), [
    ('r1', 'anchor_pose', (0.0, 0.0)), ('r2', 'r2.start_pose', (0.0, -18.5))])
def test_a_bag_that_begins_when_a_robot_has_moved_is_named(
        doctor, tmp_path, robot, parameter, start):
    path = planted(tmp_path / 'late', without(
        f'{robot}/odom {robot}/landmarks', slice(20))(entries(C)))
    *_, first = [e for e in entries(C) if e.topic == f'{robot}/odom'][:21]
    params = write_parameters(tmp_path / 'params.yaml', robots=['r1', 'r2'], **{
        'r2.start_pose': [0.0, -18.5, 0.0], 'r2.start_sigma': [0.02] * 3})

    status, found, _ = doctor(path, '--params', params)

    assert (status, found[0]['name'], found[0]['where']) == (1, 'late_start', robot)
    name, _, pose = found[0]['cure'].rpartition('set ')[2].partition(' to ')
    # Both start with heading 0.
    p, q = first.message.pose.pose.position, first.message.pose.pose.orientation
    assert name == parameter
    assert json.loads(pose) == pytest.approx(
        [start[0] + p.x, start[1] + p.y, 2.0 * np.arctan2(q.z, q.w)], abs=1e-4)


def test_a_robot_that_was_carried_has_restarted(doctor, tmp_path):
    records = [*simulation.parse({'loops': 2, 'landmarks': 40, 'seed': 7}).records()]
    own = [r for r in records if isinstance(r, Odometry) and r.robot == 'r2']
    lifted, landed = own[60], own[80]

    def by_wheels(record):
        if not isinstance(record, Odometry) or record.robot != 'r2':
            return record
        if record.stamp < lifted.stamp:
            return record
        motion = between(landed.pose, record.pose) if record.stamp > landed.stamp else np.zeros(3)
        return replace(record, pose=compose(lifted.pose, motion))

    status, found, _ = doctor(write_bag(tmp_path / 'carried', map(raw_record, map(
        by_wheels, records))))

    assert status == 0
    assert has_finding(found, 'restarted', 'r2', 'start_pose')


def test_motion_beyond_the_limits_of_a_robot_is_named(doctor, tmp_path):
    params = write_parameters(tmp_path / 'params.yaml', robots=['r1', 'r2'], **{
        'r2.max_speed': 0.1})

    status, found, _ = doctor(BAGS / C, '--params', params)

    assert status == 1
    assert has_finding(found, 'impossible_motion', 'r2/odom', 'r2.max_speed')


@pytest.mark.parametrize('covariance', [
    at(0, -1.0), at(5, 1e-3), lambda c: 1e300 * np.eye(6).ravel(), lambda c: 1e-9 * c])
def test_recorded_covariances_that_mean_nothing_can_be_ignored(doctor, tmp_path, covariance):
    bag = planted(tmp_path / 'bag', each('r2/odom', twist_covariance(covariance))(entries(C)))
    status, found, _ = doctor(bag)
    cures = [f['cure'] for f in found if f['where'] == 'r2/odom']
    assert status == 1
    assert cures
    assert all('set r2.use_odometry_covariance to false' in cure for cure in cures)

    params = write_parameters(tmp_path / 'params.yaml', robots=['r1', 'r2'], **{
        'odometry_sigma': [0.15, 0.15, 0.08], 'r2.use_odometry_covariance': False})
    status, found, _ = doctor(bag, '--params', params)

    assert (status, found) == (0, [])


def test_a_robot_that_is_not_in_the_bag_is_reported(doctor, tmp_path):
    params = write_parameters(tmp_path / 'params.yaml', robots=['r1', 'r3'])

    status, found, _ = doctor(BAGS / C, '--params', params)

    assert status == 1
    assert has_finding(found, 'no_odometry', 'r3/odom', 'r3')
    assert has_finding(found, 'unknown_robot', 'r2', 'add r2')


def test_what_is_wrong_in_the_file_is_written_once(doctor, tmp_path, caplog):
    params = write_parameters(
        tmp_path / 'p.yaml', robots=['r1', 'r2'], second_look=True, anchor_pose=[0, 0.0, 0])

    doctor(BAGS / C, '--params', params)

    mixed, old = caplog.messages
    assert mixed.startswith(f"{params}: parameter 'anchor_pose' mixes integers and floats")
    assert old.startswith(f"{params}: parameter 'second_look' is deprecated")


def test_a_bag_of_which_no_observation_is_used_is_an_error(doctor, tmp_path):
    empty = each('r1/landmarks', lambda entry: setattr(entry, 'message', empty_cloud(
        entry.logged // 10**6)))
    of_r1 = [entry for entry in entries(C) if entry.topic in {'r1/odom', 'r1/landmarks'}]

    status, found, _ = doctor(planted(tmp_path / 'empty', empty(of_r1)))

    assert status == 1
    assert [f['name'] for f in found] == ['nothing_used', 'sees_nothing']


def test_a_bag_without_robots_is_reported_in_one_sentence(doctor, tmp_path):
    status, found, printed = doctor(write_bag(tmp_path / 'empty', []))

    assert (status, found) == (1, None)
    assert printed.err.count('\n') == 1


def test_findings_are_not_overwritten_without_force(tmp_path, capsys):
    (tmp_path / 'mine.json').write_text('mine')

    status = run_verb('doctor', BAGS / C, '--json', tmp_path / 'mine.json')

    assert (status, (tmp_path / 'mine.json').read_text()) == (2, 'mine')
    assert '--force' in capsys.readouterr().err


def test_every_rejection_reason_has_a_cure():
    assert set(RejectionReason) == (
        CURES.keys() | REASONS_OF_THE_RUN | {RejectionReason.AFTER_TIME_JUMP})


@pytest.mark.slow
def test_a_robot_on_circles_with_coarse_odometry_has_its_sensor_where_it_is(doctor, tmp_path):
    world = write_parameters(
        tmp_path / 'world.yaml', environment='circles', robots=['r1', 'r2'], loops=3,
        steps_per_loop=250, odometry_sigma=[0.05, 0.05, 0.02], seed=1)
    assert run_verb('simulate', '--params', world, '--output', tmp_path / 'bag') == 0

    _, found, _ = doctor(tmp_path / 'bag')

    assert found == []
