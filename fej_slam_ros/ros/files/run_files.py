# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Output files of a run, the same for `replay`, `smooth` and a node.

Rows are written during the run, into ``*.part`` files that are renamed when they are complete.
"""

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import chain
import math
from pathlib import Path
from typing import Any

from fej_slam_ros.atomic_files import (
    BUFFER_SIZE, PartFile, refuse_existing, write_csv, write_json, writing)
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NS
from fej_slam_ros.errors import UserError
from fej_slam_ros.output_lock import OutputLock
from fej_slam_ros.ros.files.csv_rows import (
    ID_COLUMNS, landmark_cells, LANDMARK_COLUMNS, pose_line, TRAJECTORY_COLUMNS)
from fej_slam_ros.ros.published_maps import MapEstimate

#: Names of the incomplete files of a run.
INCOMPLETE = (
    'trajectory_*.csv.part', '*.tum.part', 'landmarks.csv.part', 'ids.csv.part',
    'summary.json.part', 'alignment.json.part')


def tum_line(stamp: int, pose: Array) -> str:
    """Return a line of a TUM file for a pose (3,) at a stamp [ns]: t x y z qx qy qz qw."""
    x, y, phi = pose.tolist()
    whole, fraction = divmod(abs(stamp), NS)
    seconds = f'{"-" if stamp < 0 else ""}{whole}.{fraction:09d}'
    return f'{seconds} {x!r} {y!r} 0 0 0 {math.sin(phi / 2.0)!r} {math.cos(phi / 2.0)!r}'


class TrajectoryFiles:
    """Poses of one robot: all of them as CSV, those of the last frame in TUM form for evo."""

    def __init__(self, folder: Path, robot: str) -> None:
        with ExitStack() as on_error:
            self.parts = [
                on_error.enter_context(PartFile(path))
                for path in _trajectory_paths(folder, robot)]
            on_error.pop_all()
        self._csv, self._tum = self.parts
        self._frame = ''
        self._csv.write((','.join(TRAJECTORY_COLUMNS) + '\n').encode())

    def write(self, estimate: PoseEstimate) -> int:
        """Append a pose as published; return the size of the text that waits [bytes]."""
        size = self._csv.write(pose_line(estimate))
        if estimate.frame != self._frame:
            self._frame = estimate.frame
            self._tum.clear()
        return size + self._tum.write(f'{tum_line(estimate.stamp, estimate.pose)}\n'.encode())


class RunFiles:
    """
    Output files of one run; those of an earlier run are only replaced if forced.

    Parameters
    ----------
    robots : names of the initial team
    others : names of further files that the run will write

    Attributes
    ----------
    folder : of the files
    earlier : the process that was killed before its files in the folder were complete, or ''

    """

    def __init__(
        self, folder: Path, robots: Iterable[str], force: bool | None,
        others: Sequence[str] = (),
    ) -> None:
        self.folder = folder
        self._force = force
        self._trajectories: dict[str, TrajectoryFiles] = {}
        self._lock = OutputLock.of_folder(folder)
        self.earlier = self._lock.earlier
        with ExitStack() as on_error:
            on_error.callback(self.discard)
            refuse_existing([*result_paths(folder), *(folder / name for name in others)], force)
            _delete_incomplete(folder)
            self.add_robots(robots)
            on_error.pop_all()

    def add_robots(self, robots: Iterable[str]) -> None:
        """Open the files of robots that have none in this run yet."""
        for name in self.check_robots(robots):
            self._trajectories[name] = TrajectoryFiles(self.folder, name)

    def check_robots(self, robots: Iterable[str]) -> list[str]:
        """Return the robots without files in this run; UsageError if an earlier run has them."""
        new = [name for name in robots if name not in self._trajectories]
        refuse_existing(
            [path for name in new for path in _trajectory_paths(self.folder, name)], self._force)
        return new

    def write(self, poses: Iterable[PoseEstimate]) -> None:
        """Append poses, those of robots without files excepted."""
        for estimate in poses:
            if self._append(estimate) >= BUFFER_SIZE:
                self.flush()

    def flush(self) -> None:
        """Write what waits."""
        for part in self._parts():
            part.flush()

    def discard(self) -> None:
        """Delete the files that are not complete."""
        self._end(lambda part: part.__exit__())

    def complete(
        self, poses: Iterable[PoseEstimate], maps: Iterable[MapEstimate], shared_ids: bool,
        **contents: Mapping[str, Any],
    ) -> None:
        """
        Append the last poses and complete the files of a run that has ended.

        `contents` has the content of JSON files by name. If the disk does not take the
        trajectories, no file is completed.

        """
        for estimate in poses:
            self._append(estimate)
        self.flush()
        self.complete_possible((), maps, shared_ids, **contents)

    def complete_possible(
        self, poses: Iterable[PoseEstimate], maps: Iterable[MapEstimate], shared_ids: bool,
        **contents: Mapping[str, Any],
    ) -> None:
        """
        Complete every file that can be completed; arguments are those of `complete`.

        Raises IncompleteError if there are others.

        """
        for estimate in poses:
            self._append(estimate)
        errors = _errors_of({
            **{part.path.name: part.keep for part in self._parts()},
            'landmarks.csv': partial(self._write_landmarks, maps, shared_ids),
            **{f'{name}.json': partial(write_json, self.folder / f'{name}.json', content)
               for name, content in contents.items()},
            'files of an earlier run': partial(self._delete_earlier, contents)})
        self._end(PartFile.close)
        if errors:
            raise IncompleteError(errors)

    def _delete_earlier(self, contents: Container[str]) -> None:
        """Delete what an earlier run has left, which would count as part of this one."""
        if not self._force:
            return
        left = [] if 'alignment' in contents else [self.folder / 'alignment.json']
        for path in self.folder.glob('trajectory_*.csv'):
            robot = path.stem.removeprefix('trajectory_')
            if robot not in self._trajectories:
                left += _trajectory_paths(self.folder, robot)
        with writing(f'to {self.folder}'):
            for path in left:
                path.unlink(missing_ok=True)

    def _append(self, estimate: PoseEstimate) -> int:
        """Append a pose in memory; return the size of what waits for its robot [bytes]."""
        trajectory = self._trajectories.get(estimate.robot)
        return 0 if trajectory is None else trajectory.write(estimate)

    def _parts(self) -> Iterator[PartFile]:
        return chain.from_iterable(one.parts for one in self._trajectories.values())

    def _end(self, close: Callable[[PartFile], object]) -> None:
        for part in self._parts():
            close(part)
        self._lock.release()

    def _write_landmarks(self, maps: Iterable[MapEstimate], shared_ids: bool) -> None:
        rows: list[Sequence[object]] = [LANDMARK_COLUMNS]
        ids: list[Sequence[object]] = [ID_COLUMNS]
        for estimate in maps:
            for landmark, keys, point, P in zip(
                    estimate.ids, estimate.keys, estimate.points, estimate.P):
                rows.append(landmark_cells(landmark, estimate.frame, point, P))
                ids += [(landmark, *key) for key in keys]
        write_csv(self.folder / 'landmarks.csv', rows)
        if shared_ids:
            # An ids.csv of an earlier run would explain other IDs.
            with writing(self.folder / 'ids.csv'):
                (self.folder / 'ids.csv').unlink(missing_ok=True)
        else:
            write_csv(self.folder / 'ids.csv', ids)


class IncompleteError(UserError):
    """Files of a run that could not be completed, given with their errors in order of time."""

    def __init__(self, errors: Mapping[str, UserError]) -> None:
        self.consequence = f'not complete: {", ".join(errors)}'
        super().__init__(f'{next(iter(errors.values()))}; {self.consequence}')


def _errors_of(writers: Mapping[str, Callable[[], None]]) -> dict[str, UserError]:
    """Write files by name; return the error of each that was not written."""
    errors = {}
    for name, write in writers.items():
        try:
            write()
        except UserError as error:  # noqa: PERF203
            errors[name] = error
    return errors


def _delete_incomplete(folder: Path) -> None:
    """Delete the incomplete files of a killed run in a folder that this run has locked."""
    with writing(f'to {folder}'):
        for pattern in INCOMPLETE:
            for path in folder.glob(pattern):
                path.unlink()


def result_paths(folder: Path, robots: Iterable[str] = ()) -> list[Path]:
    """Return the files that every run has, and those of the poses of some robots."""
    names = 'summary.json', 'landmarks.csv', 'ids.csv'
    return [
        *(folder / name for name in names),
        *(path for robot in robots for path in _trajectory_paths(folder, robot))]


def _trajectory_paths(folder: Path, robot: str) -> tuple[Path, Path]:
    return folder / f'trajectory_{robot}.csv', folder / f'{robot}.tum'
