# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The files that a run leaves behind, the same for a replay and a live run.

Rows are written as they come, into ``*.part`` files that get their names when they are complete.
"""

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from importlib.metadata import version
import json
import math
from pathlib import Path
import platform
from typing import Any

import numpy as np
import scipy

from fej_slam_ros import __version__
from fej_slam_ros.core.consistency import nees
from fej_slam_ros.core.estimator import Estimator, MAP, own_frame, PoseEstimate, StepResult
from fej_slam_ros.core.records import NS, Refusal
from fej_slam_ros.ros.inputs import Inputs
from fej_slam_ros.ros.outputs import map_estimates
from fej_slam_ros.ros.parameters import as_parameters
from fej_slam_ros.writing import PartFile, refuse_existing, write_text

TRAJECTORY_HEADER = 'stamp_ns,x,y,yaw,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw,frame'
LANDMARKS_HEADER = 'id,x,y,var_x,cov_xy,var_y,frame'
IDS_HEADER = 'landmark,robot,id'


class Trajectory:
    """Poses of one robot: all of them as CSV, those of the last frame in TUM form for evo."""

    def __init__(self, folder: Path, robot: str) -> None:
        self._csv = PartFile(folder / f'trajectory_{robot}.csv')
        self._tum = PartFile(folder / f'{robot}.tum')
        self._parts = ExitStack()
        self._parts.enter_context(self._csv)
        self._parts.enter_context(self._tum)
        self._csv.file.write(TRAJECTORY_HEADER + '\n')
        self._frame = ''

    def write(self, estimate: PoseEstimate) -> None:
        """Append a pose as published."""
        P = estimate.P[np.triu_indices(3)]
        numbers = ','.join(map(repr, [*estimate.pose.tolist(), *P.tolist()]))
        self._csv.file.write(f'{estimate.stamp},{numbers},{estimate.frame}\n')
        if estimate.frame != self._frame:
            self._frame = estimate.frame
            self._tum.file.seek(0)
            self._tum.file.truncate()
        x, y, phi = estimate.pose.tolist()
        whole, fraction = divmod(abs(estimate.stamp), NS)
        seconds = f'{"-" if estimate.stamp < 0 else ""}{whole}.{fraction:09d}'
        turn = f'0 0 {math.sin(phi / 2.0)!r} {math.cos(phi / 2.0)!r}'
        self._tum.file.write(f'{seconds} {x!r} {y!r} 0 {turn}\n')

    def keep(self) -> None:
        """Give the files their names."""
        self._csv.keep()
        self._tum.keep()

    def discard(self) -> None:
        """Leave nothing behind that was not kept."""
        self._parts.close()


class Files:
    """
    The files of one run.

    Parameters
    ----------
    folder : where they go
    estimator : whose run it is
    force : whether files of an earlier run may be replaced

    """

    def __init__(self, folder: Path, estimator: Estimator, force: bool = False) -> None:
        self._folder = folder
        self._estimator = estimator
        self._force = force
        self._trajectories: dict[str, Trajectory] = {}
        maps = [folder / name for name in ('summary.json', 'landmarks.csv', 'ids.csv')]
        refuse_existing([*maps, *_trajectory_files(folder, estimator.robots)], force)
        self.begin(estimator.robots)

    def begin(self, robots: Iterable[str]) -> None:
        """
        Begin the files of robots that have none in this run yet.

        Raises
        ------
        UsageError
            There are files of an earlier run.

        """
        new = [name for name in robots if name not in self._trajectories]
        refuse_existing(_trajectory_files(self._folder, new), self._force)
        self._trajectories |= {name: Trajectory(self._folder, name) for name in new}

    def write(self, result: StepResult) -> None:
        """Append the poses of a step."""
        for estimate in result.poses:
            self._trajectories[estimate.robot].write(estimate)

    def discard(self) -> None:
        """Leave nothing behind that was not kept."""
        for trajectory in self._trajectories.values():
            trajectory.discard()

    def keep(self, told: Mapping[str, Any]) -> None:
        """Complete the files of a run that has ended, with what its summary tells."""
        for trajectory in self._trajectories.values():
            trajectory.keep()
        self._write_landmarks()
        write_text(self._folder / 'summary.json', json.dumps(told, indent=2) + '\n')

    def _write_landmarks(self) -> None:
        rows, ids = [LANDMARKS_HEADER], [IDS_HEADER]
        for estimate in map_estimates(self._estimator):
            for landmark, key, point, P in zip(
                    estimate.ids, estimate.keys, estimate.points, estimate.P):
                numbers = [*point.tolist(), P[0, 0].item(), P[0, 1].item(), P[1, 1].item()]
                rows.append(f'{landmark},{",".join(map(repr, numbers))},{estimate.frame}')
                ids.append(f'{landmark},{key[0]},{key[1]}')
        write_text(self._folder / 'landmarks.csv', '\n'.join(rows) + '\n')
        if self._estimator.settings.shared_landmark_ids:
            # One of an earlier run would explain other numbers.
            (self._folder / 'ids.csv').unlink(missing_ok=True)
        else:
            write_text(self._folder / 'ids.csv', '\n'.join(ids) + '\n')


def _trajectory_files(folder: Path, robots: Iterable[str]) -> list[Path]:
    return [
        folder / name for robot in robots for name in (f'{robot}.tum', f'trajectory_{robot}.csv')]


def summary(estimator: Estimator, inputs: Inputs) -> dict[str, Any]:
    """Return all figures of a run."""
    ledger = estimator.ledger
    names = sorted({*estimator.robots, *ledger.received, *ledger.refusals})
    counts = {reason.value: ledger.total(reason) for reason in Refusal}
    return {
        'state_hash': estimator.state_hash(),
        'depends_on_arrival': ledger.depends_on_arrival(),
        'counts': {
            'used': sum(estimator.used(name) for name in names),
            **counts,
            'released_without': sum(ledger.released_without.values()),
        },
        'robots': {
            name: {
                'steps': estimator.steps[name],
                'received': ledger.received[name],
                'used': estimator.used(name),
                'refused': ledger.refused[name],
                'sightings_used': ledger.sightings_used[name],
                'located_anew': ledger.located_anew[name],
                'refusals': {reason.value: n for reason, n in ledger.refusals[name].items()},
                'frame': MAP if name in estimator.team.state.robots else own_frame(name),
            } for name in names},
        'not_in_map': estimator.unlocated,
        'landmarks': len(estimator.team.state.landmarks),
        'unused_topics': dict(inputs.unused),
        'nis': {
            name: {'sum': nis.total, 'dof': nis.dof, 'per_dof': nis.total / nis.dof}
            for name, nis in estimator.nis.items() if nis.dof},
        **_scores(estimator),
        'config': as_parameters(estimator.settings),
        'versions': {
            'fej_slam_ros': __version__, 'rosbags': version('rosbags'),
            'numpy': np.__version__, 'scipy': scipy.__version__,
            'python': platform.python_version(), 'machine': platform.machine()},
    }


def _scores(estimator: Estimator) -> dict[str, Mapping[str, Any]]:
    """Return RMSE and NEES against ground truth, where there is any."""
    scores = estimator.evaluation.scores
    rmse: dict[str, Any] = {
        name: {
            'steps': score.steps, 'position': score.position_rmse(),
            'heading': score.heading_rmse()}
        for name, score in scores.items()}
    ratings: dict[str, Any] = {name: score.mean_nees() for name, score in scores.items()}
    found = _landmark_errors(estimator)
    if found:
        rmse['landmarks'] = math.sqrt(sum(float(e @ e) for e, _ in found) / len(found))
        ratings['landmarks'] = sum(float(nees(e, P)) for e, P in found) / len(found)
    return {'rmse': rmse, 'nees': ratings} if rmse else {}


def _landmark_errors(estimator: Estimator) -> list[tuple[Any, Any]]:
    if not estimator.settings.shared_landmark_ids:
        return []
    state, truth = estimator.team.state, estimator.truth.landmarks
    return [
        (state.estimate(landmark) - truth[landmark.key[1]], state.marginal([landmark]))
        for landmark in state.landmarks.values() if landmark.key[1] in truth]
