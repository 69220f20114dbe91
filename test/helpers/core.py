# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shared by tests of the core: differences, small teams, a recording covariance, simulations."""

from dataclasses import replace
from functools import reduce

import numpy as np

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import FirstEstimates, Ideal, Invariant, Standard
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import (
    Motion, Observation, RobotObservation, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.sensors import measure
from fej_slam_ros.sim.world import make_world


def turn(phi):
    """Return the rotation matrix by phi, written out once more for the tests."""
    return np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])


def random_covariance(rng, size):
    A = rng.normal(size=(size, size + 2))
    return A @ A.T / size


def quarter_turn(vector):
    """Return the vector turned by 90 degrees to the left."""
    return np.array([-vector[1], vector[0]])


def wrapped(angle):
    """Return the angle in (-pi, pi], by another formula than the package's."""
    return np.arctan2(np.sin(angle), np.cos(angle))


def pose_difference(a, b):
    """Return a - b of poses (..., 3), the heading wrapped."""
    difference = a - b
    difference[..., 2] = wrapped(difference[..., 2])
    return difference


def central_differences(function, x, difference=np.subtract, step=1e-5):
    """
    Return the Jacobian of a function at x; where it is smooth and of order 1, right to 1e-9.

    The error of a central difference is step^2 of the third derivative plus rounding / step.
    """
    columns = [
        difference(function(x + nudge), function(x - nudge)) / (2.0 * step)
        for nudge in step * np.eye(len(x))]
    return np.stack(columns, axis=-1)


def moments(function, mean, sigma):
    """
    Return mean and covariance of a function of independent normal variables.

    Gauss-Hermite quadrature with 40 nodes is exact to rounding for sines of up to a radian.
    """
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    grid = [m + s * nodes for m, s in zip(mean, sigma)]
    values = function(*np.meshgrid(*grid, indexing='ij')).reshape(-1, nodes.size ** len(grid))
    w = reduce(np.kron, [weights / weights.sum()] * len(grid))
    errors = values - (values @ w)[:, None]
    return values @ w, w * errors @ errors.T


def make_policy(kind, truth):
    """Return the linearisation policy of a kind of filter."""
    policies = {
        'standard': Standard, 'fej': FirstEstimates, 'ideal': lambda: Ideal(truth),
        'invariant': Invariant}
    return policies[kind]()


class SmallTeam:
    """
    Robots that drive at random among landmarks and measure with noise.

    Parameters
    ----------
    seed : of the world and of all noise
    robots, landmarks : their numbers
    noise : ratio of true errors to their stated standard deviations
    meeting : whether robots that observe landmarks also observe other robots

    Attributes
    ----------
    names : of the robots
    truth : their poses at all stamps so far, and the landmarks
    P, Q, R : covariances of a start, a motion and an observation

    """

    def __init__(self, seed, robots=2, landmarks=2, noise=1.0, meeting=False):
        self._rng = np.random.default_rng(seed)
        self._noise = noise
        self._meeting = meeting
        self.names = [f'r{i + 1}' for i in range(robots)]
        self.truth = RecordedTruth()
        self.truth.add(TrueLandmarks({i: self._rng.uniform(-8, 8, 2) for i in range(landmarks)}))
        for name in self.names:
            pose = self._rng.uniform([-5.0, -5.0, -3.0], [5.0, 5.0, 3.0])
            self.truth.add(TruePose(name, 0, pose))
        # Longer than wide and correlated: turning them the wrong way makes a difference.
        self.P = np.array([[0.04, 0.01, 0.0], [0.01, 0.02, 0.005], [0.0, 0.005, 0.01]])
        self.Q = np.array([[0.02, 0.004, 0.0], [0.004, 0.005, 0.001], [0.0, 0.001, 0.0025]])
        self.R = np.array([[0.04, 0.01], [0.01, 0.01]])

    def start(self, kind, covariance=None, iterations=1):
        """Return a filter with uncertain initial poses of all robots at stamp 0."""
        state = JointState()
        state.covariance = covariance or Covariance()
        for name in self.names:
            error = self._noise * self._rng.multivariate_normal(np.zeros(3), self.P)
            state.insert_robot(name, 0, self.truth.pose(name, 0) + error, self.P)
        return Filter(
            state, make_policy(kind, self.truth), Gate(1.0), iterations=iterations)

    def drive(self, name, stamp):
        """Move a robot from its last pose to a stamp; return the measured motion."""
        x = self.truth.pose(name, self.truth.newest(name))
        u = self._rng.normal([1.0, 0.0, 0.3], [0.3, 0.2, 0.3])
        p = x[:2] + turn(x[2]) @ u[:2]
        self.truth.add(TruePose(name, stamp, np.array([*p, wrapped(x[2] + u[2])])))
        error = self._noise * self._rng.multivariate_normal(np.zeros(3), self.Q)
        return Motion(name, stamp, u + error, self.Q)

    def look(self, name, numbers=None):
        """Return the scan of a robot at its newest pose: all landmarks or those of some IDs."""
        stamp = self.truth.newest(name)
        observations = [
            Observation(number, self._observe(name, point), self.R)
            for number, point in self.truth.landmarks.items()
            if numbers is None or number in numbers]
        return Scan(name, stamp, tuple(observations))

    def look_for_robots(self, name):
        """Return the observations of all other robots at their newest poses."""
        others = [other for other in self.names if other != name]
        observations = [
            RobotObservation(
                other, self._observe(name, self.truth.pose(other, self.truth.newest(other))[:2]),
                self.R)
            for other in others]
        return RobotScan(name, self.truth.newest(name), tuple(observations))

    def measured(self, stamp, moving, looking):
        """Let some robots move and some observe; return the arguments of one filter step."""
        motions = [self.drive(name, stamp) for name in moving]
        scans = [self.look(name) for name in looking]
        return motions, scans, [self.look_for_robots(name) for name in looking if self._meeting]

    def step(self, filter_, stamp, moving, looking):
        """Run a filter step on the result of `measured`."""
        return filter_.step(*self.measured(stamp, moving, looking))

    def _observe(self, name, point):
        x = self.truth.pose(name, self.truth.newest(name))
        return turn(x[2]).T @ (point - x[:2]) + self._observation_error()

    def _observation_error(self):
        return self._noise * self._rng.multivariate_normal(np.zeros(2), self.R)


class Witness(Covariance):
    """
    A covariance that records the dense matrix of every change by a filter.

    Attributes
    ----------
    events : ('error', A) of every change that maps the joint error to A times it, and
        ('seen', H) of every update, in order

    """

    def __init__(self):
        super().__init__()
        self.events = []

    def propagate(self, slot, Phi, N):
        """Keep Phi."""
        A = np.eye(self.dimension)
        A[np.ix_(slot.indices, slot.indices)] = Phi
        self.events.append(('error', A))
        super().propagate(slot, Phi, N)

    def project(self, H, R):
        """Store H: the gate may reject it, and the next iteration has another."""
        self._proposed = dense(H, self.dimension)
        return super().project(H, R)

    def condition(self, correction):
        """Keep the last H."""
        self.events.append(('seen', self._proposed))
        super().condition(correction)

    def transport(self, A):
        """Keep A."""
        matrix = np.eye(self.dimension)
        matrix[:, A.columns] += A.V
        self.events.append(('error', matrix))
        super().transport(A)


def dense(H, n):
    """Return the dense matrix (2 m, n) of sparse rows."""
    matrix = np.zeros((2 * len(H.columns), n))
    for k, (columns, block) in enumerate(zip(H.columns, H.blocks)):
        for column, entries in zip(columns, block.T):
            matrix[2 * k:2 * k + 2, column] += entries
    return matrix


def circles(seed, robots=2, landmarks=12, loops=1, sensors=None):
    """Return the records of a run in the first environment of [Liu]."""
    environment = ENVIRONMENTS['circles']
    rng = np.random.default_rng(seed)
    names = tuple(f'r{i + 1}' for i in range(robots))
    settings = replace(environment.world, robots=names, landmarks=landmarks, loops=loops)
    return list(measure(make_world(settings, rng), sensors or environment.sensors, rng))


def estimate(records, robots=('r1', 'r2'), **settings):
    """Return an estimator that has processed the records, and the results of its steps."""
    team = tuple(
        robot if isinstance(robot, RobotSettings) else RobotSettings(robot, number)
        for number, robot in enumerate(robots, start=1))
    estimator = Estimator(Settings(team, **{'anchor': 'r1', **settings}))
    for record in records:
        estimator.add(record)
    return estimator, list(estimator.close())


def whole_state(estimator):
    """Return the estimate and the covariance of the team, ordered by name and ID."""
    state = estimator.groups.team.state
    robots = [state.robots[name] for name in sorted(state.robots)]
    landmarks = [state.landmarks[key] for key in sorted(state.landmarks)]
    poses = np.array([state.estimate(robot) for robot in robots])
    points = np.array([state.estimate(landmark) for landmark in landmarks])
    return poses, points, state.marginal([*robots, *landmarks])


def bits(results):
    """Return all bits of the poses in results of an estimator."""
    return [
        (pose.robot, pose.stamp, pose.frame, pose.pose.tobytes(), pose.P.tobytes())
        for result in results for pose in result.poses]


def unknown_place(state, x, sigma):
    """Return the joint covariance if only the common position and heading were unknown."""
    N = np.zeros((len(x), 3))
    for variable in state.variables():
        place = variable.slot.indices
        N[place[:2], :2], N[place[:2], 2] = np.eye(2), quarter_turn(x[place[:2]])
        N[place[2:], 2] = 1.0
    return N @ np.diag(np.square(sigma)) @ N.T


def frames(estimator):
    """Return the joint states of an estimator by the names of their frames."""
    return {group.frame: group.state for group in estimator.groups}
