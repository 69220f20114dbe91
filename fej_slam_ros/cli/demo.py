# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Run a simulator and an estimator as processes over DDS, then print a table and draw a picture.

With --sensor laser, the robots have lasers in a room with posts, walls and people. A detector
finds the posts, by which the robots join although their starts are unknown.

Uses its own ROS domain on this machine only.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from fej_slam_ros.atomic_files import refuse_existing, write_bytes, write_json
from fej_slam_ros.cli.run_table import run_table
from fej_slam_ros.output_lock import OutputLock
from fej_slam_ros.ros.files import run_results
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.sim.environments import LaserEnvironment
from fej_slam_ros.sim.laser_world import LaserWorld
from fej_slam_ros.sim.world import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE = 'scene.png'


@dataclass(frozen=True)
class Sensor:
    """A demonstration, which ends within a minute."""

    simulation: Mapping[str, object]  #: parameters of the simulator
    #: parameters of the estimator, and of the detector if there is one, without the robots
    estimator: Mapping[str, object]
    detector: Mapping[str, object] | None
    title: str  #: of the picture


SENSORS = {
    'landmarks': Sensor(
        {'environment': 'circles', 'speed': 8.0, 'clock': True}, {}, None,
        'Two robots, estimated live, with 3-sigma ellipses'),
    'laser': Sensor(
        {'environment': 'posts', 'speed': 2.0, 'clock': True, 'loops': 1,
         'seed': 3},
        # Landmarks are later than odometry by the time of the detector.
        {'anchor': 'r1', 'max_delay': 1.0}, {'range_sigma': 0.02},
        'Two robots with lasers, starts unknown, estimated live, with 3-sigma ellipses')}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--output', type=Path, default=Path('demo_output'), metavar='DIR',
        help='folder for tables and picture (default: demo_output)')
    parser.add_argument(
        '--sensor', choices=SENSORS, default='landmarks',
        help='what the robots observe (default: %(default)s)')
    parser.add_argument('--force', action='store_true', help='replace earlier results')


def run(arguments: argparse.Namespace) -> int:
    output: Path = arguments.output
    with OutputLock.of_folder(output):
        refuse_existing([output / PICTURE, output / 'summary.json'], arguments.force)
        _run(SENSORS[arguments.sensor], output)
    return 0


def _run(sensor: Sensor, output: Path) -> None:
    from fej_slam_ros.ros.nodes.demo import run_processes

    simulated = simulation.parse(sensor.simulation)
    world = simulated.true_world()
    with TemporaryDirectory() as folder:
        files = Path(folder)
        parameters = _write_parameters(sensor, files, world.robots)
        seconds = (world.stamps[-1] - world.stamps[0]) * 1e-9
        print(
            f'simulating {len(world.robots)} robots among {len(world.landmarks)} landmarks for'
            f' {seconds:.0f} s at {simulated.speed:g} times real time')
        if not run_processes(parameters, world.robots, seconds):
            return
        _draw(files / PICTURE, sensor.title, files / 'results', world, simulated)
        summary = json.loads((files / 'results' / 'summary.json').read_text(encoding='utf-8'))
        for path in [*(files / 'results').iterdir(), files / PICTURE]:
            write_bytes(output / path.name, path.read_bytes())
    print(run_table(summary))
    print(f'files and picture: {output}, {output / PICTURE}')


def _write_parameters(
    sensor: Sensor, folder: Path, robots: tuple[str, ...]
) -> dict[str, Path]:
    estimator = {
        'robots': list(robots), 'use_sim_time': True, 'output': str(folder / 'results'),
        **sensor.estimator}
    nodes: dict[str, Mapping[str, object]] = {
        'simulator': sensor.simulation, 'estimator': estimator}
    if sensor.detector is not None:
        nodes['detector'] = {
            'robots': list(robots), 'use_sim_time': True, **sensor.detector}
    paths = {}
    for node, values in nodes.items():
        paths[node] = folder / f'{node}.yaml'
        write_json(paths[node], {node: {'ros__parameters': values}})  # JSON is valid YAML.
    return paths


def _draw(
    picture: Path, title: str, results: Path, world: World, simulated: simulation.Simulation
) -> None:
    from fej_slam_ros.experiments.common.laser_scene import draw_laser_world
    from fej_slam_ros.experiments.common.scene import draw_scene

    def draw_world(axes: 'Axes') -> None:
        environment = simulated.environment
        if isinstance(world, LaserWorld) and isinstance(environment, LaserEnvironment):
            draw_laser_world(axes, world, environment.sensors)

    result = run_results.read_folder(results)
    trajectories = {name: result.trajectories[name] for name in world.robots}
    draw_scene(
        picture, title,
        {name: trajectory.poses for name, trajectory in trajectories.items()},
        {name: trajectory.P for name, trajectory in trajectories.items()},
        result.landmarks.points, result.landmarks.P, world.true_poses,
        np.array(list(world.landmarks.values())), draw_world)
