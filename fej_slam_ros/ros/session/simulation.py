# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated run from parameters, for the simulator node and for bags."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from fej_slam_ros.core.records import Record
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters import checked, description, load_values, Parameter, robot_names
from fej_slam_ros.ros.parameters.kinds import (
    FLAG, Kind, NAMES, one_of, POINT_SIGMA, POSE, POSE_SIGMA)
from fej_slam_ros.sim.environments import ALL_ENVIRONMENTS, AnyEnvironment
from fej_slam_ros.sim.world import World

POSITIVE = Kind('a number from 1e-3 to 1e6', float, allowed=lambda x: 1e-3 <= x <= 1e6)
AT_LEAST_ONE = Kind('an integer, 1 or above', int, allowed=lambda n: n >= 1)
SIGMAS = Kind('three numbers from 1e-6 to 1e6', float, (3,), lambda x: 1e-6 <= x <= 1e6)
POLAR_SIGMA = replace(SIGMAS, expected='two numbers from 1e-6 to 1e6', shape=(2,))
LENGTHS = Kind('two numbers from 1e-3 to 1e6', float, (2,), POSITIVE.allowed)
FRACTION = Kind('a number from 0 to 0.9', float, allowed=lambda x: 0.0 <= x <= 0.9)
SEED = Kind('an integer, 0 or above', int, allowed=lambda n: n >= 0)
OF_ENVIRONMENT = 'that of the environment'

PARAMETERS = {
    parameter.name: parameter for parameter in (
        Parameter(
            'environment', one_of(list(ALL_ENVIRONMENTS)), 'how the robots drive', '', 'circles'),
        Parameter('robots', NAMES, 'their names', '', '[r1, r2], or [p, q] that meet'),
        Parameter('landmarks', AT_LEAST_ONE, 'how many landmarks there are', '', '60'),
        Parameter('loops', AT_LEAST_ONE, 'how often each robot drives its loop', '', '5'),
        Parameter('steps_per_loop', AT_LEAST_ONE, 'steps of a loop', '', OF_ENVIRONMENT),
        Parameter(
            'loop_lengths', LENGTHS, 'loops of robots 1, 3, ... and 2, 4, ...', 'm',
            OF_ENVIRONMENT),
        Parameter('rate', POSITIVE, 'steps in a second of simulated time', 'Hz', '5.0'),
        Parameter('start', POSE, 'start of the first robot in map', 'm, m, rad', '[0, 0, 0]'),
        Parameter(
            'odometry_sigma', POSE_SIGMA, 'standard deviations of the odometry of one step',
            'm, m, rad', OF_ENVIRONMENT),
        Parameter(
            'landmark_sigma', POINT_SIGMA, 'standard deviations of an observation', 'm',
            OF_ENVIRONMENT),
        Parameter(
            'robot_sigma', POINT_SIGMA, 'standard deviations of an observation of another robot', 'm',
            'robots of the circles and of the figure eight do not look for each other'),
        Parameter(
            'driving_sigma', SIGMAS, 'standard deviations of the speeds of the first of the two',
            'm/s, m/s, rad/s', OF_ENVIRONMENT),
        Parameter(
            'polar_sigma', POLAR_SIGMA, 'standard deviations of range and bearing where two meet',
            'm, rad', OF_ENVIRONMENT),
        Parameter('range', POSITIVE, 'how far a landmark or robot is seen', 'm', OF_ENVIRONMENT),
        Parameter(
            'field_of_view', POSITIVE, 'full angle around straight ahead', 'rad', OF_ENVIRONMENT),
        Parameter('identities', FLAG, 'whether robots know which landmark they see', '', 'true'),
        Parameter(
            'clutter', FRACTION, 'part of the observations that are of nothing, without identity', '',
            '0.0'),
        Parameter(
            'missed', FRACTION, 'part of the landmarks in view that are not seen', '', '0.0'),
        Parameter('seed', SEED, 'of all noise and of the world', '', '1'),
        Parameter('speed', POSITIVE, 'seconds of simulated time in one second', '', '1.0'),
        Parameter('clock', FLAG, 'publish simulated time on /clock', '', 'false'),
        Parameter('wait', FLAG, 'begin when every topic has a subscriber', '', 'true'),
    )
}

#: Simulated time of the first step [ns]; zero would mean that simulated time has not begun.
FIRST_STAMP = 1_000_000_000


@dataclass(frozen=True)
class Simulation:
    """
    A simulated run.

    Attributes
    ----------
    environment : what there is and how it is measured
    seed : of the generator for everything random
    speed : seconds of simulated time in one second
    clock : whether simulated time is published
    wait : whether publishing begins only when every topic has a subscriber

    """

    environment: AnyEnvironment
    seed: int = 1
    speed: float = 1.0
    clock: bool = False
    wait: bool = True

    @property
    def robot_ids(self) -> dict[str, int]:
        """Return the numbers that robots have by default, which observations of them carry."""
        return {name: k for k, name in enumerate(self.environment.world.robots, start=1)}

    def true_world(self) -> World:
        """Return the world itself, the same at every call."""
        return self.environment.true_world(np.random.default_rng(self.seed))

    def records(self) -> Iterator[Record]:
        """Yield what the robots measure, the same at every call."""
        return self.environment.records(np.random.default_rng(self.seed))


def parse(values: Mapping[str, object]) -> Simulation:
    """
    Return the simulation that flat ROS parameters mean.

    Raises
    ------
    UsageError
        A name is unknown or does not apply, or a value is of a wrong type or impossible.

    """
    given = checked(values, PARAMETERS) | {'first_stamp': FIRST_STAMP}
    name = given.pop('environment', 'circles')
    environment = ALL_ENVIRONMENTS[name]
    robot_names(given.get('robots', environment.world.robots))
    parts: dict[str, Any] = {
        part: replace(settings, **_take(given, settings))
        for part, settings in vars(environment).items()}
    simulated = Simulation(replace(environment, **parts), **_take(given, Simulation))
    if given:
        raise UsageError(
            f"parameter '{min(given)}' does not apply to the environment '{name}': leave it out")
    return simulated


def load(path: Path) -> Simulation:
    """Return the simulation that a ROS parameter file holds for the node ``simulator``."""
    try:
        return parse(load_values(path, ['simulator']))
    except UsageError as error:
        raise UsageError(f'{path}: {error}') from error


def describe() -> dict[str, str]:
    """Return one line of meaning, unit and default for each parameter."""
    return {name: description(parameter) for name, parameter in PARAMETERS.items()}


def _take(given: dict[str, Any], settings: Any) -> dict[str, Any]:
    """Take out what belongs to some settings."""
    names = {field.name for field in fields(settings)} & given.keys()
    return {name: given.pop(name) for name in names}
