# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of posts, walls and people, and the scores of a detector over a drive among them."""

from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import inverse, poses_at, transform
from fej_slam_ros.core.records import (
    NO_ID, Observation, Odometry, ordered, Scan, TrueLandmarks)
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.detection.detector import Detector, StampedScan
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.detection.posts import PostDetector
from fej_slam_ros.detection.records import RobotLaserScan
from fej_slam_ros.sim.laser_world import make_laser_world, measure
from fej_slam_ros.sim.lidar import true_ranges

NO_WALLS = np.empty((0, 4))
#: Largest distance at which a detection is of a post [m].
NEAR = 0.3


def scan_of(
    discs, walls=NO_WALLS, beams=720, sigma=0.0, seed=0, pose=(0.0, 0.0, 0.0), fov=2.0 * np.pi,
    max_range=20.0,
):
    """Return a scan of discs (x, y, radius) and walls from a pose, with noise of the ranges."""
    increment = fov / beams
    angles = -fov / 2.0 + increment * np.arange(beams)
    ranges = true_ranges(
        np.tile(pose, (beams, 1)), angles, np.reshape(discs, (-1, 3)), np.reshape(walls, (-1, 4)))
    ranges = ranges + np.random.default_rng(seed).normal(0.0, sigma, beams)
    ranges[ranges > max_range] = np.inf
    return LaserScan(ranges, -fov / 2.0, increment, 0.0, 0.05, max_range)


@dataclass
class Scores:
    """Detections of posts, others, and posts without detection although they should have one."""

    right: int = 0
    wrong: int = 0
    missed: int = 0
    nees: list = field(default_factory=list)

    @property
    def precision(self):
        return self.right / (self.right + self.wrong)

    @property
    def recall(self):
        return 1.0 - self.missed / (self.missed + self.right)

    def add(self, world, robot, scan, detections):
        """Compare the detections in a scan with the posts, as seen at its end."""
        pose, = poses_at(np.array([scan.end]), np.array(world.stamps), world.true_poses[robot])
        posts = transform(inverse(pose), world.posts[:, :2])
        found = set()
        for point, R in zip(detections.points, detections.R):
            post = int(np.argmin(np.hypot(*(posts - point).T)))
            error = point - posts[post]
            if np.hypot(*error) < NEAR:
                found.add(post)
                self.right += 1
                self.nees.append(error @ np.linalg.solve(R, error) / 2.0)
            else:
                self.wrong += 1
        self.missed += len(self._seen(world, robot, scan) - found)

    @staticmethod
    def _seen(world, robot, scan):
        """Return the posts of which five beams, and all but one, have a return."""
        laser, n = scan.scan, len(scan.scan.ranges)
        times = scan.stamp + np.round(np.arange(n) * laser.time_increment * 1e9).astype(np.int64)
        poses = poses_at(times, np.array(world.stamps), world.true_poses[robot])
        angles = laser.angle_min + laser.angle_increment * np.arange(n)
        discs = np.vstack([world.posts, world.legs(scan.stamp * 1e-9)])
        hit = np.argmin([true_ranges(poses, angles, disc[None], NO_WALLS) for disc in discs], 0)
        nearest = true_ranges(poses, angles, discs, world.walls)
        is_post = np.isfinite(laser.ranges) & (
            nearest < true_ranges(poses, angles, discs[len(world.posts):], world.walls))
        counts = np.bincount(hit[is_post], minlength=len(discs))[:len(world.posts)]
        distance = np.hypot(*(world.posts[:, :2] - poses[0, :2]).T)
        full = 2.0 * np.arcsin(world.posts[:, 2] / distance) / laser.angle_increment
        return {*np.flatnonzero((counts >= 5) & (counts >= 0.95 * full - 1.0)).tolist()}


def detect_in_world(world_settings, lidar, seed, scans):
    """Return the scores of the first scans of a world, by the detectors of its robots."""
    rng = np.random.default_rng(seed)
    world, scores = make_laser_world(world_settings, rng), Scores()
    detected = (
        (record.robot, *scan) for record, found in with_detections(world, lidar, rng)
        for scan in found)
    for detections in islice(detected, scans):
        scores.add(world, *detections)
    return scores


def with_detections(world, lidar, rng):
    """Yield the measurements in a world, each with the scans that it completes and their posts."""
    detectors = {
        name: Detector(PostDetector(range_sigma=lidar.range_sigma), min_beams=3, static_time=0.8)
        for name in world.robots}
    for record in measure(world, lidar, rng):
        found = []
        if isinstance(record, Odometry):
            detectors[record.robot].add_odometry(record)
            found = [*detectors[record.robot].take()]
        elif isinstance(record, RobotLaserScan):
            detectors[record.robot].add_scan(StampedScan(record.stamp, record.scan, np.zeros(3)))
        yield record, found


@dataclass
class LineResult:
    """Result of a run from scans to poses, by two robots; the start of the second is unknown."""

    joined: bool  #: whether the second robot is in map
    rmse: dict  #: of each robot in map [m]
    nees: dict  #: NEES/3 of each robot in map


def estimate_in_world(world, lidar, rng, with_ids=False):
    """Return the result of detectors and an estimator, which may be given the true IDs."""
    estimator = Estimator(Settings(
        robots=tuple(RobotSettings(name, k) for k, name in enumerate(world.robots, start=1)),
        anchor=world.robots[0]))

    def records():
        for record, found in with_detections(world, lidar, rng):
            if not isinstance(record, (RobotLaserScan, TrueLandmarks)):
                yield record
            for scan, detections in found:
                yield _observed(world, record.robot, scan.end, detections, with_ids)

    for _ in estimator.run(records()):
        pass
    scores = estimator.evaluation.scores
    return LineResult(
        world.robots[1] not in estimator.groups.not_in_map,
        {name: score.position_rmse() for name, score in scores.items()},
        {name: score.mean_nees_per_dof() for name, score in scores.items()})


def _observed(world, robot, stamp, found, with_ids):
    pose, = poses_at(np.array([stamp]), np.array(world.stamps), world.true_poses[robot])
    observations = {}
    for k, (z, R) in enumerate(zip(found.points, found.R)):
        ids, distances = [*world.landmarks], np.hypot(
            *(np.array([*world.landmarks.values()]) - transform(pose, z[None])).T)
        if not with_ids:
            observations[k] = Observation(NO_ID, z, R)
        elif distances.min() < NEAR:
            id_ = ids[int(distances.argmin())]
            observations[id_] = Observation(id_, z, R)
    return Scan(robot, stamp, ordered([*observations.values()]))
