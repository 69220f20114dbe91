# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The smoother of one robot that exchanges its measurements with others, without a central node.

It grows the trajectory of its own robot as `TeamSmoother` does, and writes each used measurement
to a log. All other robots, and all maps, are those of the smoother of the union of all logs.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from operator import attrgetter

import numpy as np

from fej_slam_ros.core.csam.maps import landmark_index
from fej_slam_ros.core.csam.robot_trajectory import RobotTrajectory
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import SmoothedMap, SmoothedTrajectory
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Indices
from fej_slam_ros.core.ordering.record_memory import identity, RecordIdentity, RecordMemory
from fej_slam_ros.core.peers.blocks import MAX_STAMP
from fej_slam_ros.core.peers.logs import LogName
from fej_slam_ros.core.peers.rendezvous_window import contents, RendezvousResult
from fej_slam_ros.core.peers.team_logs import TeamLogs
from fej_slam_ros.core.peers.union import UnionTask
from fej_slam_ros.core.records import Odometry, Record, RobotScan, Scan
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.core.smoothing.newest_pose import NearMarginal

#: Reasons for which only the union rejects own observations, those of other robots.
UNION_REASONS = (RejectionReason.OTHER_ROBOT_STALE, RejectionReason.LOST_ROBOT)


class PeerSmoother(TeamSmoother):
    """
    Trajectory of one robot, and trajectories and maps of all robots of which it has logs.

    It begins with the own measurements that are in the logs already.

    """

    def __init__(
        self, settings: Settings, robot: str, logs: TeamLogs, solve_every: int
    ) -> None:
        own = tuple(member for member in settings.robots if member.name == robot)
        super().__init__(replace(settings, robots=own), solve_every)
        self.robot, self.logs = robot, logs
        self.robots = {member.name: member for member in settings.robots}
        #: result of the latest rendezvous with each robot
        self.rendezvous_results: dict[str, RendezvousResult] = {}
        self.observed: Counter[str] = Counter()  #: number of own observations of each robot
        self._team_settings = settings
        self._union: TeamSmoother | None = None
        self._robot_scans = RecordMemory()
        self._unreached: set[RecordIdentity] = set()  # own robot scans outside the odometry
        # Their arrival was limited by the parameters of then, which may have been others.
        for measurement in sorted(logs.contents(robot).measurements(), key=attrgetter('stamp')):
            self._use(measurement)
            for _ in self.take():
                pass

    def change_team(self, robots: Sequence[RobotSettings]) -> None:
        """Change the robots of the team; measurements of former ones stay in the union."""
        self.robots = {robot.name: robot for robot in robots}
        known = {robot.name: robot for robot in self._team_settings.robots} | self.robots
        self._team_settings = replace(self._team_settings, robots=tuple(known.values()))

    def add(self, record: Record, received: int | None = None) -> RejectionReason | None:
        """Add a record of the own robot; return the reason if it is rejected."""
        if not isinstance(record, (Odometry, Scan, RobotScan)):
            return super().add(record, received)
        if not 0 <= record.stamp <= MAX_STAMP:
            # No robot could read it in a block.
            self.statistics.received[record.robot] += 1
            return self.statistics.reject_record(record, RejectionReason.BAD_STAMP)
        reason = self._use(record, received)
        if reason is None:
            self.logs.record(record)
        return reason

    def union_task(self) -> UnionTask:
        """
        Return the task of smoothing all that is known.

        Own measurements that still wait here do not count yet: the trajectory is to continue from
        the solution with them.

        """
        self.new_poses = self.new_measurements = 0
        own = self.trajectories.get(self.robot)
        return UnionTask(
            self._team_settings,
            {robot: self.logs.contents(robot) for robot in self.logs.robots},
            dict(self.logs.noise), self._solve_every,
            {} if own is None else {self.robot: own.newest().stamp})

    def adopt_union(self, union: TeamSmoother) -> None:
        """Adopt a smoother of all that was known; later poses of the own robot follow from it."""
        own = self.trajectories.get(self.robot)
        self._union, self.solution = union, union.solution
        others = {
            name: trajectory for name, trajectory in union.trajectories.items()
            if name != self.robot}
        self.trajectories = ({} if own is None else {self.robot: own}) | others
        for name in others:
            self.statistics.take_over(name, union.statistics)
        for solved in union.solution.maps:
            if own is not None and self.robot in solved.trajectories:
                self._adopt_own(own, solved, union.trajectories[self.robot].stamps)

    def adopt_finally(self, union: TeamSmoother) -> None:
        """Adopt the smoother of everything at the end of the input."""
        self.adopt_union(union)
        self.trajectories = {**union.trajectories}
        # Until now, they might have waited for a log that was on its way.
        self._count_rejected_robots(union)
        self._count_unreached()

    def adopt_rendezvous(self, peer: str, result: RendezvousResult) -> None:
        """Adopt the result of a rendezvous, and let the other robot have the information."""
        self.rendezvous_results[peer] = result
        self.logs.publish(LogName(self.robot, peer), contents(result.message))

    def not_in_map(self) -> dict[str, str]:
        known = super().not_in_map() if self._union is None else self._union.not_in_map()
        in_map = {
            name for name, trajectory in self.trajectories.items() if trajectory.frame == MAP}
        reasons = known | {
            name: f'its parameter {parameter} differs from that of {self.robot}'
            for name, parameter in self.logs.differing.items()}
        return {
            name: reasons.get(name, 'nothing has been received from it')
            for name in self.robots if name not in in_map}

    def state_hash(self) -> str:
        return super().state_hash() if self._union is None else self._union.state_hash()

    def _adopt_own(
        self, own: RobotTrajectory, solved: SmoothedMap, stamps: Sequence[int]
    ) -> None:
        """Adopt the own trajectory in a map of the union, which has it at these stamps [ns]."""
        # The union has further poses, at which others have observed this robot.
        index = {stamp: k for k, stamp in enumerate(stamps)}
        known = takewhile(index.__contains__, own.stamps)
        rows = np.array([index[stamp] for stamp in known], np.intp)
        if len(rows):
            of_own = solved.trajectories[self.robot]
            is_last = rows[-1] == len(of_own.poses) - 1
            landmarks = self._landmarks_of(own, solved)
            near = (
                of_own.near.renumbered(of_own.landmarks, landmarks) if is_last
                else NearMarginal.of_pose(of_own.P[rows[-1]]))
            own.adopt(replace(solved, trajectories={self.robot: SmoothedTrajectory(
                of_own.poses[rows], of_own.P[rows], landmarks, near)}))

    def _landmarks_of(self, own: RobotTrajectory, solved: SmoothedMap) -> Indices:
        """Return the index in a map of each own landmark, up to the first that is not in it."""
        owner = '' if self.settings.shared_landmark_ids else self.robot
        index = landmark_index(solved.landmarks)
        keys = takewhile(index.__contains__, own.landmark_keys(owner))
        return np.array([index[key] for key in keys], np.intp)

    def _use(
        self, record: Odometry | Scan | RobotScan, received: int | None = None
    ) -> RejectionReason | None:
        """Add a measurement to the own trajectory, or remember an observation of a robot."""
        if not isinstance(record, RobotScan):
            return super().add(record, received)
        self.statistics.received[record.robot] += 1
        if record.robot != self.robot:
            return self.statistics.reject_record(record, RejectionReason.UNKNOWN_ROBOT)
        known = identity(record)
        if self.settings.is_future(record.stamp, received):
            return self.statistics.reject_record(record, RejectionReason.FUTURE)
        if self._robot_scans.contains(known):
            return self.statistics.reject_record(record, RejectionReason.DUPLICATE)
        if len(record.observations) > self.settings.max_observations:
            return self.statistics.reject_record(record, RejectionReason.TOO_LARGE)
        self._robot_scans.add(known)
        self.statistics.observations_used[record.robot] += len(record.observations)
        self.observed.update(o.observed for o in record.observations)
        self.new_measurements += len(record.observations)
        return None

    def _count_rejected_robots(self, union: TeamSmoother) -> None:
        """Count own observations of robots that a union rejects, in place of those before."""
        own = self.statistics.rejection_counts[self.robot]
        of_union = union.statistics.rejection_counts[self.robot]
        for reason in UNION_REASONS:
            self.statistics.observations_used[self.robot] += own[reason] - of_union[reason]
            own.pop(reason, None)
            if of_union[reason]:
                own[reason] = of_union[reason]

    def _count_unreached(self) -> None:
        """Count own robot scans from before the begin and after the end of the odometry, once."""
        first, last = self.sequencer.odometry_span(self.robot)
        for record in self.logs.contents(self.robot).measurements():
            if isinstance(record, RobotScan) and not first <= record.stamp <= last and (
                    (known := identity(record)) not in self._unreached):
                self._unreached.add(known)
                self.statistics.observations_used[self.robot] -= len(record.observations)
                self.statistics.reject_record(record, (
                    RejectionReason.BEFORE_ODOMETRY if record.stamp < first
                    else RejectionReason.AFTER_ODOMETRY))
