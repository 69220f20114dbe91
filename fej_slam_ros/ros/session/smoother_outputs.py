# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From the smoother to messages on topics, the same way for live topics and bags."""

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
    cloud, DIAGNOSTICS, LANDMARKS, MapEstimate, MARKERS, markers, MAX_PATH, Publication,
    REJECTIONS, ROBOT_TYPES, thinned, TYPES)

#: What is published of the team, and of each robot.
TEAM_TYPES = {topic: TYPES[topic] for topic in (LANDMARKS, MARKERS, REJECTIONS, DIAGNOSTICS)}
MEMBER_TYPES = ROBOT_TYPES | {'base_node': ROBOT_TYPES['pose']}


def smoothed_estimates(solution: TeamMap, shared_ids: bool) -> Iterator[MapEstimate]:
    """Yield the map of each frame; where ids are each robot's own, count them."""
    places = count(1)
    for solved in solution.maps:
        keys = [tuple(sorted(names, key=_by_id)) for names in solved.landmarks]
        order = sorted(range(len(keys)), key=lambda k: _by_id(keys[k][0]))
        ids = [keys[k][0][1] if shared_ids else next(places) for k in order]
        yield MapEstimate(
            solved.frame, ids, [keys[k] for k in order], solved.points[order], solved.P[order])


class SmootherOutputs:
    """
    What is told to the world.

    Parameters
    ----------
    team : what is told of
    unused_variance : of z, roll and pitch in published covariances [m^2, rad^2]

    """

    def __init__(self, team: TeamSmoother, unused_variance: float) -> None:
        self._team = team
        self._unused_variance = unused_variance

    @property
    def topics(self) -> dict[str, str]:
        """Return what is published, the type name by topic."""
        return TEAM_TYPES | {
            f'{name}/{kind}': type_name
            for name in self._team.robots for kind, type_name in MEMBER_TYPES.items()}

    def of_pose(self, estimate: PoseEstimate) -> Publication:
        """Return what is published of a pose."""
        return f'{estimate.robot}/pose', outgoing.pose(estimate, self._unused_variance)

    def of_solution(self) -> Iterator[Publication]:
        """Yield what is published after each solution."""
        for solved in self._team.solution.maps:
            for name, base in solved.base_nodes.items():
                told = PoseEstimate(name, self._stamp(), solved.frame, base.pose, base.P)
                yield f'{name}/base_node', outgoing.pose(told, self._unused_variance)

    def overview(self, is_wanted: Callable[[str], bool]) -> Iterator[Publication]:
        """Yield paths and maps since the first solution, as far as they are wanted."""
        if not self._team.solution.maps:
            return
        ways = self._team.trajectories
        for name, way in ways.items():
            if is_wanted(f'{name}/path'):
                yield f'{name}/path', outgoing.path(way.frame, thinned(_path(way), MAX_PATH))
        topics = {MAP: LANDMARKS} | {
            own_frame(name): f'{name}/map_landmarks' for name in self._team.robots}
        shared_ids = self._team.settings.shared_landmark_ids
        maps = [*smoothed_estimates(self._team.solution, shared_ids)]
        for estimate in maps:
            yield topics[estimate.frame], cloud(self._stamp(), estimate)
        if is_wanted(MARKERS):
            yield MARKERS, markers(self._stamp(), [
                (place, ways[name].newest(), _path(ways[name]))
                for place, name in enumerate(self._team.robots) if name in ways
            ], maps)

    def _stamp(self) -> int:
        return max(way.stamps[-1] for way in self._team.trajectories.values())


def _path(way: RobotTrajectory) -> list[tuple[int, Array]]:
    return [*zip(way.stamps, way.poses())]


def _by_id(key: LandmarkKey) -> tuple[int, str]:
    return key[1], key[0]
