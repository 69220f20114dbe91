# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A filter that works in a region has the estimate of one that works on everything."""

from copy import copy
import math

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core import frame_groups, pieces
from fej_slam_ros.core.ekf import (
    compressed_covariance, first_estimates, joint_covariance, joint_update, matrix_product)
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, WHOLE_MAP
from fej_slam_ros.core.ekf.compressed_covariance import CompressedCovariance, LEAVING_RATE
from fej_slam_ros.core.ekf.covariance import Covariance, SparseRows
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.joint_covariance import lower_rows
from fej_slam_ros.core.ekf.linearization import (
    FirstEstimates, Invariant, RenewedFirstEstimates, Standard)
from fej_slam_ros.core.ekf.outside_points import OutsidePoints
from fej_slam_ros.core.ekf.state import JointState, state_of_prior_map
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import Motion, NO_ID, NS, Observation, Odometry, PriorMap, Scan
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.core.snapshot import restore, snapshot
from helpers.core import frames, random_covariance
from helpers.slow import slow

Q, R = np.diag([0.05, 0.05, 0.01]) ** 2, np.diag([0.1, 0.1]) ** 2

#: A robot, and twenty landmarks of which it is near the first five.
SIZES = (3, *[2] * 20)
REGION = np.arange(13)


def whole_and_region(rng, known=()):
    """
    Return a covariance of everything, the same in a region, and the slots of both.

    Some states may be known exactly.

    """
    P = random_covariance(rng, sum(SIZES))
    P[[*known]] = P[:, [*known]] = 0.0
    covariances = []
    for _ in range(2):
        covariance = Covariance()
        slots = covariance.insert(P).split(SIZES)
        covariances.append(covariance)
    return covariances[0], CompressedCovariance(covariances[1], REGION, OutsidePoints()), slots


def happen(covariance, slots, rng):
    """Move a robot, start a landmark and observe it with others; return the corrections."""
    robot, joint = slots[0], [*slots]
    x = np.zeros(covariance.dimension + 2)
    for k in range(4):
        Phi = np.eye(3) + rng.normal(0.0, 0.1, (3, 3))
        covariance.propagate(robot, Phi, random_covariance(rng, 3))
        if k == 1:
            F, N = rng.normal(size=(2, 3)), random_covariance(rng, 2)
            joint.append(covariance.augment(robot, F, N))
        observed = [joint[1 + k], joint[5], joint[-1] if k else joint[2]]
        columns = np.array([[*robot.indices, *slot.indices] for slot in observed])
        H = SparseRows(columns, rng.normal(size=(3, 2, 5)))
        noise = np.array([random_covariance(rng, 2) for _ in observed])
        correction = covariance.correction(covariance.project(H, noise), rng.normal(size=6))
        covariance.condition(correction)
        x[:len(correction.dx)] += correction.dx
    return joint, x


@pytest.mark.parametrize('known', [(), (3, 4, 9), REGION])
def test_a_submap_gives_the_same_covariance_as_the_whole_state(known):
    whole, region, slots = whole_and_region(np.random.default_rng(1), known)

    joint, dx = happen(whole, slots, np.random.default_rng(2))
    also, dx_region = happen(region, slots, np.random.default_rng(2))

    expected, everything = whole.marginal(joint), np.arange(len(dx))
    assert [slot.start for slot in also] == [slot.start for slot in joint]
    # Sums of some hundred products of numbers of the order of 1.
    assert_allclose(region.marginal(also), expected, atol=1e-12)
    assert_allclose(region.current_estimates(dx_region, everything), dx, atol=1e-12)
    left, x = region.leave(dx_region)
    assert_allclose(left.marginal(joint), expected, atol=1e-12)
    assert_allclose(x, dx, atol=1e-12)


@pytest.mark.parametrize('known', [(), (3, 4, 35, 36)])
def test_states_that_enter_a_submap_give_the_same_covariance_as_the_whole_state(known):
    whole, region, slots = whole_and_region(np.random.default_rng(1), known)
    joint, dx = happen(whole, slots, np.random.default_rng(2))
    _, x = happen(region, slots, np.random.default_rng(2))
    entering = [slots[17], slots[9]]

    x = region.with_states(np.array([[*slot.indices] for slot in entering]), x)
    again = [slots[0], *entering, *slots[3:6]]
    after = x.copy()
    for covariance, x_hat in ((whole, dx), (region, after)):
        _, more = happen(covariance, again, np.random.default_rng(3))
        np.add(x_hat, more[:len(x_hat)], out=x_hat)

    inside = np.concatenate([slot.indices for slot in (slots[0], *entering)])
    assert_allclose(after[inside], dx[inside], atol=1e-12)
    expected = whole.marginal(joint)
    assert_allclose(region.marginal(joint), expected, atol=1e-12)
    left, x = region.leave(np.append(after, [0.0, 0.0]))
    assert_allclose(left.marginal(joint), expected, atol=1e-12)
    assert_allclose(x[:len(dx)], dx, atol=1e-12)


def test_an_update_of_a_copy_of_a_submap_changes_nothing_in_the_submap():
    rng = np.random.default_rng(1)
    _, region, slots = whole_and_region(rng)
    joint, dx = happen(region, slots, rng)
    every = np.arange(len(dx))

    def known():
        return [region.marginal(joint), region.current_estimates(dx, every)]

    before, copied = known(), copy(region)
    H = SparseRows(np.array([[*slots[0].indices, *slots[1].indices]]), rng.normal(size=(1, 2, 5)))
    copied.propagate(slots[0], 2.0 * np.eye(3), Q)
    copied.condition(copied.correction(copied.project(H, R[None]), np.ones(2)))

    for one, other in zip(known(), before):
        assert_array_equal(one, other)


def test_leaving_a_submap_that_ends_early_changes_nothing(monkeypatch):
    _, region, slots = whole_and_region(np.random.default_rng(1))
    joint, dx = happen(region, slots, np.random.default_rng(2))
    before = region.marginal(joint)
    monkeypatch.setattr(matrix_product, 'PIECE_FLOPS', 1.0)

    with pieces.between_pieces(lambda: None, lambda: True), pytest.raises(pieces.EndedError):
        region.leave(dx, may_end=True)

    assert_array_equal(region.marginal(joint), before)
    # What must not end early goes on.
    with pieces.between_pieces(lambda: None, lambda: True):
        assert_allclose(region.leave(dx)[0].marginal(joint), before, atol=1e-12)


@pytest.mark.parametrize('direct', [compressed_covariance.MAX_DIRECT, 0])
def test_covariance_blocks_are_equal_inside_and_across_a_submap(monkeypatch, direct):
    monkeypatch.setattr(compressed_covariance, 'MAX_DIRECT', direct)
    whole, region, slots = whole_and_region(np.random.default_rng(3))
    joint, _ = happen(whole, slots, np.random.default_rng(4))
    happen(region, slots, np.random.default_rng(4))

    few = [joint[9], joint[0], joint[-1], joint[15]]
    pairs = np.array([[0, 1, 2, 4, 5], [0, 1, 2, 31, 32], [20, 21, 33, 34, 43]])
    assert_allclose(region.marginal(few), whole.marginal(few), atol=1e-12)
    P = region.marginal([*few, *joint])
    assert_allclose(P, whole.marginal([*few, *joint]), atol=1e-12)
    assert_array_equal(P, P.T)
    assert_allclose(region.blocks(pairs), whole.blocks(pairs), atol=1e-12)


def test_variance_bounds_are_exact_inside_a_submap_and_too_large_outside():
    whole, region, slots = whole_and_region(np.random.default_rng(3))
    joint, _ = happen(whole, slots, np.random.default_rng(4))
    happen(region, slots, np.random.default_rng(4))
    points = np.array([slot.indices for slot in joint[1:]])
    variances = np.trace(whole.blocks(points), axis1=1, axis2=2)

    assert_allclose(whole.variance_bounds(points), variances, atol=1e-12)
    bounds = region.variance_bounds(points)

    inside = [0, 1, 2, 3, 4, -1]
    assert_allclose(bounds[inside], variances[inside], atol=1e-12)
    assert (np.delete(bounds, inside) > np.delete(variances, inside)).all()


def town(landmarks, steps, seed):
    """Return landmarks, and what two robots measure that drive about and see the next five."""
    rng = np.random.default_rng(seed)
    side = np.sqrt(20.0 * landmarks)
    points = rng.uniform(0.0, side, (landmarks, 2))
    poses = {'r1': np.array([0.4 * side, 0.5 * side, 0.0]), 'r2': np.full(3, 0.6 * side)}
    start, happened = dict(poses), []
    for k in range(1, steps + 1):
        motions, scans = [], []
        for name, before in poses.items():
            middle = between(before, np.array([side / 2.0, side / 2.0, 0.0]))
            far = np.hypot(*middle[:2]) > 0.4 * side
            u = np.array([0.5, 0.0, 0.3 * np.sign(middle[1]) if far else rng.normal(0.0, 0.1)])
            poses[name] = pose = compose(before, u)
            motions.append(Motion(name, k, u + rng.multivariate_normal(np.zeros(3), Q), Q))
            near = np.argsort(np.hypot(*(points - pose[:2]).T))[:5]
            z = h(np.tile(pose, (5, 1)), points[near]) + rng.normal(0.0, 0.1, (5, 2))
            scans.append(Scan(name, k, tuple(
                Observation(int(i), z_i, R) for i, z_i in zip(near, z))))
        happened.append((motions, scans))
    return start, happened


def run(town, regions, linearization, sigma=(0.1, 0.1, 0.01)):
    """
    Return a filter at the end of what happened, and how often it entered a region.

    `sigma` are the standard deviations of the start poses.

    """
    start, happened = town
    filter_ = Filter(
        JointState(), linearization, Gate(0.999), iterations=linearization.default_iterations,
        submap=regions)
    for name, pose in start.items():
        filter_.state.insert_robot(name, 0, pose, np.diag(sigma) ** 2)
    entered, last = 0, None
    for motions, scans in happened:
        filter_.step(motions, scans)
        covariance = filter_.state.covariance
        entered += isinstance(covariance, CompressedCovariance) and covariance is not last
        last = covariance
    return filter_, entered


@pytest.mark.parametrize('linearization', [FirstEstimates, Standard, Invariant])
def test_a_filter_with_submaps_equals_the_full_filter_over_two_thousand_steps(linearization):
    scenario = town(landmarks=250, steps=2000, seed=1)

    whole, _ = run(scenario, WHOLE_MAP, linearization())
    compressed, entered = run(scenario, ActiveSubmap(200, 15), linearization())

    assert entered > 20
    assert len(whole.state.landmarks) > 150
    variables = whole.state.variables()
    assert_allclose(compressed.state.estimates(), whole.state.x_hat, atol=1e-10)
    assert_array_equal(compressed.state.x_first.shape, whole.state.x_first.shape)
    assert_allclose(
        compressed.state.marginal(variables), whole.state.marginal(variables), atol=1e-10)


@pytest.mark.parametrize('linearization', [FirstEstimates, Invariant])
def test_updates_in_blocks_give_the_same_with_submaps_as_with_the_whole_state(
    monkeypatch, linearization,
):
    scenario = town(landmarks=250, steps=300, seed=1)
    whole, _ = run(scenario, WHOLE_MAP, linearization())
    for name, count in (('MAX_JOINT', 0), ('MAX_BLOCK', 4), ('MIN_BLOCK', 4)):
        monkeypatch.setattr(joint_update, f'{name}_OBSERVATIONS', count)

    compressed, entered = run(scenario, ActiveSubmap(100, 10), linearization())

    assert entered
    variables = whole.state.variables()
    assert_allclose(compressed.state.estimates(), whole.state.x_hat, atol=1e-10)
    assert_allclose(
        compressed.state.marginal(variables), whole.state.marginal(variables), atol=1e-10)


def test_first_estimates_are_renewed_in_submaps_as_in_the_whole_state(monkeypatch):
    # Here no heading is corrected by 0.1 rad, and no landmark moves by a fifth of a distance.
    monkeypatch.setattr(RenewedFirstEstimates, 'max_correction', 0.004)
    monkeypatch.setattr(first_estimates, 'MAX_DISPLACED', 0.004)
    scenario = town(landmarks=250, steps=300, seed=1)
    kept, _ = run(scenario, WHOLE_MAP, FirstEstimates())

    whole, _ = run(scenario, WHOLE_MAP, RenewedFirstEstimates())
    compressed, entered = run(scenario, ActiveSubmap(100, 10), RenewedFirstEstimates())

    # A renewal leaves the submap.
    assert entered > run(scenario, ActiveSubmap(100, 10), FirstEstimates())[1]
    renewed = np.abs(whole.state.x_first - kept.state.x_first) > 1e-3
    assert np.count_nonzero(renewed) > 20
    assert_allclose(compressed.state.x_first, whole.state.x_first, atol=1e-10)
    assert_allclose(compressed.state.estimates(), whole.state.x_hat, atol=1e-10)
    assert_allclose(*(
        f.state.marginal(whole.state.variables()) for f in (compressed, whole)), atol=1e-10)


def row_of_landmarks(submap, names=('r1',)):
    """Return an invariant filter whose robots have each seen a part of a row, and the row."""
    filter_ = Filter(JointState(), Invariant(), Gate(1.0), submap=submap)
    points = np.array([[0.5 + 0.2 * k, 0.1 * (k % 3)] for k in range(60)])
    for name in names:
        filter_.state.insert_robot(name, 0, np.zeros(3), np.diag([0.1, 0.1, 0.05]) ** 2)
    for number, part in enumerate(np.array_split(np.arange(60), 3)):
        name = names[number % len(names)]
        filter_.step([Motion(name, 0, np.zeros(3), np.diag([0.3, 0.3, 0.2]) ** 2)], [
            Scan(name, 0, tuple(Observation(int(k), points[k], R) for k in part))])
    filter_.step([], [Scan(names[0], 0, (Observation(0, points[0], R),))])
    return filter_, points


@pytest.mark.parametrize('turn', [1.0, 3.0, 3.6, 6.0])
def test_points_outside_turn_as_those_inside_by_corrections_of_more_than_half_a_turn(turn):
    results = []
    for submap in (WHOLE_MAP, ActiveSubmap(100, 5)):
        filter_, points = row_of_landmarks(submap)
        state = filter_.state
        filter_.predict(Motion('r1', 1, np.zeros(3), np.diag([1e-4, 1e-4, 1.0])))
        z = h(state.pose(state.robots['r1'])[None], points[:1])[0]
        # By one iteration, an observation 0.5 m away corrects the heading by about the turn.
        filter_.step([], [Scan('r1', 1, (Observation(0, z - np.array([0.0, 0.5 * turn]), R),))])
        results.append([state.estimates(), state.marginal(state.variables())])
    assert isinstance(state.covariance, CompressedCovariance)

    for whole, compressed in zip(*results):
        assert_allclose(compressed, whole, atol=1e-12)


def test_points_whose_owners_have_left_share_one_copy_of_a_heading():
    filter_, points = row_of_landmarks(ActiveSubmap(100, 3), ('r1', 'r2', 'r3'))
    state = filter_.state
    state.remove_all([state.robots['r2'], state.robots['r3']])
    before = state.covariance.matrices[-1].dimension

    filter_.step([], [Scan('r1', 1, (Observation(0, points[0], R),))])

    assert isinstance(state.covariance, CompressedCovariance)
    assert state.covariance.matrices[-1].dimension == before + 1


def test_variance_bounds_hold_outside_a_submap_where_turning_lets_variances_grow():
    filter_, _ = run(town(250, 300, seed=1), ActiveSubmap(100, 10), Invariant())
    state = filter_.state
    positions = state.landmark_positions()
    before = np.trace(state.covariance.blocks(positions), axis1=1, axis2=2)
    # An observation that is wrong and vague by as much corrects a lot and teaches little.
    (key, landmark), *_ = state.landmarks.items()
    filter_.gate = Gate(1.0)
    filter_.submap.ensure_contains(state, landmark.slot.indices, turns_points=True)
    filter_.step([], [Scan('r1', 300, (Observation(key[1], np.full(2, 1e5), 1e5 * R),))])

    assert isinstance(state.covariance, CompressedCovariance)
    traces = np.trace(state.covariance.blocks(positions), axis1=1, axis2=2)
    assert (traces - before).max() > 1e-3
    bounds = state.covariance.variance_bounds(positions)
    assert (bounds >= traces * (1.0 - 1e-12)).all()


@pytest.mark.parametrize('linearization', [FirstEstimates, Invariant])
def test_rounding_is_that_of_the_whole_state_where_all_states_share_a_large_error(linearization):
    scenario, sigma = town(landmarks=250, steps=1000, seed=1), (300.0, 300.0, 0.2)

    whole, _ = run(scenario, WHOLE_MAP, linearization(), sigma)
    compressed, entered = run(scenario, ActiveSubmap(200, 15), linearization(), sigma)

    assert entered > 10
    variables = whole.state.variables()
    # Elements of P of 1e5 m^2 are rounded to 1e-11 m^2, some thousand times.
    assert_allclose(compressed.state.estimates(), whole.state.x_hat, atol=1e-6)
    assert_allclose(
        compressed.state.marginal(variables), whole.state.marginal(variables), atol=1e-5)


@pytest.mark.parametrize('linearization', [FirstEstimates, Invariant])
def test_reading_estimates_changes_no_bit(linearization):
    scenario = town(landmarks=150, steps=300, seed=2)
    start, happened = scenario
    asked, _ = run((start, []), ActiveSubmap(100, 10), linearization())

    for motions, scans in happened:
        asked.step(motions, scans)
        asked.state.estimates()
        asked.state.marginal(asked.state.variables())
    silent, _ = run(scenario, ActiveSubmap(100, 10), linearization())

    assert_array_equal(asked.state.estimates(), silent.state.estimates())
    assert_array_equal(*(
        f.state.marginal(f.state.variables()) for f in (asked, silent)))


@pytest.mark.parametrize('linearization', [FirstEstimates, Invariant])
def test_removed_variables_do_not_end_a_submap_and_change_no_other(linearization):
    start, happened = town(landmarks=300, steps=400, seed=3)
    whole, compressed = (
        run((start, happened[:300]), regions, linearization())[0]
        for regions in (WHOLE_MAP, ActiveSubmap(100, 10)))
    submap = compressed.state.covariance
    assert isinstance(submap, CompressedCovariance)
    is_inside = [
        submap._contains(landmark.slot.indices)  # noqa: SLF001
        for landmark in compressed.state.landmarks.values()]
    removed = [*compressed.state.landmarks][::3]
    assert 0 < sum(is_inside[::3]) < len(removed)

    for motions, scans in [([], []), *happened[300:]]:
        for filter_ in (whole, compressed):
            filter_.step(motions, scans)
            landmarks = filter_.state.landmarks
            # Some are observed again, and removed again.
            filter_.state.remove_all([landmarks[key] for key in removed if key in landmarks])
        if not motions:
            assert compressed.state.covariance is submap

    assert_allclose(compressed.state.estimates(), whole.state.estimates(), atol=1e-10)
    P = (f.state.marginal(f.state.variables()) for f in (compressed, whole))
    assert_allclose(*P, atol=1e-10)


def records(happened, begin=0):
    """Yield what happened as odometry and scans, a tenth of a second each."""
    at = {}
    for motions, scans in happened:
        for motion in motions:
            at[motion.robot] = compose(at.get(motion.robot, np.zeros(3)), motion.u)
            if motion.stamp >= begin:
                yield Odometry(
                    motion.robot, motion.stamp * NS // 10, at[motion.robot], 100.0 * motion.Q)
        for scan in scans:
            if scan.stamp >= begin:
                yield Scan(scan.robot, scan.stamp * NS // 10, scan.observations)


def two_robots(start, **chosen):
    """Return settings of a town where the start of the second robot is not known."""
    anchor = tuple(start['r1'].tolist())
    return Settings((RobotSettings('r1', 1), RobotSettings('r2', 2)), 'r1', anchor, **chosen)


def coming_and_going(scenario, prior=None, **chosen):
    """Return an estimator whose second robot comes late, leaves and comes back."""
    start, happened = scenario
    settings = two_robots(start, **chosen)
    team = Estimator(settings, prior)
    in_regions = 0
    for record in records(happened):
        step = record.stamp * 10 // NS
        if step == 350 and 'r2' in team.robots:
            team.change_team(settings.robots[:1])
        if step == 360 and 'r2' not in team.robots:
            team.change_team(settings.robots)
        if record.robot == 'r1' or 250 < step < 350 or step > 400:
            team.add(record)
        for _ in team.take():
            in_regions += isinstance(team.groups.team.state.covariance, CompressedCovariance)
    list(team.close())
    return team, in_regions


def same_frames(whole, compressed):
    """Check that two estimators know the same of everything."""
    expected, actual = frames(whole), frames(compressed)
    assert expected.keys() == actual.keys()
    for name, state in expected.items():
        assert state.landmarks.keys() == actual[name].landmarks.keys()
        assert_allclose(actual[name].estimates(), state.estimates(), atol=1e-9)
        of_all, of_all_others = (s.marginal(s.variables()) for s in (state, actual[name]))
        assert_allclose(of_all_others, of_all, atol=1e-9)


@pytest.mark.parametrize('chosen', [
    {}, {'filter': 'standard'}, {'update_iterations': 2}, {'inflate_rejected_scans': True},
    {'filter': 'invariant'}], ids=str)
def test_robots_join_and_leave_with_submaps_as_with_the_whole_state(monkeypatch, chosen):
    monkeypatch.setattr(frame_groups, 'AROUND_ROBOTS', ActiveSubmap(100, 10))
    scenario = town(landmarks=120, steps=500, seed=5)

    compressed, in_regions = coming_and_going(scenario, **chosen)
    whole, _ = coming_and_going(scenario, compressed=False, **chosen)

    assert in_regions > 50
    assert compressed.groups.not_in_map == whole.groups.not_in_map == {}
    same_frames(whole, compressed)


@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_a_prior_map_is_updated_in_submaps(monkeypatch, kind):
    monkeypatch.setattr(frame_groups, 'AROUND_ROBOTS', ActiveSubmap(100, 10))
    scenario = town(landmarks=400, steps=450, seed=6)
    known = np.random.default_rng(6).uniform(0.0, np.sqrt(20.0 * 400), (400, 2))
    P = random_covariance(np.random.default_rng(7), 800) / 400.0
    prior = PriorMap(tuple(range(400)), known, P)

    compressed, in_regions = coming_and_going(scenario, prior, filter=kind)
    whole, _ = coming_and_going(scenario, prior, compressed=False, filter=kind)

    assert in_regions > 50
    same_frames(whole, compressed)


@pytest.mark.parametrize('kind', [slow('fej'), 'invariant'])
def test_observations_without_ids_give_the_same_result_with_submaps(monkeypatch, kind):
    monkeypatch.setattr(frame_groups, 'AROUND_ROBOTS', ActiveSubmap(100, 10))
    start, happened = town(landmarks=120, steps=500, seed=9)
    unnumbered = start, [
        (motions, [Scan(s.robot, s.stamp, tuple(
            Observation(NO_ID, observation.z, R) for observation in s.observations))
            for s in scans])
        for motions, scans in happened]

    compressed, in_regions = coming_and_going(unnumbered, filter=kind)
    whole, _ = coming_and_going(unnumbered, compressed=False, filter=kind)

    # Its second robot joins twice, after which all landmarks are in the active submap at first.
    assert in_regions > 50
    assert compressed.groups.not_in_map == {}
    same_frames(whole, compressed)


def in_a_submap(landmarks=60):
    """Return a state with a prior map and a robot that is in an active submap, and the rule."""
    state = state_of_prior_map(PriorMap(
        tuple(range(landmarks)), np.arange(2.0 * landmarks).reshape(-1, 2),
        1e-2 * np.eye(2 * landmarks)))
    robot = state.insert_robot('r1', 0, np.zeros(3), 1e-2 * np.eye(3))
    submap = ActiveSubmap(100, 5)
    submap.ensure_contains(state, robot.slot.indices, turns_points=False)
    assert isinstance(state.covariance, CompressedCovariance)
    return state, robot, submap


def test_a_robot_inserted_while_there_is_a_submap_is_independent_of_all_others():
    state, _, _ = in_a_submap()
    others, P = state.variables(), random_covariance(np.random.default_rng(6), 3)
    before = state.marginal(others)

    robot = state.insert_robot('r2', 0, np.array([1.0, 2.0, 0.3]), P)

    assert_array_equal(state.marginal([robot]), P)
    assert_array_equal(state.estimate(robot), [1.0, 2.0, 0.3])
    assert not state.marginal([robot, *others])[:3, 3:].any()
    assert_allclose(state.marginal(others), before, atol=1e-15)


def updates_until_left(state, robot, submap, most=300):
    """Observe the robot's position until the submap is left; return the number of updates."""
    first, columns = state.covariance, robot.slot.indices[None]
    H = SparseRows(columns, np.eye(2, 3)[None])
    for count in range(most):
        submap.ensure_contains(state, columns, turns_points=False)
        if state.covariance is not first:
            return count
        covariance = state.covariance
        covariance.condition(covariance.correction(covariance.project(H, R[None]), np.zeros(2)))
    return most


def test_a_submap_is_left_when_its_growth_has_cost_as_much_as_leaving():
    state, robot, submap = in_a_submap()
    for number in range(60, 68):
        state.augment(('', number), robot, np.zeros(2), np.eye(2, 3), 1e-2 * np.eye(2))

    # Robot and five landmarks with their proxies at the start, eight more landmarks now: an update
    # of rank 2 costs 2 (42^2 - 26^2) flops more. Leaving 139 states costs those of its products.
    leaving, growth = 139 * 13 * (139 + 2 * (13 + 29)), 2 * (42**2 - 26**2)
    assert updates_until_left(state, robot, submap) == math.ceil(
        leaving / (LEAVING_RATE * growth))


def test_a_submap_that_does_not_grow_is_kept():
    assert updates_until_left(*in_a_submap()) == 300


def test_a_submap_that_would_be_larger_than_the_joint_state_is_left():
    state, _, submap = in_a_submap()
    first = state.covariance

    submap.ensure_contains(state, state.landmark_positions(), turns_points=False)

    assert state.covariance is not first


@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_a_run_saved_within_a_submap_continues_bit_for_bit(monkeypatch, kind):
    monkeypatch.setattr(frame_groups, 'AROUND_ROBOTS', ActiveSubmap(100, 10))
    start, happened = town(landmarks=150, steps=300, seed=4)
    x1, x2 = (tuple(pose.tolist()) for pose in start.values())
    settings = Settings(
        (RobotSettings('r1', 1), RobotSettings('r2', 2, x2, (0.1, 0.1, 0.01))), 'r1', x1,
        filter=kind)

    def go(estimator, measured):
        for record in measured:
            estimator.add(record)
            list(estimator.take())
        return estimator

    begun = go(Estimator(settings), records(happened[:250]))
    assert isinstance(begun.groups.team.state.covariance, CompressedCovariance)
    resumed = go(restore(snapshot(begun), settings, Estimator), records(happened, begin=251))
    at_once = go(Estimator(settings), records(happened))

    assert resumed.state_hash() == at_once.state_hash()


def test_of_many_states_the_same_is_computed_from_a_copy(monkeypatch):
    rng = np.random.default_rng(5)
    _, compressed, slots = whole_and_region(rng)
    joint, _ = happen(compressed, slots, rng)
    points = np.array([slot.indices[:2] for slot in joint])

    few = [*lower_rows(compressed, joint)], compressed.blocks(points)
    for module in (compressed_covariance, joint_covariance):
        monkeypatch.setattr(module, 'MAX_DIRECT', 0)
    many = [*lower_rows(compressed, joint)], compressed.blocks(points)

    P = compressed.marginal(joint)
    for i, rows in enumerate(zip(few[0], many[0])):
        for row in rows:
            assert_allclose(row, P[i, :i + 1], rtol=0, atol=1e-12)
    assert_allclose(many[1], few[1], rtol=0, atol=1e-12)
