# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The files that a run leaves behind, the same for a replay and a live run.

Rows are written as they come, into ``*.part`` files that get their names when they are complete.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import ExitStack
from importlib.metadata import version
import math
from pathlib import Path
import platform
from typing import Any

import numpy as np
import scipy

from fej_slam_ros import __version__
from fej_slam_ros.atomic_files import PartFile, refuse_existing, write_json, write_text
from fej_slam_ros.core.consistency import nees, PoseScore
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.ekf.state import landmark_estimates
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.parameters import as_parameters, RunSettings
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.outputs import MapEstimate

TRAJECTORY_HEADER = 'stamp_ns,x,y,yaw,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw,frame'
LANDMARKS_HEADER = 'id,x,y,var_x,cov_xy,var_y,frame'
IDS_HEADER = 'landmark,robot,id'


def tum_line(stamp: int, pose: Array) -> str:
    """Return a pose (3,) at a stamp [ns] as a line of a TUM file: t x y z qx qy qz qw."""
    x, y, phi = pose.tolist()
    whole, fraction = divmod(abs(stamp), NS)
    seconds = f'{"-" if stamp < 0 else ""}{whole}.{fraction:09d}'
    return f'{seconds} {x!r} {y!r} 0 0 0 {math.sin(phi / 2.0)!r} {math.cos(phi / 2.0)!r}'


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
        self._tum.file.write(tum_line(estimate.stamp, estimate.pose) + '\n')

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
    robots : the team to begin with
    force : whether files of an earlier run may be replaced
    others : names of further files that the run will leave

    """

    def __init__(
        self, folder: Path, robots: Collection[str], force: bool = False,
        others: Sequence[str] = (),
    ) -> None:
        self._folder = folder
        self._force = force
        self._trajectories: dict[str, Trajectory] = {}
        told = [folder / name for name in ('summary.json', 'landmarks.csv', 'ids.csv', *others)]
        refuse_existing([*told, *_trajectory_files(folder, robots)], force)
        self.begin(robots)

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

    def write(self, poses: Iterable[PoseEstimate]) -> None:
        """Append poses."""
        for estimate in poses:
            self._trajectories[estimate.robot].write(estimate)

    def discard(self) -> None:
        """Leave nothing behind that was not kept."""
        for trajectory in self._trajectories.values():
            trajectory.discard()

    def keep(
        self, maps: Iterable[MapEstimate], shared_ids: bool, **told: Mapping[str, Any]
    ) -> None:
        """
        Complete the files of a run that has ended.

        Parameters
        ----------
        maps : of all frames
        shared_ids : whether one number is one landmark for all robots
        told : what goes into further files, ``summary`` into ``summary.json``

        """
        for trajectory in self._trajectories.values():
            trajectory.keep()
        self._write_landmarks(maps, shared_ids)
        for name, content in told.items():
            write_json(self._folder / f'{name}.json', content)

    def _write_landmarks(self, maps: Iterable[MapEstimate], shared_ids: bool) -> None:
        rows, ids = [LANDMARKS_HEADER], [IDS_HEADER]
        for estimate in maps:
            for landmark, keys, point, P in zip(
                    estimate.ids, estimate.keys, estimate.points, estimate.P):
                numbers = [*point.tolist(), P[0, 0].item(), P[0, 1].item(), P[1, 1].item()]
                rows.append(f'{landmark},{",".join(map(repr, numbers))},{estimate.frame}')
                ids += [f'{landmark},{robot},{number}' for robot, number in keys]
        write_text(self._folder / 'landmarks.csv', '\n'.join(rows) + '\n')
        if shared_ids:
            # One of an earlier run would explain other numbers.
            (self._folder / 'ids.csv').unlink(missing_ok=True)
        else:
            write_text(self._folder / 'ids.csv', '\n'.join(ids) + '\n')


def _trajectory_files(folder: Path, robots: Iterable[str]) -> list[Path]:
    return [
        folder / name for robot in robots for name in (f'{robot}.tum', f'trajectory_{robot}.csv')]


def summary(estimator: Estimator, inputs: Inputs, settings: RunSettings) -> dict[str, Any]:
    """Return all figures of a run of the estimator."""
    in_map = estimator.groups.team.robots
    return {
        **_account(estimator, lambda name: MAP if name in in_map else own_frame(name)),
        'not_in_map': estimator.groups.not_in_map,
        'landmarks': len(estimator.landmarks()),
        'without_identity': {
            name: dict(counts) for name, counts in estimator.landmark_manager.counts.items()},
        'unused_topics': dict(inputs.unused),
        'nis': {
            name: {'sum': nis.total, 'dof': nis.dof, 'per_dof': nis.total / nis.dof}
            for name, nis in estimator.innovations.nis.items() if nis.dof},
        **_scores(estimator.evaluation.scores, _landmark_errors(estimator)),
        **_setting(settings),
    }


def smoother_summary(
    team: TeamSmoother, inputs: Inputs, settings: RunSettings
) -> dict[str, Any]:
    """Return all figures of a run of the smoother."""
    return {
        **_account(
            team, lambda name: (
                team.trajectories[name].frame if name in team.trajectories else own_frame(name))),
        'not_in_map': team.not_in_map(),
        'landmarks': team.solution.landmarks_in_map(),
        'unused_topics': dict(inputs.unused),
        **_scores(team.scores(), _smoothed_errors(team)),
        **_setting(settings),
    }


def _account(of: Estimator | TeamSmoother, frame: Callable[[str], str]) -> dict[str, Any]:
    """Return the hash, and what became of the input, with the frame of each robot."""
    statistics = of.statistics
    names = sorted({*of.robots, *statistics.received, *statistics.rejection_counts})
    return {
        'state_hash': of.state_hash(),
        'depends_on_arrival': statistics.depends_on_arrival(),
        'counts': {
            'used': sum(of.used(name) for name in names),
            **{reason.value: statistics.total(reason) for reason in RejectionReason},
            'released_without': sum(statistics.released_without.values()),
        },
        'robots': {
            name: {
                'steps': of.steps[name],
                'received': statistics.received[name],
                'used': of.used(name),
                'refused': statistics.rejected[name],
                'sightings_used': statistics.observations_used[name],
                'located_anew': statistics.relocalized[name],
                'refusals': {reason.value: n for reason, n in statistics.rejection_counts[name].items()},
                'frame': frame(name),
            } for name in names},
    }


def _setting(settings: RunSettings) -> dict[str, Any]:
    """Return under which parameters and on what a run was made."""
    return {
        'config': as_parameters(settings),
        'versions': {
            'fej_slam_ros': __version__, 'rosbags': version('rosbags'),
            'numpy': np.__version__, 'scipy': scipy.__version__,
            'python': platform.python_version(), 'machine': platform.machine()},
    }


def _scores(
    scores: Mapping[str, PoseScore], landmarks: Sequence[tuple[Array, Array]]
) -> dict[str, Mapping[str, Any]]:
    """Return RMSE and NEES of poses, and of landmarks with these errors and covariances."""
    rmse: dict[str, Any] = {
        name: {
            'steps': score.steps, 'position': score.position_rmse(),
            'heading': score.heading_rmse()}
        for name, score in scores.items()}
    ratings: dict[str, Any] = {name: score.mean_nees() for name, score in scores.items()}
    if landmarks:
        rmse['landmarks'] = math.sqrt(sum(float(e @ e) for e, _ in landmarks) / len(landmarks))
        ratings['landmarks'] = sum(float(nees(e, P)) for e, P in landmarks) / len(landmarks)
    return {'rmse': rmse, 'nees': ratings} if rmse else {}


def _landmark_errors(estimator: Estimator) -> list[tuple[Array, Array]]:
    if not estimator.settings.shared_landmark_ids:
        return []
    truth = estimator.truth.landmarks
    return [
        (landmark.position - truth[landmark.id], landmark.P)
        for landmark in estimator.landmarks() if landmark.id in truth]


def _smoothed_errors(team: TeamSmoother) -> list[tuple[Array, Array]]:
    truth = team.truth.landmarks
    return [
        (point - truth[number], P)
        for solved in team.solution.maps
        if solved.frame == MAP and team.settings.shared_landmark_ids
        for ((_, number), *_), point, P in zip(solved.landmarks, solved.points, solved.P)
        if number in truth]
