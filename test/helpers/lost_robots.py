# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of three robots in which the last one gets lost, by one of several faults."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.records import NS, Odometry, PriorMap, Scan, TrueLandmarks, TruePose
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.trajectories import circle
from fej_slam_ros.sim.world import World
from helpers.core import pose_difference, turn
from helpers.records import team

#: Length of the loop that three robots drive one behind the other, twice, and their distance [m].
LENGTH, DISTANCE = 120.0, 10.0
STEPS = 300
LANDMARKS = 60
#: Number of landmarks that may be surveyed before, evenly spaced, and the noise of it [m].
SURVEYED, SURVEY_SIGMA = 12, 0.02
#: They see about ten landmarks at a time. The last one leads: the others follow into its map.
SENSORS = SensorSettings((0.02, 0.02, 0.004), (0.1, 0.1), range=10.0)
HEALTHY, LOST = ('r1', 'r2'), 'r3'
STEP = NS // 10
END = 2 * STEPS * STEP


def drive(seed, sensors=SENSORS):
    """Return the records of a run of three loops, the last one for a robot that is carried."""
    rng = np.random.default_rng(seed)
    course = np.tile(circle(LENGTH, STEPS, 1)[:-1], (4, 1))
    ahead = round(DISTANCE / LENGTH * STEPS)
    poses = {
        name: course[k * ahead:k * ahead + 3 * STEPS + 1]
        for k, name in enumerate((*HEALTHY, LOST))}
    angle = 2.0 * np.pi * (np.arange(LANDMARKS) + rng.random(LANDMARKS)) / LANDMARKS
    radius = LENGTH / (2.0 * np.pi)
    out = radius + rng.uniform(-5.0, 5.0, LANDMARKS)
    landmarks = np.column_stack([out * np.sin(angle), radius - out * np.cos(angle)])
    stamps = tuple(k * STEP for k in range(3 * STEPS + 1))
    world = World(tuple(poses), stamps, poses, dict(enumerate(landmarks, start=1)))
    return list(measure(world, sensors, rng))


def survey(records, seed):
    """Return some of the landmarks as surveyed before the run."""
    positions = true_landmarks(records)
    ids = sorted(positions)[::LANDMARKS // SURVEYED]
    errors = np.random.default_rng([seed, 7]).normal(0.0, SURVEY_SIGMA, (SURVEYED, 2))
    return PriorMap(
        tuple(ids), np.array([positions[i] for i in ids]) + errors,
        SURVEY_SIGMA**2 * np.eye(2 * SURVEYED))


def true_landmarks(records):
    return next(r for r in records if isinstance(r, TrueLandmarks)).positions


def is_of_lost(record, kind, since):
    return isinstance(record, kind) and record.robot == LOST and record.stamp > since


def with_increments(records, since, until, change):
    """Return the records with the odometry increments of a time changed by a function."""
    odometry = [r for r in records if is_of_lost(r, Odometry, -1)]
    poses = {odometry[0].stamp: odometry[0].pose}
    for earlier, later in pairwise(odometry):
        u = between(earlier.pose, later.pose)
        poses[later.stamp] = compose(
            poses[earlier.stamp], change(u) if since < later.stamp <= until else u)
    return [
        replace(r, pose=poses[r.stamp]) if is_of_lost(r, Odometry, -1) else r for r in records]


def jump(distance, turned=0.0):
    """Let odometry jump once, as after a restart of the driver."""
    def inject(records, since, rng):
        angle = rng.uniform(-np.pi, np.pi)
        offset = np.array([distance * np.cos(angle), distance * np.sin(angle), turned * angle])
        return with_increments(records, since, since + STEP, lambda u: compose(u, offset))
    return inject


def reset(records, since, _):
    """Let odometry begin again at zero, with running stamps."""
    first = next(r for r in records if is_of_lost(r, Odometry, since))
    return [
        replace(r, pose=between(first.pose, r.pose)) if is_of_lost(r, Odometry, since) else r
        for r in records]


def slip(factor, turned, seconds=2):
    """Let wheels slip: odometry has a multiple of the motion, and a rotation that is not."""
    def inject(records, since, rng):
        sign = rng.choice([-1.0, 1.0])
        return with_increments(
            records, since, since + round(seconds * NS),
            lambda u: u * [factor, factor, 1.0] + [0.0, 0.0, sign * turned])
    return inject


def kidnap(steps):
    """Carry the robot along its course, while odometry goes on smoothly."""
    def inject(records, since, _):
        until = since + steps * STEP
        poses = {r.stamp: r.pose for r in records if is_of_lost(r, Odometry, 0)}

        def later(record):
            record = replace(record, stamp=record.stamp - until + since)
            if isinstance(record, Odometry):
                return replace(
                    record, pose=compose(poses[since], between(poses[until], record.pose)))
            return record

        of_lost = (Odometry, Scan, TruePose)
        return sorted(
            [r for r in records if not is_of_lost(r, of_lost, since)]
            + [later(r) for r in records if is_of_lost(r, of_lost, until)],
            key=lambda r: r.stamp)
    return inject


def mount(x, y, phi, from_start=False):
    """Mount the sensor elsewhere than stated, from some time on or from the start."""
    def inject(records, since, _):
        return [
            replace(r, observations=tuple(
                replace(o, z=turn(phi) @ o.z + [x, y]) for o in r.observations))
            if is_of_lost(r, Scan, -1 if from_start else since) else r for r in records]
    return inject


def set_clock(seconds):
    """Set the clock of the robot, in the middle of its drive."""
    def inject(records, since, _):
        shift = round(seconds * NS)
        return [
            replace(r, stamp=r.stamp + shift) if is_of_lost(r, (Odometry, Scan, TruePose), since)
            else r for r in records]
    return inject


#: Each fault is injected into the records after a stamp.
FAULTS = {
    **{f'jump of {d} m': jump(d) for d in (0.3, 1.0, 3.0, 10.0, 30.0)},
    **{f'jump of {d} m and turn': jump(d, 1.0) for d in (0.3, 1.0, 3.0, 10.0, 30.0)},
    'reset to zero': reset,
    'carried 1.2 m': kidnap(3), 'carried 4 m': kidnap(10), 'carried 12 m': kidnap(30),
    'carried 32 m': kidnap(80),
    'slip, 3 times': slip(3.0, 0.0), 'slip, turning': slip(0.5, 0.1),
    'slip, stuck': slip(2.0, 0.0, 6),
    'mount turned by 5 deg': mount(0.0, 0.0, 0.087),
    'mount turned by 20 deg': mount(0.0, 0.0, 0.35),
    'mount 0.5 m off': mount(0.3, 0.4, 0.0),
    'mount turned from the start': mount(0.0, 0.0, 0.35, True),
    'mount backwards from the start': mount(0.0, 0.0, np.pi, True),
}


@dataclass
class RunErrors:
    """Errors of one run."""

    nees: float  #: NEES/3 of the healthy robots
    rmse: float  #: their position RMSE [m]
    lost_share: float  #: share of the poses of the lost robot after the fault that are in map
    lost_error: float  #: its position error at the end [m]
    map_error: float  #: the largest error of a landmark at the end [m]
    estimator: Estimator


def run(records, since=0, end=END, prior=None, **settings):
    """Return the errors of the robots in a run up to a stamp, by default of two loops."""
    records = [r for r in records if isinstance(r, TrueLandmarks) or r.stamp <= end]
    # By a clock that was set back a time passes twice, and the robot is estimated in the first.
    truth = {
        (r.robot, r.stamp): r.pose for r in reversed(records) if isinstance(r, TruePose)}
    estimator = Estimator(team(*HEALTHY, LOST, **settings), prior)
    results = [*estimator.run(r for r in records if not isinstance(r, TruePose))]
    poses = [
        pose for result in results for pose in result.poses
        if pose.stamp > 0 and (pose.robot, pose.stamp) in truth]
    errors = [pose_difference(pose.pose, truth[pose.robot, pose.stamp]) for pose in poses]
    healthy = [
        (e, pose.P) for e, pose in zip(errors, poses)
        if pose.robot in HEALTHY and pose.frame == 'map']
    lost = [
        (e, pose.frame) for e, pose in zip(errors, poses)
        if pose.robot == LOST and pose.stamp > since]
    positions = true_landmarks(records)
    return RunErrors(
        np.mean([e @ np.linalg.solve(P, e) / 3.0 for e, P in healthy]),
        np.sqrt(np.mean([e[:2] @ e[:2] for e, _ in healthy])),
        np.mean([frame == 'map' for _, frame in lost]), np.linalg.norm(lost[-1][0][:2]),
        max(np.linalg.norm(f.position - positions[f.id])
            for f in estimator.landmarks() if f.id in positions),
        estimator)


def fault_at(seed):
    """Return a generator and the time of the fault [ns], in the first loop."""
    rng = np.random.default_rng([seed, 19])
    return rng, int(rng.integers(20, 300)) * STEP
