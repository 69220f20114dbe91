# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated runs from parameters, for the node ``simulator`` and for bags."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from fej_slam_ros.core.parameter_kinds import (
    FLAG, Kind, NOT_NEGATIVE, numbers, one_of, Parameter, parameters_of, POINT_SIGMA, POSE,
    POSE_SIGMA, Range, ROBOT_NAMES)
from fej_slam_ros.detection.records import AnyRecord
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters import (
    CommonNodeSettings, given_values, load_parsed, robot_names, STRICT_PARAMETERS, Value, Warn,
    warn_once)
from fej_slam_ros.sim.environments import ALL_ENVIRONMENTS, AnyEnvironment
from fej_slam_ros.sim.world import World

SIMULATED_NUMBER = Kind('a number from 1e-3 to 1e6', float, allowed=lambda x: 1e-3 <= x <= 1e6)
COUNT = numbers('an integer', Range(1, 100_000), element=int)
STEP_COUNT = numbers('an integer', Range(2, 100_000), element=int)
THREE_SIGMAS = Kind('three numbers from 1e-6 to 1e6', float, (3,), lambda x: 1e-6 <= x <= 1e6)
TWO_SIGMAS = replace(THREE_SIGMAS, expected='two numbers from 1e-6 to 1e6', shape=(2,))
LENGTHS = Kind('two numbers from 1e-3 to 1e6', float, (2,), SIMULATED_NUMBER.allowed)
FRACTION = Kind('a number from 0 to 0.9', float, allowed=lambda x: 0.0 <= x <= 0.9)
COORDINATES = Kind('a list of numbers', float, (None,), lambda x: abs(x) <= 1e6)
BEAMS = Kind('an integer from 16 to 20000', int, allowed=lambda n: 16 <= n <= 20_000)
SEED_NUMBER = Kind('an integer, 0 or above', int, allowed=lambda n: n >= 0)
OF_ENVIRONMENT = 'depends on the environment'

PARAMETERS = {
    'environment': Parameter(
        one_of(*ALL_ENVIRONMENTS), 'world and motion of the robots', '', 'circles'),
    'robots': Parameter(
        ROBOT_NAMES, 'names of the robots', '',
        '[r1, r2], or [p, q] where the two meet'),
    'landmarks': Parameter(
        COUNT, 'number of landmarks', '', '60, 15 random posts for lasers, or 24 tags'),
    'loops': Parameter(
        COUNT, 'number of loops that each robot drives', '',
        '5, or 2 with lasers or cameras'),
    'steps_per_loop': Parameter(STEP_COUNT, 'steps of a loop', '', OF_ENVIRONMENT),
    'loop_lengths': Parameter(
        LENGTHS, 'lengths of the loops of robots 1, 3, ... and 2, 4, ...', 'm', OF_ENVIRONMENT),
    'rate': Parameter(SIMULATED_NUMBER, 'steps per second of simulated time', 'Hz', '5.0'),
    'start': Parameter(
        POSE, 'initial pose of the first robot in map', 'm, m, rad', '[0, 0, 0]'),
    'odometry_sigma': Parameter(
        POSE_SIGMA, 'standard deviations of the odometry of one step', 'm, m, rad',
        OF_ENVIRONMENT),
    'landmark_sigma': Parameter(
        POINT_SIGMA, 'standard deviations of a landmark observation', 'm', OF_ENVIRONMENT),
    'robot_sigma': Parameter(
        POINT_SIGMA, 'standard deviations of a robot-to-robot observation', 'm',
        'no such observations in circles and figure_eight'),
    'driving_sigma': Parameter(
        THREE_SIGMAS, 'standard deviations of the speeds of the first of two robots that meet',
        'm/s, m/s, rad/s', OF_ENVIRONMENT),
    'polar_sigma': Parameter(
        TWO_SIGMAS, 'standard deviations of range and bearing of two robots that meet', 'm, rad',
        OF_ENVIRONMENT),
    'range': Parameter(
        SIMULATED_NUMBER, 'maximum range of observations', 'm', OF_ENVIRONMENT),
    'field_of_view': Parameter(
        SIMULATED_NUMBER, 'full angle of the field of view, centred straight ahead', 'rad',
        OF_ENVIRONMENT),
    'identities': Parameter(FLAG, 'observations carry landmark IDs', '', 'true'),
    'clutter': Parameter(
        FRACTION, 'fraction of observations that are false and without ID', '', '0.0'),
    'missed': Parameter(
        FRACTION, 'fraction of landmarks in view that are not observed', '', '0.0'),
    'post_radius': Parameter(
        LENGTHS, 'smallest and largest radius of random posts', 'm', '[0.05, 0.2]'),
    'posts': Parameter(COORDINATES, 'x, y and radius of each post', 'm', 'random posts'),
    'inner_walls': Parameter(SEED_NUMBER, 'largest number of random walls in the room', '', '2'),
    'walls': Parameter(
        COORDINATES, 'x and y of the begin and of the end of each wall', 'm', 'random walls'),
    'people': Parameter(SEED_NUMBER, 'number of people who walk through the room', '', '2'),
    'beams': Parameter(BEAMS, 'number of beams of a laser scan', '', '720'),
    'range_sigma': Parameter(
        SIMULATED_NUMBER, 'standard deviation of a range of the laser, or of the distance of a tag'
        ' near the camera', 'm', '0.02'),
    'range_sigma_growth': Parameter(
        NOT_NEGATIVE, 'growth of the latter by the square of the distance', '1/m', '0.01'),
    'bearing_sigma': Parameter(
        SIMULATED_NUMBER, 'standard deviation of the direction of a tag', 'rad', '0.005'),
    'orientation_sigma': Parameter(
        SIMULATED_NUMBER, 'standard deviation of the orientation of a tag', 'rad', '0.1'),
    'image_rate': Parameter(SIMULATED_NUMBER, 'images of a camera per second', 'Hz', '10.0'),
    'dropouts': Parameter(
        FRACTION, 'fraction of beams without return by chance', '', '0.005'),
    'scan_rate': Parameter(SIMULATED_NUMBER, 'laser scans per second', 'Hz', '10.0'),
    'seed': Parameter(SEED_NUMBER, 'seed of the world and of all noise', '', '1'),
    'speed': Parameter(SIMULATED_NUMBER, 'seconds of simulated time per second', '', '1.0'),
    'clock': Parameter(
        FLAG, 'publish simulated time on /clock, and stamp with it instead of with the present'
        ' time', '', 'false'),
    'wait': Parameter(FLAG, 'wait until every topic has a subscriber', '', 'true'),
    STRICT_PARAMETERS: parameters_of(CommonNodeSettings)[STRICT_PARAMETERS],
}

#: Maximum number of steps, whose poses are computed at once.
MAX_STEPS = 1_000_000
#: Simulated time of the first step [ns]; in ROS, zero means that simulated time has not begun.
FIRST_STAMP = 1_000_000_000


@dataclass(frozen=True)
class Simulation:
    """A simulated run."""

    environment: AnyEnvironment  #: world, trajectories and sensors
    kind: str = 'circles'  #: name of the environment
    seed: int = 1  #: of the random generator
    speed: float = 1.0  #: seconds of simulated time per second
    clock: bool = False  #: whether simulated time is published
    wait: bool = True  #: whether publishing starts only when every topic has a subscriber
    strict_parameters: bool = False  #: whether unknown parameters are errors

    @property
    def robot_ids(self) -> dict[str, int]:
        """Return the default IDs of the robots, which robot-to-robot observations carry."""
        return {name: k for k, name in enumerate(self.environment.world.robots, start=1)}

    def true_world(self) -> World:
        """Return the true world, the same at every call."""
        return self.environment.true_world(np.random.default_rng(self.seed))

    def records(self) -> Iterator[AnyRecord]:
        """Yield the measurements and the ground truth, the same at every call."""
        return self.environment.records(np.random.default_rng(self.seed))


def parse(values: Mapping[str, object], warn: Warn = warn_once) -> Simulation:
    """Return the simulation for flat ROS parameters; a wrong one raises UsageError."""
    given = given_values(values, PARAMETERS, warn) | {'first_stamp': FIRST_STAMP}
    name = given.pop('environment', 'circles')
    environment = ALL_ENVIRONMENTS[name]
    robot_names(given.get('robots', environment.world.robots))
    parts: dict[str, Any] = {
        part: replace(settings, **_take(given, settings))
        for part, settings in vars(environment).items()}
    simulated = Simulation(replace(environment, **parts), name, **_take(given, Simulation))
    if given:
        raise UsageError(
            f"parameter '{min(given)}' does not apply to the environment '{name}': leave it out")
    world: Any = simulated.environment.world
    steps = getattr(world, 'loops', 1) * getattr(world, 'steps_per_loop', 1)
    if steps > MAX_STEPS:
        raise UsageError(
            f"parameters 'loops' and 'steps_per_loop' make {steps:,} steps, at most {MAX_STEPS:,}"
            ' can be simulated: lower one')
    return simulated


def load(path: Path) -> Simulation:
    """Return the simulation for the node ``simulator`` in a ROS parameter file."""
    return load_parsed(path, ['simulator'], parse)


def as_parameters(simulated: Simulation) -> dict[str, Value]:
    """Return the flat ROS parameters that apply to a simulation, those left out by default too."""
    values: dict[str, Any] = {}
    for settings in (*vars(simulated.environment).values(), simulated):
        values |= {field.name: getattr(settings, field.name) for field in fields(settings)}
    values['environment'] = simulated.kind
    return {
        name: parameter.kind.write(values[name]) for name, parameter in PARAMETERS.items()
        if values.get(name) is not None}


def _take(given: dict[str, Any], settings: Any) -> dict[str, Any]:
    """Remove and return the values for the fields of a dataclass."""
    names = {field.name for field in fields(settings)} & given.keys()
    return {name: given.pop(name) for name in names}
