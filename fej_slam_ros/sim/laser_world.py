# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A room with posts, walls and people who walk, in which robots with planar lasers drive."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from heapq import merge
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, poses_at, transform_poses
from fej_slam_ros.core.records import NS, Odometry, TrueLandmarks, TruePose
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.detection.records import measured_at, RobotLaserScan
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim import sensors
from fej_slam_ros.sim.lidar import LidarSettings, measured, MIN_RANGE, true_ranges
from fej_slam_ros.sim.trajectories import intersecting_circles, team_loops
from fej_slam_ros.sim.world import repeated, step_stamps, World

#: Smallest distance of random posts from each other and from walls, and of both from paths [m].
POST_DISTANCE, PATH_DISTANCE = 1.2, 0.6
#: Distance from the paths to the outer walls [m].
MARGIN = 3.0
#: Lengths of random inner walls [m].
WALL_LENGTHS = (1.5, 5.0)
#: A person: speed [m/s], radius of a leg, half the distance between the legs and length of a
#: step [m].
WALKING_SPEED, LEG_RADIUS, HALF_STANCE, STEP_LENGTH = 1.2, 0.07, 0.12, 0.7
#: Number of random places tried for a post or wall.
MAX_TRIES = 10_000


@dataclass(frozen=True)
class LaserWorldSettings:
    """
    Parameters of a world; lengths in m, angles in rad.

    Posts and walls that are given replace the random ones.
    """

    #: Lengths of the loops of robots 1, 3, ... and 2, 4, ...; they drive on circles.
    loop_lengths: tuple[float, float] = (30.0, 25.0)
    steps_per_loop: int = 1500  #: Number of steps in a loop
    robots: tuple[str, ...] = ('r1', 'r2')  #: Names; the first one starts at `start`
    landmarks: int = 15  #: Number of random posts
    post_radius: tuple[float, float] = (0.05, 0.2)  #: Smallest and largest radius of a random post
    posts: tuple[float, ...] = ()  #: x, y and radius of each post
    inner_walls: int = 2  #: Largest number of random walls in the room
    walls: tuple[float, ...] = ()  #: x, y of the begin and x, y of the end of each wall
    people: int = 2  #: Number of people, who walk between random places
    loops: int = 2  #: Number of loops that each robot drives
    rate: float = 25.0  #: Steps per second [Hz]
    first_stamp: int = 0  #: Time of step 0 [ns]
    #: Pose [x, y, phi] of the first robot at step 0 in the frame ``map``.
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Reject lists of posts and walls of a wrong length."""
        for name, size in (('posts', 3), ('walls', 4)):
            if len(getattr(self, name)) % size:
                raise UsageError(f'{name}: give {size} numbers for each')
        if self.post_radius[0] > self.post_radius[1]:
            raise UsageError('post_radius: give the smaller radius first')
        if min(self.posts[2::3], default=1.0) <= 0.0:
            raise UsageError('posts: give radii above 0')

    @property
    def stamps(self) -> tuple[int, ...]:
        """Return the time of each step [ns]."""
        return step_stamps(self.first_stamp, self.loops * self.steps_per_loop, self.rate)


@dataclass(frozen=True, eq=False)
class LaserWorld(World):
    """Ground truth in the frame ``map``."""

    radii: Mapping[int, float]  #: Radius [m] of each post by its ID
    walls: Array  #: (w, 4) array, both ends of each wall [m]
    walks: Array  #: (k, 4) array, places between which each person walks back and forth [m]

    @property
    def posts(self) -> Array:
        """Return centre and radius (n, 3) of each post."""
        return np.array([[*self.landmarks[key], self.radii[key]] for key in self.landmarks])

    def legs(self, time: float) -> Array:
        """Return two discs (2 k, 3) for each of the people at a time [s]."""
        discs = [leg for walk in self.walks for leg in _legs(walk, time)]
        return np.array(discs).reshape(-1, 3)


def make_laser_world(settings: LaserWorldSettings, rng: np.random.Generator) -> LaserWorld:
    """Return a world; posts, walls and people that are not given are random."""
    loops, _ = team_loops(
        intersecting_circles(settings.loop_lengths, settings.steps_per_loop),
        len(settings.robots))
    loops = [transform_poses(np.array(settings.start), loop) for loop in loops]
    paths = np.vstack(loops)[:, :2]
    low, high = paths.min(axis=0) - MARGIN, paths.max(axis=0) + MARGIN
    walls = np.array(settings.walls).reshape(-1, 4)
    if not len(walls):
        (x, y), (X, Y) = low, high
        walls = np.array([[x, y, X, y], [X, y, X, Y], [X, Y, x, Y], [x, Y, x, y]])
    posts = np.array(settings.posts).reshape(-1, 3)
    if not len(posts):
        posts = _random_posts(settings, paths, walls, low, high, rng)
    if not settings.walls:
        walls = _with_inner_walls(settings.inner_walls, walls, posts, paths, low, high, rng)
    walks = rng.uniform(np.tile(low, 2) + 0.5, np.tile(high, 2) - 0.5, (settings.people, 4))
    ids = range(1, len(posts) + 1)
    poses = [repeated(loop, settings.loops) for loop in loops]
    return LaserWorld(
        settings.robots, settings.stamps, dict(zip(settings.robots, poses)),
        dict(zip(ids, posts[:, :2])), dict(zip(ids, posts[:, 2].tolist())), walls, walks)


def measure(
    world: LaserWorld, settings: LidarSettings, rng: np.random.Generator
) -> Iterator[Odometry | TruePose | TrueLandmarks | RobotLaserScan]:
    """Yield odometry, scans and ground truth as they are measured, the true landmarks first."""
    yield TrueLandmarks(world.landmarks, world.stamps[0])
    lasers: list[Iterator[RobotLaserScan]] = []
    others: list[Iterator[Odometry | TruePose]] = []
    for robot, robot_rng in zip(world.robots, rng.spawn(len(world.robots))):
        odometry_rng, scan_rng = robot_rng.spawn(2)
        lasers.append(scans(world, robot, settings, scan_rng))
        others += [
            sensors.odometry(world, robot, settings.odometry_sigma, odometry_rng),
            sensors.true_poses(world, robot)]
    yield from merge(*lasers, *others, key=measured_at)


def scans(
    world: LaserWorld, robot: str, settings: LidarSettings, rng: np.random.Generator
) -> Iterator[RobotLaserScan]:
    """Yield the scans of a robot, each stamped with its first beam."""
    angles, period = settings.angles, round(NS / settings.scan_rate)
    known, poses, posts = np.array(world.stamps), world.true_poses[robot], world.posts
    time_increment = period / NS / settings.beams
    beam_times = np.round(np.arange(settings.beams) * time_increment * NS).astype(np.int64)
    for stamp in range(world.stamps[0], world.stamps[-1] - period, period):
        discs = np.vstack([posts, world.legs(stamp / NS)])
        true = true_ranges(poses_at(stamp + beam_times, known, poses), angles, discs, world.walls)
        yield RobotLaserScan(robot, stamp, LaserScan(
            measured(true, settings, rng), float(angles[0]), settings.increment, time_increment,
            MIN_RANGE, settings.range))


def _legs(walk: Array, time: float) -> Iterator[Array]:
    """Yield both legs of a person; one stands while the other makes a step."""
    begin, end = walk[:2], walk[2:]
    length = max(float(np.hypot(*(end - begin))), STEP_LENGTH)
    ahead = (end - begin) / length
    left = np.array([-ahead[1], ahead[0]])
    for side in (1.0, -1.0):
        # Both legs together advance by a step in the time of a step.
        phase = WALKING_SPEED * time / (2.0 * STEP_LENGTH) + side / 4.0
        swing = min(2.0 * (phase % 1.0), 1.0)
        travelled = 2.0 * STEP_LENGTH * (math.floor(phase) + swing)
        along = length - abs(travelled % (2.0 * length) - length)
        yield np.append(begin + along * ahead + side * HALF_STANCE * left, LEG_RADIUS)


def _random_posts(
    settings: LaserWorldSettings, paths: Array, walls: Array, low: Array, high: Array,
    rng: np.random.Generator,
) -> Array:
    posts = np.empty((0, 3))
    for _ in range(MAX_TRIES):
        if len(posts) == settings.landmarks:
            return posts
        post = np.append(rng.uniform(low, high), rng.uniform(*settings.post_radius))
        is_clear = _distance(paths, post[:2]) > PATH_DISTANCE + post[2] and all(
            _wall_distance(wall, post[:2]) > POST_DISTANCE + post[2] for wall in walls)
        if is_clear and _distance(posts[:, :2], post[:2]) > POST_DISTANCE + 2.0 * post[2]:
            posts = np.vstack([posts, post])
    raise UsageError(
        f'landmarks: {settings.landmarks} posts have no room beside the paths, use fewer')


def _with_inner_walls(
    count: int, walls: Array, posts: Array, paths: Array, low: Array, high: Array,
    rng: np.random.Generator,
) -> Array:
    inner: list[Array] = []
    for _ in range(MAX_TRIES):
        if len(inner) == count:
            break
        begin, angle = rng.uniform(low, high), rng.uniform(0.0, 2.0 * np.pi)
        end = begin + rng.uniform(*WALL_LENGTHS) * np.array([np.cos(angle), np.sin(angle)])
        wall = np.concatenate([begin, end])
        beside = np.linspace(begin, end)
        if ((beside > low) & (beside < high)).all() and all(
                _wall_distance(wall, point) > distance for points, distance in
                ((posts[:, :2], POST_DISTANCE), (paths[::10], PATH_DISTANCE)) for point in points
        ) and all(_wall_distance(other, point) > POST_DISTANCE
                  for other in [*walls, *inner] for point in beside):
            inner.append(wall)
    return np.vstack([walls, *inner])


def _distance(points: Array, point: Array) -> float:
    return float(np.hypot(*(points - point).T).min(initial=np.inf))


def _wall_distance(wall: Array, point: Array) -> float:
    along = wall[2:] - wall[:2]
    t = np.clip((point - wall[:2]) @ along / max(float(along @ along), 1e-9), 0.0, 1.0)
    return float(np.hypot(*(wall[:2] + t * along - point)))
