# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Run simulator and estimator as two processes over DDS, then print a table and draw a picture.

Uses its own ROS domain on this machine only.
"""

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fej_slam_ros.atomic_files import refuse_existing, write_bytes, write_json
from fej_slam_ros.cli.run_table import run_table
from fej_slam_ros.output_lock import OutputLock
from fej_slam_ros.ros.files import run_results
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.sim.world import World

#: Simulated over real time, so that the demo ends within a minute.
DEMO_SPEED = 8.0
PICTURE = 'scene.png'
SIMULATION = {'environment': 'circles', 'speed': DEMO_SPEED, 'clock': True}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--output', type=Path, default=Path('demo_output'), metavar='DIR',
        help='folder for tables and picture (default: demo_output)')
    parser.add_argument('--force', action='store_true', help='replace earlier results')


def run(arguments: argparse.Namespace) -> int:
    output: Path = arguments.output
    with OutputLock.of_folder(output):
        refuse_existing([output / PICTURE, output / 'summary.json'], arguments.force)
        _run(output)
    return 0


def _run(output: Path) -> None:
    from fej_slam_ros.ros.nodes.demo import run_processes

    world = simulation.parse(SIMULATION).true_world()
    with TemporaryDirectory() as folder:
        files = Path(folder)
        parameters = _write_parameters(files, world.robots)
        seconds = (world.stamps[-1] - world.stamps[0]) * 1e-9
        print(
            f'simulating {len(world.robots)} robots among {len(world.landmarks)} landmarks for'
            f' {seconds:.0f} s at {DEMO_SPEED:g} times real time')
        if not run_processes(parameters, world.robots, seconds):
            return
        _draw(files / PICTURE, files / 'results', world)
        summary = json.loads((files / 'results' / 'summary.json').read_text(encoding='utf-8'))
        for path in [*(files / 'results').iterdir(), files / PICTURE]:
            write_bytes(output / path.name, path.read_bytes())
    print(run_table(summary))
    print(f'files and picture: {output}, {output / PICTURE}')


def _write_parameters(folder: Path, robots: tuple[str, ...]) -> dict[str, Path]:
    estimator = {
        'robots': list(robots), 'use_sim_time': True, 'output': str(folder / 'results')}
    paths = {}
    for node, values in {'simulator': SIMULATION, 'estimator': estimator}.items():
        paths[node] = folder / f'{node}.yaml'
        write_json(paths[node], {node: {'ros__parameters': values}})  # JSON is valid YAML.
    return paths


def _draw(picture: Path, results: Path, world: World) -> None:
    from fej_slam_ros.experiments.common.scene import draw_scene

    result = run_results.read_folder(results)
    trajectories = {name: result.trajectories[name] for name in world.robots}
    draw_scene(
        picture, 'Two robots, estimated live, with 3-sigma ellipses',
        {name: trajectory.poses for name, trajectory in trajectories.items()},
        {name: trajectory.P for name, trajectory in trajectories.items()},
        result.landmarks.points, result.landmarks.P, world.true_poses,
        np.array(list(world.landmarks.values())))
