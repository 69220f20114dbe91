# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A world of printed tags, on posts and on the sides of robots, that cameras of robots see."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from heapq import merge
import math

import numpy as np
from scipy.spatial.transform import Rotation

from fej_slam_ros.core.geometry import Array, compose, poses_at
from fej_slam_ros.core.records import NS, TrueLandmarks
from fej_slam_ros.detection.objects import DetectedObject, ObjectNoise, transform_of
from fej_slam_ros.detection.records import AnyRecord, measured_at, RobotTags
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim import sensors
from fej_slam_ros.sim.world import make_world, World, WorldSettings

#: Pose of the camera, looking ahead, by its optical frame (x right, y down, z ahead) in the base
#: frame: x, y, z [m], roll, pitch, yaw [rad].
CAMERA_POSE = (0.15, 0.0, 0.3, -math.pi / 2.0, 0.0, -math.pi / 2.0)
#: Distance of the tags of a robot from its base frame, and height of their centres [m].
TAG_DEPTH, TAG_HEIGHT = 0.15, 0.2
#: Number of tags of a robot, on its sides; robot k = 1, 2, ... has 1000 k, 1000 k + 1, ...
SIDES, FIRST_ROBOT_TAG = 4, 1000
#: Heights of the centres of tags on posts [m].
POST_TAG_HEIGHTS = (0.2, 0.8)
#: Angle between the normal of a tag and the direction to the camera beyond which it is not seen.
MAX_VIEW_ANGLE = math.radians(70.0)
#: Nearest distance at which a tag fits into an image [m].
MIN_TAG_DISTANCE = 0.4


@dataclass(frozen=True)
class CameraSettings:
    """The camera of every robot; lengths in m, angles in rad."""

    #: Standard deviations of the increment (x, y, phi) of one step.
    odometry_sigma: tuple[float, float, float] = (0.002, 0.002, 0.001)
    range: float = 6.0  #: Maximum distance of a tag that is seen
    field_of_view: float = math.radians(70.0)  #: Full horizontal angle
    range_sigma: float = 0.02  #: Standard deviation of a distance near the camera
    range_sigma_growth: float = 0.01  #: Its growth by the square of the distance [1/m]
    bearing_sigma: float = 0.005  #: Standard deviation of a direction
    orientation_sigma: float = 0.1  #: Standard deviation of the orientation of a tag
    missed: float = 0.05  #: Fraction of the tags in view that are not detected
    image_rate: float = 10.0  #: Images per second [Hz]

    def noise(self) -> ObjectNoise:
        """Return the standard deviations of positions."""
        return ObjectNoise(
            self.range_sigma, self.range_sigma_growth, self.bearing_sigma, self.orientation_sigma)


@dataclass(frozen=True, eq=False)
class TagWorld(World):
    """Ground truth in the frame ``map``."""

    normals: Mapping[int, float]  #: direction in which each tag on a post faces [rad]
    heights: Mapping[int, float]  #: height of the centre of each tag on a post [m]


def robot_tags(robots: tuple[str, ...]) -> dict[str, list[str]]:
    """Return the names of the tags that each robot carries."""
    return {
        name: [str(FIRST_ROBOT_TAG * k + side) for side in range(SIDES)]
        for k, name in enumerate(robots, start=1)}


def make_tag_world(settings: WorldSettings, rng: np.random.Generator) -> TagWorld:
    """Return a world whose landmarks are tags on posts that face the nearest path."""
    if settings.landmarks >= FIRST_ROBOT_TAG:
        raise UsageError(
            f'landmarks: give fewer than {FIRST_ROBOT_TAG} tags on posts, from which number on'
            ' tags are on robots')
    world = make_world(settings, rng)
    paths = np.vstack([poses[:, :2] for poses in world.true_poses.values()])
    normals, heights = {}, {}
    for id_, point in world.landmarks.items():
        to_path = paths - point
        x, y = to_path[np.argmin(np.hypot(*to_path.T))]
        normals[id_], heights[id_] = math.atan2(y, x), float(rng.uniform(*POST_TAG_HEIGHTS))
    return TagWorld(
        world.robots, world.stamps, world.true_poses, world.landmarks, normals, heights)


def measure(
    world: TagWorld, settings: CameraSettings, rng: np.random.Generator
) -> Iterator[AnyRecord]:
    """Yield odometry, tags and ground truth as they are measured, the true landmarks first."""
    yield TrueLandmarks(world.landmarks, world.stamps[0])
    sources: list[Iterator[AnyRecord]] = []
    for robot, robot_rng in zip(world.robots, rng.spawn(len(world.robots))):
        odometry_rng, image_rng = robot_rng.spawn(2)
        sources += [
            sensors.odometry(world, robot, settings.odometry_sigma, odometry_rng),
            images(world, robot, settings, image_rng), sensors.true_poses(world, robot)]
    yield from merge(*sources, key=measured_at)


def images(
    world: TagWorld, robot: str, settings: CameraSettings, rng: np.random.Generator
) -> Iterator[RobotTags]:
    """Yield the tags in each image of a robot."""
    known, camera = np.array(world.stamps), transform_of(*CAMERA_POSE)
    period = round(NS / settings.image_rate)
    on_posts = {
        str(id_): _tag(point, world.heights[id_], world.normals[id_])
        for id_, point in world.landmarks.items()}
    for stamp in range(world.stamps[0], world.stamps[-1], period):
        at = {
            name: poses_at(np.array([stamp]), known, poses)[0]
            for name, poses in world.true_poses.items()}
        x, y, phi = at[robot].tolist()
        to_camera = np.linalg.inv(transform_of(x, y, 0.0, 0.0, 0.0, phi) @ camera)
        tags = on_posts | _on_robots(at, robot)
        in_view = {
            name: to_camera @ tag for name, tag in tags.items()
            if _is_in_view(to_camera @ tag, settings)}
        yield RobotTags(robot, stamp, tuple(
            _measured(name, tag, settings, rng) for name, tag in in_view.items()
            if rng.random() >= settings.missed))


def _on_robots(at: Mapping[str, Array], observer: str) -> dict[str, Array]:
    """Return the tags on the sides of the other robots at their poses (3,), by name."""
    names = robot_tags(tuple(at))
    return {
        name: _tag(centre[:2], TAG_HEIGHT, float(centre[2]))
        for robot, pose in at.items() if robot != observer
        for side, name in enumerate(names[robot])
        for angle in [2.0 * math.pi * side / SIDES]
        for centre in [compose(pose, np.array(
            [TAG_DEPTH * math.cos(angle), TAG_DEPTH * math.sin(angle), angle]))]}


def _tag(point: Array, height: float, normal: float) -> Array:
    """Return the pose (4, 4) of a tag: z into its face, y down, as that of apriltag_ros."""
    pose = np.eye(4)
    pose[:3, :3] = np.array([
        [-math.sin(normal), 0.0, -math.cos(normal)],
        [math.cos(normal), 0.0, -math.sin(normal)],
        [0.0, -1.0, 0.0]])
    pose[:2, 3], pose[2, 3] = point, height
    return pose


def _is_in_view(tag: Array, settings: CameraSettings) -> bool:
    x, _, z = t = tag[:3, 3]
    distance = float(np.linalg.norm(t))
    if not MIN_TAG_DISTANCE <= distance <= settings.range or z <= 0.0:
        return False
    view = math.acos(float(np.clip(tag[:3, 2] @ t / distance, -1.0, 1.0)))
    return view <= MAX_VIEW_ANGLE and abs(math.atan2(x, z)) <= settings.field_of_view / 2.0


def _measured(
    name: str, tag: Array, settings: CameraSettings, rng: np.random.Generator
) -> DetectedObject:
    """Return a tag with noise of distance, direction and orientation; their covariance unknown."""
    t = tag[:3, 3]
    P = settings.noise().of_position(t)
    pose = tag.copy()
    pose[:3, 3] = rng.multivariate_normal(t, P)
    turn = Rotation.from_rotvec(rng.normal(0.0, settings.orientation_sigma, 3))
    pose[:3, :3] = turn.as_matrix() @ tag[:3, :3]
    return DetectedObject(name, pose, None)
