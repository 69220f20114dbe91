# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The smoother as a node: topics in, smoothed ways and the joined map out.

New poses are settled among the callbacks, a few at a time. What takes long, the solution for
everything, is found in another process from a copy of all that was measured, again and again; what
has come meanwhile moves with it. What is left is done in small pieces, so that nothing waits long.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
import sys
from time import perf_counter

from fej_slam_ros.core.csam.team_solution import SmoothingTask, solve, TeamMap
from fej_slam_ros.ros.nodes.session_node import RunNode, spin
from fej_slam_ros.ros.nodes.worker_process import Worker
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.session.smoother_session import SmootherSession

NODE = 'smoother'
#: A solution is begun when so many poses have come since the last one was, or robots met.
NEW_POSES = 50
#: Poses are added for so long [s] before messages are taken in again.
BUDGET = 0.01


class SmootherNode(RunNode):
    """A run of the smoother, solved for in a process beside it."""

    _run: SmootherSession
    _worker: Worker[SmoothingTask, TeamMap]

    def __init__(self) -> None:
        super().__init__(NODE)
        self._solving_since: float | None = None
        self.start()

    def new_run(self, settings: RunSettings) -> SmootherSession:
        """Return a run that begins; nothing is solved for as a whole in this process."""
        folder = Path(settings.node.output) if settings.node.output else None
        return SmootherSession(settings, folder, solve_every=sys.maxsize)

    def configure(self) -> None:
        """Begin a run and create its outputs."""
        self._worker = Worker(solve)
        self._configured.callback(self._end_worker)
        super().configure()

    def work(self) -> None:
        """Do one piece of what is to be done."""
        self.is_behind = self._solve_beside() or self._add_poses() or self._tell()

    def _begin(self, settings: RunSettings) -> None:
        super()._begin(settings)
        if self._solving_since is not None:
            # It solves for the run that has ended.
            self._restart_worker()

    def _end_worker(self) -> None:
        self._worker.close()
        self._solving_since = None

    def _restart_worker(self) -> None:
        self._end_worker()
        self._worker = Worker(solve)

    def _solve_beside(self) -> bool:
        """Adopt a solution that has come, or begin another; return whether there was either."""
        try:
            solution = self._worker.result()
        except EOFError:
            self.get_logger().error('the process that solves has ended: another one is started')
            self._restart_worker()
            return False
        if solution is not None and self._solving_since is not None:
            self._run.diagnostics.solve_time = perf_counter() - self._solving_since
            self._solving_since = None
            self._topics.publish(self._run.adopt(solution))
            return True
        if not self._worker.is_ready or not self._is_solution_due():
            return False
        self._solving_since = perf_counter()
        self._worker.begin(self._run.team.task())
        return True

    def _is_solution_due(self) -> bool:
        team = self._run.team
        is_at_rest = self._last_input is None
        return team.new_measurements > 0 or team.new_poses >= (1 if is_at_rest else NEW_POSES)

    def _add_poses(self) -> bool:
        """Add and publish poses that are due for a while; return whether more may be."""
        if self._publish_some(self._run.take):
            return True
        if self._is_input_at_rest():
            if self._publish_some(self._run.release):
                return True
            self._last_input = None
        return False

    def _publish_some(self, poses: Callable[[int], Iterator[Publication]]) -> bool:
        """Publish pose by pose for a while; return whether there may be more."""
        begin = now = perf_counter()
        while now - begin < BUDGET:
            if not self._topics.publish(poses(1)):
                return False
            before, now = now, perf_counter()
            self._run.diagnostics.step_times.append(now - before)
        return True


def main(ros_args: Sequence[str]) -> int:
    """Run the node until SIGINT or SIGTERM, or until it is shut down."""
    return spin(ros_args, SmootherNode)
