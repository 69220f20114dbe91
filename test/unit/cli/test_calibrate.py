# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`calibrate`: noise scales of bags, the written parameters, and error messages."""

from dataclasses import replace
import math
import shutil

import numpy as np
import pytest

from fej_slam_ros.core.geometry import between, compose, rotation
from fej_slam_ros.core.records import Odometry, Scan, TrueLandmarks, TruePose
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.session import simulation
from helpers.paths import BAGS
from helpers.records import claiming, odometry, scan, with_scaled_noise, without_ids
from helpers.ros import raw_record, run_verb, write_bag, write_parameters
from helpers.slow import slow

#: Covariances of odometry are for half of its noise, those of observations for double.
RECORDS = claiming(
    simulation.parse({'loops': 2, 'rate': 1, 'landmarks': 30, 'seed': 3}).records(),
    {Odometry: 0.5, Scan: 2.0})
#: Long enough for the systematic errors of odometry.
ON_CIRCLES = [*simulation.parse({
    'loops': 13, 'rate': 1, 'landmarks': 30, 'seed': 3,
    'odometry_sigma': [0.02, 0.02, 0.005]}).records()]
WITHOUT_TRUTH = [r for r in RECORDS if not isinstance(r, (TruePose, TrueLandmarks))]


@pytest.fixture
def calibrate(places, capsys):
    """Return a function that calibrates by records and returns status, output and errors."""
    bag, params, output = places

    def run(records, *options):
        if records is not None:
            write_bag(bag, [raw_record(record) for record in records])
        status = run_verb('calibrate', bag, '--params', params, '--output', output, *options)
        return status, *capsys.readouterr()

    return run


def row(printed, *begin):
    """Return the other cells of the table row that begins with some cells."""
    rows = (line.split() for line in printed.splitlines())
    return next(cells[len(begin):] for cells in rows if cells[:len(begin)] == [*begin])


def scales(path):
    settings = parameters.load(path).estimation
    return settings.odometry_noise_scale, settings.landmark_noise_scale


@pytest.mark.parametrize(('records', 'options', 'source'), [
    (RECORDS, (), 'truth'), (RECORDS, ('--from', 'innovations'), 'innovations'),
    (WITHOUT_TRUTH, (), 'innovations')])
def test_factors_are_those_of_the_simulation(calibrate, places, records, options, source):
    status, printed, error = calibrate(records, *options)

    assert (status, error) == (0, '')
    for kind, scale, true in zip(('odometry', 'landmark'), scales(places[2]), (2.0, 0.5)):
        factor, standard_error, _, *rest = row(printed, kind, 'all')
        assert (rest[0], rest[-1]) == (source, 'yes')
        assert float(factor) == pytest.approx(scale, abs=1e-3)
        assert abs(math.log(scale / true)) < 4.0 * float(standard_error) / float(factor)


@pytest.mark.slow
def test_factors_are_found_from_landmarks_without_ids(calibrate):
    simulated = simulation.parse({
        'loops': 2, 'rate': 1, 'landmarks': 30, 'seed': 3, 'landmark_sigma': [0.03, 0.03]})
    records = without_ids(claiming(simulated.records(), {Odometry: 0.5, Scan: 2.0}))

    status, printed, error = calibrate(records, '--from', 'innovations')

    assert (status, error) == (0, '')
    assert 'observations without ID matched landmarks' in printed
    for kind, true in zip(('odometry', 'landmark'), (2.0, 0.5)):
        factor, standard_error, *_ = map(float, row(printed, kind, 'all')[:3])
        # Matches have a gate, which cuts the root mean square of two normal errors by 2.3 %.
        assert abs(math.log(factor / true)) < 4.0 * standard_error / factor + 0.023
    for robot in ('r1', 'r2'):
        _, nis, *_ = row(printed, robot)
        # The factor of odometry is known to 8 %, its square and with it NIS to at most 16 %.
        assert abs(float(nis) - 1.0) < 2 * 0.16


@pytest.mark.slow
def test_observations_without_ids_are_matched_again_with_the_noise_that_was_found(
    calibrate, places,
):
    """With the stated noise, most of them miss their landmarks."""
    simulated = simulation.parse({
        'loops': 1, 'rate': 1, 'landmarks': 30, 'seed': 3, 'landmark_sigma': [0.03, 0.03]})
    records = without_ids(claiming(simulated.records(), {Odometry: 0.4, Scan: 0.5}))

    calibrate(records, '--from', 'innovations')

    # The first matches give 1.4, and no factor of observations.
    assert scales(places[2]) == pytest.approx((2.5, 2.0), rel=0.25)


def test_the_filter_is_consistent_after_calibration(calibrate):
    _, printed, _ = calibrate(RECORDS)

    for robot in ('r1', 'r2'):
        nis_before, nis_after, nees_before, nees_after, *_ = map(float, row(printed, robot))
        # NIS of 1100 observations is known to 3 %, the factors to 3 and 8 %; NEES of one run has
        # some ten independent samples.
        assert abs(nis_after - 1.0) < 0.15 < abs(nis_before - 1.0)
        assert 0.3 < nees_after < 2.5
        assert abs(math.log(nees_after)) < abs(math.log(nees_before))


@pytest.mark.slow
@pytest.mark.parametrize(('options', 'warns'), [
    ((), False), (('--from', 'innovations'), False),
    (('--from', 'innovations', '--seconds', '10'), True)])
def test_factors_that_cover_no_errors_that_persist_are_reported(calibrate, options, warns):
    _, printed, _ = calibrate(RECORDS, *options)

    sentence = (
        'odometry_noise_scale, landmark_noise_scale from innovations cover no errors that persist')
    assert (sentence in printed) == warns


@pytest.mark.parametrize('stated', [0.5, 0.1])
def test_a_factor_that_noise_seldom_has_is_written_with_a_warning(calibrate, places, stated):
    _, printed, _ = calibrate(claiming(RECORDS, {Odometry: 2.0 * stated}))

    assert scales(places[2])[0] == pytest.approx(1.0 / stated, rel=0.2)
    assert ('odometry_noise_scale' in printed and 'is written, but' in printed) == (stated < 0.2)


def test_the_warning_has_the_factor_that_is_written_within_its_limits(calibrate, places):
    # The standard deviations of odometry are 5,000 times too large.
    _, printed, _ = calibrate(claiming(RECORDS, {Odometry: 1e4}))

    assert scales(places[2])[0] == 0.001
    assert 'odometry_noise_scale 0.001 is written, but' in printed


@pytest.mark.slow
def test_without_ground_truth_a_robot_with_other_noise_has_its_own_scale(calibrate, places):
    records = [
        with_scaled_noise(0.2, r) if isinstance(r, Odometry) and r.robot == 'r2' else r
        for r in simulation.parse(
            {'loops': 3, 'rate': 1, 'landmarks': 30, 'seed': 3}).records()]

    _, printed, _ = calibrate(records, '--from', 'innovations', '--seconds', '400')

    # Of two robots that differ, the first one has its own scale.
    for robot, name, true in zip(
            parameters.load(places[2]).estimation.robots, ('r1', 'all'), (1.0, 5.0)):
        factor, standard_error, *_ = map(float, row(printed, 'odometry', name)[:3])
        assert robot.odometry_noise_scale == pytest.approx(factor, abs=1e-3)
        assert abs(math.log(factor / true)) < 4.0 * standard_error / factor
    assert 'times that of' not in printed


@pytest.mark.parametrize('robot', ['r1', 'r2'])
def test_ground_truth_that_shows_more_noise_of_every_kind_is_called_wrong(calibrate, robot):
    rng = np.random.default_rng(1)
    # More than the noise of an observation, and than that of odometry over 5 s.
    wrong = [
        replace(record, pose=record.pose + rng.normal(0.0, [0.6, 0.6, 0.1]))
        if isinstance(record, TruePose) and record.robot == robot else record
        for record in RECORDS]

    _, printed, _ = calibrate(wrong, '--from', 'truth')

    named = [line for line in printed.splitlines() if 'ground truth of' in line]
    assert [line.split()[0] for line in named] == [robot]


def test_messages_that_were_recorded_twice_count_once(calibrate, places):
    calibrate(RECORDS)
    once = places[2].read_text()
    shutil.rmtree(places[0])

    status, *_ = calibrate([record for record in RECORDS for _ in range(2)], '--force')

    assert status == 0
    assert places[2].read_text() == once


def with_odometry_errors(records, scale):
    """Return records with odometry of which distances and turns are to be scaled."""
    begins, integrated = {}, {}

    def with_errors(record):
        if not isinstance(record, Odometry):
            return record
        x, y, phi = between(begins.get(record.robot, record.pose), record.pose)
        begins[record.robot] = record.pose
        integrated[record.robot] = compose(
            integrated.get(record.robot, record.pose),
            np.array([x / scale[0], y / scale[0], phi / scale[1]]))
        return replace(record, pose=integrated[record.robot])

    return [*map(with_errors, records)]


@pytest.mark.parametrize(('options', 'source'), [
    (('--from', 'truth'), 'truth'),
    slow(('--from', 'innovations', '--seconds', '20'), 'landmarks')])
def test_systematic_errors_of_odometry_are_corrected(calibrate, places, options, source):

    _, printed, _ = calibrate(with_odometry_errors(ON_CIRCLES, (0.94, 1.05)), *options)

    settings = parameters.load(places[2]).estimation
    for robot in settings.robots:
        assert row(printed[printed.index('distance'):], robot.name)[-1] == source
        # Four standard errors of the turns.
        assert robot.odometry_scale == pytest.approx((0.94, 1.05), abs=0.02)
        assert robot.odometry_turn_bias == pytest.approx(0.0, abs=0.001)
    # Without the errors, the noise is that of the simulation.
    assert settings.odometry_noise_scale == pytest.approx(1.0, abs=0.25)


@pytest.mark.slow
def test_earlier_errors_of_odometry_are_replaced_by_those_found(calibrate, places):
    write_parameters(
        places[1], **{'robots': ['r1', 'r2'], 'r1.odometry_scale': [0.97, 1.02],
                      'r2.odometry_turn_bias': 0.01})

    calibrate(ON_CIRCLES, '--from', 'truth')

    r1, r2 = parameters.load(places[2]).estimation.robots
    assert r1.odometry_scale == (1.0, 1.0)
    # On circles, a bias is not distinguished from a scale.
    assert r2.odometry_turn_bias == 0.01


def test_ranges_are_corrected_by_ground_truth_and_bearings_not_on_circles(calibrate, places):
    """On circles, true headings that are off look like a point beside the origin."""
    def wrong(record):
        if not isinstance(record, Scan) or record.robot != 'r1':
            return record
        # Ranges 4 % too short, bearings 0.03 rad too large.
        return replace(record, observations=tuple(
            replace(o, z=0.96 * rotation(0.03) @ o.z) for o in record.observations))

    _, printed, _ = calibrate([*map(wrong, RECORDS)])

    r1, r2 = parameters.load(places[2]).estimation.robots
    scale, scale_error, bias, _, _, source = row(printed[printed.index('observations of'):], 'r1')
    assert (bias, source) == ('-', 'truth')
    # With the digits that are printed and written.
    assert float(scale) == pytest.approx(1.0 / 0.96, abs=4.0 * float(scale_error))
    assert r1.observation_range_scale == pytest.approx(float(scale), abs=1e-3)
    assert r2.observation_range_scale == 1.0
    assert r1.observation_bearing_bias == r2.observation_bearing_bias == 0.0


def with_growing_noise(growth):
    """Return a long run with observations whose standard deviations grow with the range."""
    rng = np.random.default_rng(7)
    precise = simulation.parse({
        'loops': 13, 'rate': 1, 'landmarks': 30, 'seed': 3, 'landmark_sigma': [0.05, 0.05],
        'odometry_sigma': [0.02, 0.02, 0.005]}).records()

    def noisier(o):
        factor = (1.0 + growth * np.hypot(*o.z)) ** 2 - 1.0
        return replace(o, z=o.z + rng.multivariate_normal(np.zeros(2), factor * o.R))

    return [
        replace(record, observations=tuple(map(noisier, record.observations)))
        if isinstance(record, Scan) else record for record in precise]


@pytest.mark.parametrize('source', ['truth', slow('innovations')])
@pytest.mark.parametrize('growth', [slow(0.0), 0.5])
def test_noise_that_grows_with_the_range_is_found(calibrate, places, growth, source):
    _, printed, _ = calibrate(with_growing_noise(growth), '--from', source)

    settings = parameters.load(places[2]).estimation
    found = settings.robots[0].observation_noise_growth
    assert ('grows with the range' in printed) == (found > 0.0) == (growth > 0.0)
    # From 3 to 14 m, where most landmarks are; by innovations of two minutes less well.
    for at in (3.0, 14.0):
        assert settings.landmark_noise_scale * (1.0 + found * at) == pytest.approx(
            1.0 + growth * at, rel=0.15 if source == 'truth' else 0.3)


@pytest.mark.slow
@pytest.mark.parametrize('is_sensor', [True, False])
def test_without_ground_truth_a_shared_map_tells_wrong_ranges_from_wrong_distances(
    calibrate, places, is_sensor,
):
    """In either case, the distances of r1 by odometry are 5 % longer than those by its ranges."""
    def wrong(record):
        if not isinstance(record, Scan) or record.robot != 'r1':
            return record
        return replace(record, observations=tuple(
            replace(o, z=o.z / 1.05) for o in record.observations))

    write_parameters(
        places[1], robots=['r1', 'r2'], **{'r1.observation_bearing_bias': 0.02})
    own = [r for r in ON_CIRCLES if isinstance(r, Odometry) and r.robot == 'r1']
    others = [r for r in ON_CIRCLES if not (isinstance(r, Odometry) and r.robot == 'r1')]
    records = [*map(wrong, ON_CIRCLES)] if is_sensor else [
        *with_odometry_errors(own, (1.0 / 1.05, 1.0)), *others]

    calibrate(sorted(records, key=lambda r: r.stamp), '--from', 'innovations', '--seconds', '100')

    r1, r2 = parameters.load(places[2]).estimation.robots
    ranges, distance = (1.05, 1.0) if is_sensor else (1.0, 1.0 / 1.05)
    # Four standard errors of the distances of r1.
    assert r1.observation_range_scale == pytest.approx(ranges, abs=0.015)
    assert r1.odometry_scale[0] == pytest.approx(distance, abs=0.015)
    assert (r2.observation_range_scale, r2.odometry_scale[0]) == (1.0, 1.0)
    # Bearings are right by the direction of travel.
    assert r1.observation_bearing_bias == 0.0


@pytest.mark.slow
def test_without_ground_truth_the_direction_of_travel_shows_a_bearing_bias(calibrate, places):
    def turned(record):
        if not isinstance(record, Scan) or record.robot != 'r1':
            return record
        return replace(record, observations=tuple(
            replace(o, z=rotation(0.06) @ o.z) for o in record.observations))

    _, printed, _ = calibrate(
        [*map(turned, ON_CIRCLES)], '--from', 'innovations', '--seconds', '20')

    r1, r2 = parameters.load(places[2]).estimation.robots
    *_, bias, sigma, _, source = row(printed[printed.index('observations of'):], 'r1')
    assert source == 'landmarks'
    assert float(bias) == pytest.approx(0.06, abs=4.0 * float(sigma))
    assert r1.observation_bearing_bias == pytest.approx(float(bias), abs=1e-4)
    assert r2.observation_bearing_bias == 0.0


def test_other_parameters_are_kept_and_used(calibrate, places):
    given = {
        'robots': ['r1', 'r2'], 'use_sim_time': True, 'landmark_noise_scale': 7.0,
        'r1.landmark_noise_scale': 9.0, 'robot_noise_scale': 3.0, 'r2.odometry_sigma': [1.0] * 3}
    write_parameters(places[1], **given)

    status, *_ = calibrate(RECORDS)

    assert status == 0
    written = parameters.load_values(places[2], ['estimator'])
    kept = given.keys() - {'landmark_noise_scale', 'r1.landmark_noise_scale'}
    assert {name: written[name] for name in kept} == {name: given[name] for name in kept}
    assert written['landmark_noise_scale'] == pytest.approx(0.5, rel=0.1)
    assert written.get('r1.landmark_noise_scale', 0.5) == pytest.approx(0.5, rel=0.1)


def test_what_is_wrong_in_the_file_is_written_once(calibrate, places, caplog):
    write_parameters(places[1], robots=['r1', 'r2'], max_delai=0.2)

    status, *_ = calibrate(RECORDS)

    assert status == 0
    assert caplog.messages == [
        f"{places[1]}: unknown parameter 'max_delai' is ignored: did you mean 'max_delay'?"]


def test_an_old_name_in_the_file_is_written_as_the_present_one(calibrate, places):
    write_parameters(places[1], robots=['r1', 'r2'], second_look=True)

    status, *_ = calibrate(RECORDS)

    assert status == 0
    written = places[2].read_text()
    assert 'inflate_rejected_scans: true' in written
    assert 'second_look' not in written


def test_a_calibration_that_is_right_already_is_repeated_without_change(calibrate, places):
    _, params, output = places
    assert calibrate(RECORDS)[0] == 0
    params.write_text(first := output.read_text())

    status, printed, _ = calibrate(None, '--force')

    assert status == 0
    assert 'yes' in printed
    assert output.read_text() == first


def test_too_little_data_is_reported(calibrate, places):
    begin = [r for r in RECORDS if isinstance(r, TrueLandmarks) or r.stamp < 13 * 10**9]

    status, printed, _ = calibrate(begin, '--from', 'truth')

    assert status == 0
    assert 'too little data to know odometry_noise_scale to 15 %: it is unchanged' in printed
    assert scales(places[2])[0] == 1.0
    assert scales(places[2])[1] == pytest.approx(0.5, rel=0.3)


@pytest.mark.parametrize(('records', 'options', 'sentence'), [
    (WITHOUT_TRUTH, ('--from', 'truth'), 'has no ground truth'),
    ([r for r in WITHOUT_TRUTH if isinstance(r, Odometry)], (), 'has no usable observations'),
    ([scan('r1', 0, [(1, (1.0, 0.0))])], (), 'none of the topics r1/odom, r2/odom'),
    ([odometry('r1', 0), odometry('r1', 100), scan('r1', 100, [(1, (1.0, 0.0))])], (),
     'has too little data to calibrate any noise'),
])
def test_a_bag_without_usable_data_is_reported(calibrate, places, records, options, sentence):
    status, _, error = calibrate(records, *options)

    assert status == 1
    assert sentence in error
    assert error.count('\n') == 1
    assert not places[2].exists()


def test_a_missing_bag_is_reported_in_one_sentence(calibrate):
    status, _, error = calibrate(None)

    assert status == 1
    assert error.startswith('calibrate: ')
    assert error.count('\n') == 1


def test_parameters_are_not_overwritten_without_force(calibrate, places):
    places[2].write_text('mine')

    status, _, error = calibrate(RECORDS)

    assert (status, places[2].read_text()) == (2, 'mine')
    assert '--force' in error
    assert calibrate(None, '--force')[0] == 0
    assert scales(places[2])[0] == pytest.approx(2.0, rel=0.3)


@pytest.mark.parametrize('options', [('--seconds', '0'), ('--from', 'nowhere')])
def test_a_bad_argument_is_a_usage_error(calibrate, options):
    assert calibrate(RECORDS, *options)[0] == 2


def test_factors_of_the_shipped_bag_are_1(places, capsys):
    bags = BAGS

    run_verb(
        'calibrate', bags / 'two_circles', '--params', bags / 'two_circles.yaml', '--output',
        places[2])

    printed = capsys.readouterr().out
    for kind in ('odometry', 'landmark'):
        factor, standard_error, *_ = row(printed, kind, 'all')
        assert abs(float(factor) - 1.0) < 4.0 * float(standard_error)
