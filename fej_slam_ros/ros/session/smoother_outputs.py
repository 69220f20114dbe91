# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Smoothed trajectories and maps to messages on topics, for live topics and bags."""

from collections.abc import Callable, Iterator
from itertools import count

from fej_slam_ros.core.csam.robot_trajectory import RobotTrajectory
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import TeamMap
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.session.outputs import (
    cloud, DIAGNOSTICS_TOPIC, LANDMARKS_TOPIC, MapEstimate, markers, MARKERS_TOPIC, MAX_PATH,
    Publication, REJECTIONS_TOPIC, ROBOT_TYPES, thinned, TYPES)

#: Types of the topics of the node, and of each robot.
TEAM_TYPES = {
    topic: TYPES[topic]
    for topic in (LANDMARKS_TOPIC, MARKERS_TOPIC, REJECTIONS_TOPIC, DIAGNOSTICS_TOPIC)}
SMOOTHED_ROBOT_TYPES = ROBOT_TYPES | {'base_node': ROBOT_TYPES['pose']}


def smoothed_estimates(solution: TeamMap, shared_ids: bool) -> Iterator[MapEstimate]:
    """Yield the map of each frame; IDs are counted unless robots share them."""
    own_ids = count(1)
    for solved in solution.maps:
        keys = [tuple(sorted(names, key=_by_id)) for names in solved.landmarks]
        order = sorted(range(len(keys)), key=lambda k: _by_id(keys[k][0]))
        ids = [keys[k][0][1] if shared_ids else next(own_ids) for k in order]
        yield MapEstimate(
            solved.frame, ids, [keys[k] for k in order], solved.points[order], solved.P[order])


class SmootherOutputs:
    """
    Converts results of a smoother to messages.

    Parameters
    ----------
    team : whose results are published
    unused_variance : of z, roll and pitch in published covariances [m^2, rad^2]

    """

    def __init__(self, team: TeamSmoother, unused_variance: float) -> None:
        self._team = team
        self._unused_variance = unused_variance

    @property
    def topics(self) -> dict[str, str]:
        """Return the types of the published topics, by topic."""
        return TEAM_TYPES | {
            f'{name}/{kind}': type_name
            for name in self._team.robots for kind, type_name in SMOOTHED_ROBOT_TYPES.items()}

    def of_pose(self, estimate: PoseEstimate) -> Publication:
        """Return the message of a pose."""
        return f'{estimate.robot}/pose', outgoing.pose(estimate, self._unused_variance)

    def of_solution(self) -> Iterator[Publication]:
        """Yield the base nodes of the maps of a new solution."""
        for solved in self._team.solution.maps:
            for name, base in solved.base_nodes.items():
                estimate = PoseEstimate(name, self._stamp(), solved.frame, base.pose, base.P)
                yield f'{name}/base_node', outgoing.pose(estimate, self._unused_variance)

    def maps_and_paths(self, is_wanted: Callable[[str], bool]) -> Iterator[Publication]:
        """Yield maps, and paths and markers if wanted, as soon as there is a solution."""
        if not self._team.solution.maps:
            return
        trajectories = self._team.trajectories
        for name, trajectory in trajectories.items():
            if is_wanted(f'{name}/path'):
                yield f'{name}/path', outgoing.path(
                    trajectory.frame, thinned(_path(trajectory), MAX_PATH))
        topics = {MAP: LANDMARKS_TOPIC} | {
            own_frame(name): f'{name}/map_landmarks' for name in self._team.robots}
        shared_ids = self._team.settings.shared_landmark_ids
        maps = [*smoothed_estimates(self._team.solution, shared_ids)]
        for estimate in maps:
            yield topics[estimate.frame], cloud(self._stamp(), estimate)
        if is_wanted(MARKERS_TOPIC):
            yield MARKERS_TOPIC, markers(self._stamp(), [
                (index, trajectories[name].newest(), _path(trajectories[name]))
                for index, name in enumerate(self._team.robots) if name in trajectories
            ], maps)

    def _stamp(self) -> int:
        return max(trajectory.stamps[-1] for trajectory in self._team.trajectories.values())


def _path(trajectory: RobotTrajectory) -> list[tuple[int, Array]]:
    return [*zip(trajectory.stamps, trajectory.poses())]


def _by_id(key: LandmarkKey) -> tuple[int, str]:
    return key[1], key[0]
