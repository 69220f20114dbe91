# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The estimator: records in, finished steps out.

The live node, the replay of a bag, Monte Carlo runs and tests all drive this one object by the
same two calls: `add` a record, `take` the steps that are finished.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import combinations

import numpy as np

from fej_slam_ros.core.consistency import NisMonitor, PoseEvaluation
from fej_slam_ros.core.data_association.failure_detection import LostRobotDetector, MOVED_LANDMARKS
from fej_slam_ros.core.data_association.joint_compatibility import JointCompatibilityMatcher
from fej_slam_ros.core.data_association.landmark_manager import AssociatedScan, LandmarkManager
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, AROUND_ROBOTS, WHOLE_MAP
from fej_slam_ros.core.ekf.filter import Filter, Innovation, NO_INNOVATION
from fej_slam_ros.core.ekf.gating import Association, Gate, InflatingGate
from fej_slam_ros.core.ekf.linearization import LINEARIZATIONS as LINEARIZATIONS
from fej_slam_ros.core.ekf.relative_pose import relative_pose
from fej_slam_ros.core.ekf.state import JointState, Landmark, Robot, state_of_prior_map
from fej_slam_ros.core.ekf.state_hash import state_hash
from fej_slam_ros.core.estimates import PoseEstimate, StepResult
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import wrap
from fej_slam_ros.core.ground_truth import LocalTruth, RecordedTruth, Truth
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.joining.initial_alignment import InitialAlignmentError, InitialScans
from fej_slam_ros.core.joining.initialization import initialize, START_COVARIANCES
from fej_slam_ros.core.joining.map_joining import MapJoiner, WRONG_FROM
from fej_slam_ros.core.joining.rendezvous import (
    add_rendezvous_point, marginalize, rendezvous_keys_of)
from fej_slam_ros.core.ordering.pose_priors import PosePriors
from fej_slam_ros.core.ordering.sequencer import Sequencer
from fej_slam_ros.core.ordering.statistics import InputStatistics
from fej_slam_ros.core.records import (
    AnyScan, LandmarkKey, Motion, NO_ID, Odometry, PosePrior, PriorMap, Record, RendezvousKey,
    RobotScan, Scan, Step, TrueLandmarks)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import RobotSettings, Settings, Triple
from fej_slam_ros.errors import UserError

#: A motion that leaves the heading [rad] or the position [m] less certain than this, as after a
#: gap in the odometry, is no start for a linear update: the robot is located anew by what it sees.
LOST_HEADING_SIGMA = 0.3
LOST_POSITION_SIGMA = 1e3

#: How many iterations an update takes where the user does not say: one is the paper's; with three
#: the NEES / 3 of the invariant filter is 1.3 at high noise where with one it is 2.4.
DEFAULT_ITERATIONS = {'invariant': 3, 'fej': 1, 'standard': 1, 'ideal': 1}


class BrokenEstimateError(UserError):
    """The numbers of a step have left what can be computed with."""

    def __init__(self, stamp: int, what: str) -> None:
        super().__init__(
            f'the estimate broke down at {stamp} ns ({what}): look for covariances of the input'
            ' that are far too small or too large, and for odometry stamps that jump')


class Estimator:
    """
    A team of robots, from records to poses and a map.

    Parameters
    ----------
    settings : what the user chose, with the robots to begin with
    prior : landmarks that are known before, where there are any

    Attributes
    ----------
    robots : by name, in the order of processing
    team : the filter of all robots in ``map``
    groups : the filters of the others, by the robot whose own frame each is in; of one whose
        robots have all left, the map, until that robot comes back
    unlocated : for each robot that is not in ``map``, why
    ledger : what became of the input
    steps : how many steps each robot has had
    nis : normalised innovations squared of each robot
    log_likelihood : of all innovations, but for a constant
    lost : robots that are likely lost
    truth, evaluation : ground truth, where there is any, and how the poses compare
    relative_pairs : (observer, observed) of the relative poses in each result

    """

    def __init__(self, settings: Settings, prior: PriorMap | None = None) -> None:
        self.settings = settings
        self.relative_pairs: Sequence[tuple[str, str]] = ()
        self.statistics = InputStatistics()
        self.truth = RecordedTruth()
        self.evaluation = PoseEvaluation(self.truth)
        self.team = self._new_filter(self.truth)
        if prior is not None:
            self.team.state = state_of_prior_map(prior)
        self.groups: dict[str, Filter] = {}
        self.steps: Counter[str] = Counter()
        self.nis: dict[str, NisMonitor] = {}
        self.log_likelihood = 0.0
        self.lost = LostRobotDetector()
        self.not_in_map: dict[str, str] = {}
        # Without an anchor there is no step 0.
        self.started = not settings.anchor
        self.robots: dict[str, RobotSettings] = {}
        self._sequencer = Sequencer(settings, self.statistics)
        self._given = PosePriors()
        self._without_start: set[str] = set()
        self._matcher = JointCompatibilityMatcher(settings.match_probability)
        self.landmark_manager = LandmarkManager(min([NO_ID, *(() if prior is None else prior.ids)]))
        self._joiner = MapJoiner(
            settings.join_min_landmarks, settings.join_probability, settings.join_heading_sigma)
        self.change_team(settings.robots)

    @property
    def needs_ids(self) -> bool:
        """Return whether an observation without identity is of no use: the truth knows numbers."""
        return self.settings.filter == 'ideal'

    def change_team(self, robots: Sequence[RobotSettings]) -> None:
        """
        Let robots come and leave, from now on.

        Who leaves is marginalised out of the joint state, and what it has mapped stays. Who comes
        back starts at an unknown place, whatever was known of its first start.

        Parameters
        ----------
        robots : those that are here from now on, in the order of processing

        """
        before, self.robots = self.robots, {robot.name: robot for robot in robots}
        for name in before:
            if name not in self.robots:
                self._dismiss(name)
        for name in self.robots:
            if name not in before:
                self.nis.setdefault(name, NisMonitor())
                self.not_in_map[name] = 'it sent no odometry'
        self._sequencer.change_team(robots)

    def may_leave(self, robot: str) -> bool:
        """Return whether the others can do without a robot: not before the anchor's start."""
        return self.started or robot != self.settings.anchor

    def add(self, record: Record, received: int | None = None) -> bool:
        """
        Take in a record, and return whether odometry or a scan was not refused at once.

        Parameters
        ----------
        record : what was measured
        received : when it was received [ns], on the clock that its stamp is of; None to trust it

        """
        if isinstance(record, TrueLandmarks):
            self.truth.add(record)
            return True
        self.statistics.received[record.robot] += 1
        if isinstance(record, (Odometry, Scan, RobotScan)):
            return self._sequencer.add(record, received)
        if record.robot not in self.robots:
            self.statistics.reject(Rejection(record.robot, record.stamp, RejectionReason.UNKNOWN_ROBOT))
        elif isinstance(record, PosePrior):
            rejected = self._given.add(record)
            if rejected is not None:
                self.statistics.reject(rejected)
        else:
            self.truth.add(record)
            for stamp in self.truth.take_surplus(record.robot):
                self.statistics.reject(Rejection(record.robot, stamp, RejectionReason.AFTER_ODOMETRY))
        return True

    def run(self, records: Iterable[Record]) -> Iterator[StepResult]:
        """Take in all records, with which the input ends; yield each step when it is finished."""
        for record in records:
            self.add(record)
            yield from self.take()
        yield from self.close()

    def take(self) -> Iterator[StepResult]:
        """Yield the steps that are finished."""
        return map(self._checked_step, self._sequencer.take())

    def release(self) -> Iterator[StepResult]:
        """Yield all steps that can be made of the input so far, without waiting for more."""
        return map(self._checked_step, self._sequencer.release())

    def close(self) -> Iterator[StepResult]:
        """Yield the last steps: the input has ended."""
        yield from self.release()
        self._sequencer.close()

    def resume(self) -> None:
        """Go on from a checkpoint, from which on all input may be sent again."""
        self._sequencer.resume()

    def used(self, robot: str) -> int:
        """Return how many messages of a robot have been used."""
        waiting = self._sequencer.waiting(robot)
        return self.statistics.received[robot] - self.statistics.rejected[robot] - waiting

    def filter_of(self, robot: str) -> Filter:
        """Return the filter that a robot is in."""
        return next(
            filter_ for filter_ in (self.team, *self.groups.values())
            if robot in filter_.state.robots)

    def frames(self) -> dict[str, JointState]:
        """Return all joint states by their frames, ``map`` first."""
        own = {own_frame(name): group.state for name, group in self.groups.items()}
        return {MAP: self.team.state, **own}

    def moved_landmarks(self) -> list[LandmarkKey]:
        """Return the landmarks that are in a map although they were moved."""
        return sorted({
            landmark.key for state in self.frames().values()
            for landmark in state.landmarks.values() if landmark.was_moved()})

    def state_hash(self) -> str:
        """Return SHA-256 over all that is estimated; equal for equal input, on one machine."""
        return state_hash(self.frames(), list(self.robots))

    def _dismiss(self, name: str) -> None:
        """Take a robot out of the joint state that it is in."""
        for given in self._given.leave(name):
            self.statistics.reject(Rejection(name, given.stamp, RejectionReason.LEFT))
        self._forget_places(name)
        for state in self.frames().values():
            if name in state.robots:
                state.remove(state.robots[name])
                self._without_start.add(name)
        if name in self.groups:
            self._name_group(name)
        self.not_in_map.pop(name, None)
        self.lost.forget(name)

    def _checked_step(self, step: Step) -> StepResult:
        try:
            result = self._step(step)
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            raise BrokenEstimateError(step.stamp, str(error)) from error
        if not all(np.isfinite(pose.P).all() for pose in result.poses):
            raise BrokenEstimateError(step.stamp, 'covariance not finite')
        return result

    def _step(self, step: Step) -> StepResult:
        """Let one stamp happen: predict, start landmarks, update."""
        for name in step.arrivals:
            self._arrive(self.robots[name], step.stamp)
        for motion in step.motions:
            if _tells_no_place(motion):
                self._begin_anew(motion.robot, step.stamp)
            else:
                self.filter_of(motion.robot).predict(motion)
        aligned = self._is_step_0(step) and self._start(step)
        for robot_scan in step.robot_scans:
            self._meet(robot_scan)
        numbered = [
            scan for group in (self.team, *self.groups.values())
            for scan in self._observe(group, step, aligned and group is self.team)]
        scans: list[AnyScan] = [*step.scans, *step.robot_scans]
        for scan in scans:
            self.statistics.observations_used[scan.robot] += len(scan.observations)
        # Odometry alone tells nothing of how frames lie.
        if scans:
            self._join()
        for motion in step.motions:
            self._locate(motion.robot, step.stamp)
        self.truth.keep_rendezvous_points({key for state in self.frames().values() for key in state.rendezvous_points})
        return self._result(step, numbered)

    def _arrive(self, robot: RobotSettings, stamp: int) -> None:
        """Take in a robot at its first odometry: in ``map`` if its start is known."""
        known = self._known_start(robot)
        if known is not None:
            pose, sigma = known
            x, y, phi = pose
            self.team.state.insert_robot(
                robot.name, stamp, np.array([x, y, wrap(phi)]), np.diag(np.square(sigma)))
            self.not_in_map.pop(robot.name, None)
        else:
            self._begin_frame(robot.name, stamp)

    def _begin_frame(self, name: str, stamp: int) -> None:
        """Let a robot begin in a frame of its own."""
        alone = self._new_filter(LocalTruth(self.truth, name, stamp))
        alone.state.insert_robot(name, stamp, np.zeros(3), np.zeros((3, 3)))
        if name in self.groups:
            # What it has mapped in its last frame may join by itself.
            self._give_up(f'{name}/before')
            self.groups[f'{name}/before'] = self.groups.pop(name)
        self.groups[name] = alone
        self.not_in_map[name] = f'the anchor {self.settings.anchor} has seen no landmark'

    def _begin_anew(self, name: str, stamp: int) -> None:
        """Let a robot begin anew where nothing tells how it came."""
        self._forget_places(name)
        state = self.filter_of(name).state
        state.remove(state.robots[name])
        if name in self.groups:
            self._name_group(name)
        # An anchor that has seen nothing yet may as well begin ``map`` here, but not where others
        # have joined it: then there is no step 0.
        if name == self.settings.anchor and name in self._without_start:
            self.started = True
        if self.may_leave(name):
            self._without_start.add(name)
        self.statistics.relocalized[name] += 1
        self._arrive(self.robots[name], stamp)

    def _known_start(self, robot: RobotSettings) -> tuple[Triple, Triple] | None:
        if robot.name in self._without_start:
            return None
        if robot.name == self.settings.anchor:
            return self.settings.anchor_pose, self.settings.anchor_sigma
        if robot.start_pose is not None:
            return robot.start_pose, robot.start_sigma
        return None

    def _is_step_0(self, step: Step) -> bool:
        """Return whether the anchor sees its first landmark."""
        return not self.started and any(
            scan.robot == self.settings.anchor and scan.observations for scan in step.scans)

    def _start(self, step: Step) -> bool:
        """Bring all robots that step 0 determines into ``map``; return whether it took any."""
        self.started = True
        seen: InitialScans = {
            scan.robot: [
                (self.team.landmark_key(scan.robot, observation.id), observation)
                for observation in scan.observations if observation.id != NO_ID]
            for scan in step.scans}
        try:
            state = initialize(
                self.team.state, self.settings.anchor, seen, step.stamp, self.team.linearization,
                START_COVARIANCES[self.settings.start_covariance])
        except InitialAlignmentError:
            return False
        if state is not None:
            marginalize(self.team.state.rendezvous_points, (group.state for group in self.groups.values()))
            self.team.state = state
        for name, group in list(self.groups.items()):
            if name in self.team.state.robots.keys() & group.state.robots.keys():
                self._bring_group(name, name)
        return state is not None

    def _observe(self, group: Filter, step: Step, aligned: bool) -> list[Scan]:
        """
        Let a group see; return what nobody had numbered in its scans, numbered.

        Parameters
        ----------
        group : whose robots see
        step : what they see
        aligned : whether the observations with numbers have told how the group began

        """
        scans, seen = self._identified(group, step.scans, aligned)
        innovation = group.update([*seen, *group.associate_robots(step.robot_scans)])
        if innovation is not NO_INNOVATION:
            self._account(group.state, step.stamp, innovation)
        for scan in scans:
            self.landmark_manager.judge(group, scan)
        return [named.numbered for named in scans if named.numbered.observations]

    def _identified(
        self, group: Filter, scans: Iterable[Scan], aligned: bool
    ) -> tuple[list[AssociatedScan], list[Association]]:
        """Return scans of a group, all numbered, and what is left of them for the update."""
        named, left = [], []
        for scan in scans:
            if scan.robot in group.state.robots:
                known = self.landmark_manager.named(group, self._matcher, scan)
                for observation in known.doubtful:
                    self.statistics.observations_used[scan.robot] -= 1
                    self.statistics.reject(Rejection(
                        scan.robot, scan.stamp, RejectionReason.DOUBTFUL_MATCH, id=observation.id))
                told = group.start_landmarks([known.given])
                left += [] if aligned else told
                left += group.start_landmarks([known.numbered])
                named.append(known)
        return named, left

    def _meet(self, scan: RobotScan) -> None:
        """Keep where robots of other frames are seen, until that tells how the frames lie."""
        observer = self.filter_of(scan.robot)
        for observation in scan.observations:
            name, seen = observation.seen, self.filter_of(observation.seen)
            key = RendezvousKey(scan.robot, name, scan.stamp)
            if seen is not observer and not add_rendezvous_point(observer, seen, key, observation):
                self.statistics.observations_used[scan.robot] -= 1
                self.statistics.reject(Rejection(
                    scan.robot, scan.stamp, RejectionReason.NOT_JOINED, id=self.robots[name].id,
                    seen=name))

    def _forget_places(self, robot: str) -> None:
        states = self.frames().values()
        marginalize(rendezvous_keys_of(robot, states), states)

    def _join(self) -> None:
        """Bring groups together that share enough: into ``map`` first, then with each other."""
        for name, group in list(self.groups.items()):
            met = group.state.rendezvous_points.keys() & self.team.state.rendezvous_points.keys()
            # What landmarks say of how all began is for step 0 to use.
            if not (self.started or met):
                continue
            rejected = self._joiner.join(self.team, group)
            if rejected is None:
                self._leave_group(name)
                self.landmark_manager.unite(self.team, name)
            else:
                self.not_in_map.update(dict.fromkeys(group.state.robots, rejected.reason))
                self._forget_wrong(rejected)
        for name, other in combinations(tuple(self.groups) if self.started else (), 2):
            if {name, other} <= self.groups.keys():
                rejected = self._joiner.join(self.groups[name], self.groups[other])
                if rejected is None:
                    del self.groups[other]
                    self.landmark_manager.unite(self.groups[name], other)
                    self._name_group(name)
                else:
                    self._forget_wrong(rejected)

    def _forget_wrong(self, rejected: JoinFailure) -> None:
        """Forget the place that all else contradicts, so that frames may join without it."""
        key = rejected.outlier
        if key is not None:
            marginalize([key], self.frames().values())
            self.statistics.observations_used[key.observer] -= 1
            self.statistics.reject(Rejection(
                key.observer, key.stamp, RejectionReason.GATED, id=self.robots[key.seen].id, seen=key.seen,
                d2=rejected.d2, threshold=WRONG_FROM))

    def _locate(self, name: str, stamp: int) -> None:
        """Bring a robot to the pose that it was given, at its first step from then on."""
        for given in self._given.take(name, stamp):
            group = self.filter_of(name)
            if group is self.team:
                self.statistics.reject(Rejection(name, given.stamp, RejectionReason.ALREADY_LOCATED))
            elif self._joiner.locate(self.team, group, name, given.pose, given.P):
                owner = next(n for n, other in self.groups.items() if other is group)
                self._bring_group(owner, name)
            else:
                self.statistics.reject(Rejection(name, given.stamp, RejectionReason.DOES_NOT_FIT))

    def _bring_group(self, owner: str, name: str) -> None:
        """Let a robot that is in ``map`` now bring what it and its group have mapped."""
        if self._joiner.bring(self.team, self.groups[owner], name):
            self._leave_group(owner)
            self.landmark_manager.unite(self.team, name)
        else:
            self._be_joined([name])
            self._name_group(owner)

    def _name_group(self, owner: str) -> None:
        """Call a group, and its frame, after a robot that is in it; give up an empty one."""
        state = self.groups[owner].state
        if state.robots and owner not in state.robots:
            self.groups[next(iter(state.robots))] = self.groups.pop(owner)
        elif not (state.robots or state.landmarks):
            self._give_up(owner)

    def _give_up(self, owner: str) -> None:
        """Let a group go that no robot is in, if it is there."""
        group = self.groups.pop(owner, None)
        if group is not None:
            marginalize([*group.state.rendezvous_points], self.frames().values())

    def _leave_group(self, owner: str) -> None:
        """Let the robots of a group be part of the team."""
        self._be_joined(self.groups.pop(owner).state.robots)

    def _be_joined(self, robots: Iterable[str]) -> None:
        """Take note that robots are in ``map``: an anchor that is lost begins it no more."""
        for robot in robots:
            del self.not_in_map[robot]
        self._without_start.add(self.settings.anchor)

    def _account(self, state: JointState, stamp: int, innovation: Innovation) -> None:
        for name, values in innovation.nis().items():
            self.nis[name].add(stamp, values)
        self.log_likelihood += innovation.log_likelihood()
        self.lost.add(innovation.scan_gate_statistics())
        MOVED_LANDMARKS[self.settings.moved_landmarks](state, innovation)
        for inflated in innovation.inflated:
            self.statistics.observations_inflated[inflated.association.observer.name] += 1
        for gated in innovation.rejected:
            robot = gated.association.observer.name
            seen = gated.association.observed
            was_moved = isinstance(seen, Landmark) and seen.was_moved()
            number, seen_robot = self._named(seen)
            self.statistics.observations_used[robot] -= 1
            self.statistics.reject(Rejection(
                robot, stamp, RejectionReason.MOVED_LANDMARK if was_moved else RejectionReason.GATED,
                id=number, d2=gated.d2, threshold=gated.threshold, seen=seen_robot))

    def _named(self, seen: Landmark | Robot) -> tuple[int, str | None]:
        """Return the number that users know something by, and the name where it is a robot."""
        if isinstance(seen, Robot):
            return self.robots[seen.name].id, seen.name
        return seen.key[1], None

    def _result(self, step: Step, numbered: Sequence[Scan]) -> StepResult:
        here = step.odometry.keys()
        poses = tuple(self._pose(name, step.stamp) for name in self.robots if name in here)
        self.steps.update(here)
        for pose in poses:
            if pose.frame == MAP:
                self.evaluation.add(pose.robot, pose.stamp, pose.pose, pose.P)
            else:
                self.truth.forget_before(pose.robot, pose.stamp)
        state = self.team.state
        joined = [state.robots[name] for name in self.robots if name in state.robots]
        relative = tuple(
            relative_pose(state, observer, seen) for observer, seen in self.relative_pairs
            if {observer, seen} <= state.robots.keys() and {observer, seen} & here)
        return StepResult(
            step.stamp, poses, tuple((robot.name, robot.stamp) for robot in joined),
            partial(state.marginal, joined), relative, step.odometry, numbered)

    def _pose(self, name: str, stamp: int) -> PoseEstimate:
        frame, state = next(
            (frame, state) for frame, state in self.frames().items() if name in state.robots)
        robot = state.robots[name]
        return PoseEstimate(name, stamp, frame, state.estimate(robot), state.marginal([robot]))

    def _new_filter(self, truth: Truth) -> Filter:
        gate = InflatingGate if self.settings.inflate_rejected_scans else Gate
        return Filter(
            JointState(), LINEARIZATIONS[self.settings.filter](truth),
            gate(self.settings.gate_probability), self.settings.shared_landmark_ids,
            self.settings.update_iterations or DEFAULT_ITERATIONS[self.settings.filter],
            self._regions())

    def _regions(self) -> ActiveSubmap:
        # An update of the invariant filter moves all that a robot owns, wherever that is.
        if self.settings.filter == 'invariant' or not self.settings.compressed:
            return WHOLE_MAP
        return AROUND_ROBOTS


def _tells_no_place(motion: Motion) -> bool:
    """Return whether a robot may be anywhere, or face anywhere, after a motion."""
    x, y, phi = motion.Q.diagonal().tolist()
    told = max(x, y) <= LOST_POSITION_SIGMA ** 2 and phi <= LOST_HEADING_SIGMA ** 2
    return not told


