# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Run a simulator and an estimator as processes over DDS, then print a table and draw a picture.

With --sensor laser, the robots have lasers in a room with posts, walls and people. A detector
finds the posts, by which the robots join although their starts are unknown. With --sensor tags,
they have cameras and see printed tags, which they carry too; an adapter reads the detections.

Uses its own ROS domain on this machine only.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
import json
from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from fej_slam_ros.atomic_files import refuse_existing, write_bytes, write_figure, write_json
from fej_slam_ros.cli.arguments import output_folder, require_matplotlib
from fej_slam_ros.cli.run_picture import draw_run, PICTURE
from fej_slam_ros.cli.run_table import run_table
from fej_slam_ros.core.records import NS
from fej_slam_ros.output_lock import OutputLock
from fej_slam_ros.ros.files import run_results
from fej_slam_ros.ros.files.run_files import result_paths
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.sim import tags
from fej_slam_ros.sim.environments import LaserEnvironment, TagEnvironment
from fej_slam_ros.sim.laser_world import LaserWorld
from fej_slam_ros.sim.tags import TagWorld
from fej_slam_ros.sim.world import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Sensor:
    """A demonstration, which ends within a minute."""

    simulation: Mapping[str, object]  #: parameters of the simulator
    #: parameters of the estimator and of the nodes before it, by name, without the robots
    nodes: Mapping[str, Mapping[str, object]]
    title: str  #: of the picture


#: Landmarks are later than odometry by the time of the node that makes them.
BEHIND_A_NODE = {'anchor': 'r1', 'max_delay': 1.0}
#: Robots of the simulator.
ROBOTS = ('r1', 'r2')
SENSORS = {
    'landmarks': Sensor(
        {'environment': 'circles', 'speed': 8.0, 'clock': True}, {'estimator': {}},
        'Two robots, estimated live, with 3-sigma ellipses'),
    'laser': Sensor(
        {'environment': 'posts', 'speed': 2.0, 'clock': True, 'loops': 1, 'seed': 3},
        {'estimator': BEHIND_A_NODE, 'detector': {'range_sigma': 0.02}},
        'Two robots with lasers, starts unknown, estimated live'),
    'tags': Sensor(
        {'environment': 'tags', 'speed': 2.0, 'clock': True, 'loops': 1, 'seed': 3},
        {'estimator': BEHIND_A_NODE, 'adapter': {
            'formats': ['marker_array'],
            **{f'{robot}.{name}': value for robot, carried in tags.robot_tags(ROBOTS).items()
               for name, value in (
                   ('sensor_pose', [*tags.CAMERA_POSE]), ('tag_depth', tags.TAG_DEPTH),
                   ('tags', [f'tags:{tag}' for tag in carried]))}}},
        'Two robots with cameras among tags, starts unknown')}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--output', type=output_folder, metavar='DIR',
        help='folder for tables and picture (default: demo_output, or demo_SENSOR_output)')
    parser.add_argument(
        '--sensor', choices=SENSORS, default='landmarks',
        help='what the robots observe (default: %(default)s)')
    parser.add_argument('--force', action='store_true', help='replace earlier results')


def run(arguments: argparse.Namespace) -> int:
    name = '' if arguments.sensor == 'landmarks' else f'_{arguments.sensor}'
    output: Path = arguments.output or Path(f'demo{name}_output')
    require_matplotlib()
    with OutputLock.of_folder(output):
        refuse_existing([output / PICTURE, *result_paths(output, ROBOTS)], arguments.force)
        _run(SENSORS[arguments.sensor], output)
    return 0


def _run(sensor: Sensor, output: Path) -> None:
    from fej_slam_ros.ros.nodes.demo import run_processes

    simulated = simulation.parse(sensor.simulation)
    world = simulated.true_world()
    with TemporaryDirectory() as folder:
        files = Path(folder)
        parameters = _write_parameters(sensor, files, world.robots)
        seconds = (world.stamps[-1] - world.stamps[0]) / NS
        print(
            f'simulating {len(world.robots)} robots among {len(world.landmarks)} landmarks for'
            f' {seconds:.0f} s at {simulated.speed:g} times real time')
        if not run_processes(parameters, world.robots, seconds):
            print('interrupted: the nodes have ended, there are no results', file=sys.stderr)
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
    common = {'robots': list(robots), 'use_sim_time': True}
    nodes: dict[str, Mapping[str, object]] = {
        'simulator': sensor.simulation, **{
            name: {**common, **values} for name, values in sensor.nodes.items()}}
    nodes['estimator'] = {**nodes['estimator'], 'output': str(folder / 'results')}
    paths = {}
    for node, values in nodes.items():
        paths[node] = folder / f'{node}.yaml'
        write_json(paths[node], {node: {'ros__parameters': values}})  # JSON is valid YAML.
    return paths


def _draw(
    picture: Path, title: str, results: Path, world: World, simulated: simulation.Simulation
) -> None:
    from fej_slam_ros.experiments.common.sensor_scenes import draw_laser_world, draw_tag_world

    def draw_world(axes: 'Axes') -> None:
        environment = simulated.environment
        if isinstance(world, LaserWorld) and isinstance(environment, LaserEnvironment):
            draw_laser_world(axes, world, environment.sensors)
        if isinstance(world, TagWorld) and isinstance(environment, TagEnvironment):
            draw_tag_world(axes, world, environment.sensors)

    write_figure(
        picture, draw_run, title, run_results.read_folder(results), world.robots,
        world.true_poses, world.landmarks.values(), draw_world)
