# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a user may set, with the names, defaults and units of the parameters."""

from dataclasses import dataclass, field

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class RobotSettings:
    """
    One robot of the team; angles in rad, lengths in m.

    Attributes
    ----------
    name : its namespace
    id : its number in clouds of seen robots
    start_pose, start_sigma : known start [x, y, yaw] in ``map`` and its standard deviations, or
        None where the start is unknown
    sensor_pose : where the landmark sensor sits in the base frame, [x, y, yaw]
    sensor_frame : a further frame name that its scans may carry
    odometry_sigma : standard deviations of (x, y, yaw) per square root of a second, used where
        odometry carries no covariance
    landmark_sigma : standard deviations of (x, y) in the sensor frame, used where an observation
        carries no covariance
    odometry_noise_scale, landmark_noise_scale, robot_noise_scale : factors on the standard
        deviations of odometry and of observations of landmarks and robots, wherever these come from

    """

    name: str
    id: int
    start_pose: Triple | None = None
    start_sigma: Triple = (0.0, 0.0, 0.0)
    sensor_pose: Triple = (0.0, 0.0, 0.0)
    sensor_frame: str | None = None
    odometry_sigma: Triple = (0.05, 0.05, 0.02)
    landmark_sigma: tuple[float, float] = (0.1, 0.1)
    odometry_noise_scale: float = 1.0
    landmark_noise_scale: float = 1.0
    robot_noise_scale: float = 1.0


@dataclass(frozen=True)
class Settings:
    """
    The settings of one estimator; times in s, lengths in m, angles in rad.

    Attributes
    ----------
    robots : the team; their order is the order of processing inside a step
    anchor : name of the robot whose start is the origin; '' for none, with prior landmarks
    anchor_pose, anchor_sigma : its start [x, y, yaw] in ``map`` and the standard deviations
    filter : name of the linearisation policy
    update_iterations : of each update, 0 for as many as suit the filter
    compressed : whether steps in a large map touch only the region where robots are, exactly
    start_covariance : ``anchored`` or ``independent`` (the paper's form)
    gate_probability : an observation beyond this chi-square probability is refused, by a smoother so
        that of all right ones of a robot none is; 1.0 is no gate
    match_probability : all right matches of a scan without identities pass with this probability
    inflate_rejected_scans : whether most of a scan beyond the gate is used, with more noise
    moved_landmarks : ``report`` landmarks that were moved, ``forget`` or ``ignore`` them
    max_delay : how late data may arrive and still be put in order
    stale_after : by how much another robot's odometry may lead before one is not waited for
    future_limit : how far ahead of its reception a stamp may lie
    clock_limit : by how much stamps and the clock of reception may differ without a warning
    on_time_jump : ``refuse`` what comes after time has jumped back, or ``reset``
    join_min_landmarks : so many landmarks must be shared for a robot to join others
    join_probability : a right join is accepted with this chi-square probability, by a smoother
        with 0.9999 at least
    join_heading_sigma : what both frames share must tell the heading to this, by an estimator
    shared_landmark_ids : whether one number is one landmark for all robots
    prior_landmarks : file of landmarks that are known before the run, '' for none
    relative_poses : pairs ``seer:seen`` of robots whose relative pose is wanted
    unused_variance : what published 6x6 covariances hold for z, roll and pitch
    map_period : how often paths, maps and markers are published
    publish_tf : whether transforms to the frames of odometry are published
    output : folder for the files of a live run, '' for none
    checkpoint : file that a live run saves itself to, '' for none
    autosave_period : how often a live run saves itself unasked, 0 is never
    restore : checkpoint that a run goes on from, '' for none; `checkpoint` may not be there yet
    autostart : whether a node configures and activates itself
    odometry_sigma, landmark_sigma, odometry_noise_scale, landmark_noise_scale,
    robot_noise_scale : what parameters give every robot that has none of its own; the estimator
        reads those of each robot

    """

    robots: tuple[RobotSettings, ...]
    anchor: str
    anchor_pose: Triple = (0.0, 0.0, 0.0)
    anchor_sigma: Triple = (0.0, 0.0, 0.0)
    filter: str = 'fej'
    update_iterations: int = 0
    compressed: bool = True
    start_covariance: str = 'anchored'
    gate_probability: float = 0.999
    match_probability: float = 0.99
    inflate_rejected_scans: bool = False
    moved_landmarks: str = 'report'
    max_delay: float = 0.1
    stale_after: float = 1.0
    future_limit: float = 5.0
    clock_limit: float = 1.0
    on_time_jump: str = 'refuse'
    join_min_landmarks: int = 3
    join_probability: float = 0.99
    join_heading_sigma: float = 0.1
    shared_landmark_ids: bool = True
    prior_landmarks: str = ''
    relative_poses: tuple[str, ...] = ()
    unused_variance: float = 0.0
    map_period: float = 1.0
    publish_tf: bool = True
    output: str = ''
    checkpoint: str = ''
    autosave_period: float = 0.0
    restore: str = ''
    autostart: bool = True
    odometry_sigma: Triple = field(default=RobotSettings.odometry_sigma)
    landmark_sigma: tuple[float, float] = field(default=RobotSettings.landmark_sigma)
    odometry_noise_scale: float = 1.0
    landmark_noise_scale: float = 1.0
    robot_noise_scale: float = 1.0

    def relative_pairs(self) -> list[tuple[str, str]]:
        """Return seer and seen of each relative pose that is wanted."""
        pairs = (pair.partition(':') for pair in self.relative_poses)
        return [(observer, seen) for observer, _, seen in pairs]
