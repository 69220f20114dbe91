# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The node ``smoother``: odometry and observations in, smoothed trajectories and merged maps out.

New poses are added between callbacks, a few at a time. The solution for all measurements takes
long, so another process computes it from a copy of them; poses added meanwhile follow from it.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
import sys
from time import perf_counter, sleep
from typing import Any

from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.nodes.event_loop import spin
from fej_slam_ros.ros.nodes.ros_process import Stop
from fej_slam_ros.ros.nodes.session_node import SessionNode
from fej_slam_ros.ros.nodes.worker_process import FailedTask, Worker
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.session.peer_session import PeerSession
from fej_slam_ros.ros.session.smoother_session import SmootherSession

#: Number of new poses after which everything is solved again; fewer would keep a core busy.
NEW_POSES = 50
#: Period [s] in which messages to other smoothers are sent.
EXCHANGE_PERIOD = 0.1
#: Duration [s] for which poses are added before messages are handled again.
ADDING_TIME = 0.01
#: Period [s] in which the node looks for the final solution, and whether it is still wanted.
FINAL_CHECK_PERIOD = 0.02
#: Time [s] after which the wait for it is logged.
FINAL_NOTE_AFTER = 1.0
#: Number of processes that may die during it.
FINAL_ATTEMPTS = 3


class SmootherNode(SessionNode):
    """A session of the smoother, with a worker process for the solutions."""

    audience = parameters.SMOOTHER
    tf_parameter = 'publish_smoothed_tf'
    _session: SmootherSession
    _worker: Worker

    def __init__(self, stop: Stop) -> None:
        super().__init__('smoother', stop)
        self._solving_since: float | None = None
        self.start()

    def new_session(self, settings: RunSettings, folder: Path | None) -> SmootherSession:
        """Return a new session, which solves for no complete map in this process."""
        new = (
            partial(PeerSession, open_exchange=self._files.open_exchange) if settings.node.peers
            else SmootherSession)
        session = new(
            settings, folder, solve_every=sys.maxsize, open_files=self._files.open,
            solve_finally=self._solve_finally)
        session.check_starts(self._topics.first_messages)
        return session

    def configure(self) -> None:
        self._start_worker()
        self._configured.callback(self._end_worker)
        super().configure()

    def _changed_estimation(self, values: Mapping[str, Any]) -> Settings:
        """Change the team by the parameter ``robots``, or ``peers`` if there are any."""
        if self._settings.node.peers and 'robots' in values:
            raise UsageError(
                "a smoother with 'peers' has one robot: change 'peers', or start it again")
        if 'peers' in values:
            own, *_ = self._settings.estimation.robots
            values = {'robots': [own.name, *values['peers']]}
        return super()._changed_estimation(values)

    def work(self) -> None:
        """Do one of: adopt or request a solution, add poses, publish a pending map."""
        self.is_behind = (
            self._advance_solution() or self._add_poses() or self._maps.publish_next())
        self._saver.work(self._settings.node.autosave_period)

    def _start_session(self, settings: RunSettings) -> None:
        super()._start_session(settings)
        if self._solving_since is not None:
            # The worker solves for the session that has ended.
            self._end_worker()
            self._start_worker()

    def activate(self) -> None:
        """Subscribe to the inputs and start the timers, that of the exchange too."""
        super().activate()
        if self._settings.node.peers:
            self.start_timer(EXCHANGE_PERIOD, self._exchange)

    def _exchange(self) -> None:
        """Publish what is due to be sent to other smoothers."""
        self._topics.publish(self._session.exchange())

    def _start_worker(self) -> None:
        self._worker = Worker()
        self._reported_deaths = 0

    def _end_worker(self) -> None:
        self._worker.close()
        self._solving_since = None

    def _advance_solution(self) -> bool:
        """Adopt a finished solution, or request one that is due; return whether it did either."""
        solution = self._worker.result()
        self._report_deaths()
        if solution is not None and self._solving_since is not None:
            duration, self._solving_since = perf_counter() - self._solving_since, None
            if isinstance(solution, FailedTask):
                self._session.give_up(solution.argument, solution.error)
            else:
                self._session.diagnostics.solve_time = duration
                self._topics.publish(self._session.adopt(solution))
            return True
        # At rest, a new pose does not wait for others.
        new_poses = 1 if self._pause.is_at_rest else NEW_POSES
        if not (self._worker.is_ready and self._session.is_solution_due(new_poses)):
            return False
        self._solving_since = perf_counter()
        self._worker.begin(*self._session.solving())
        return True

    def _solve_finally(self, function: Callable[[Any], Any], task: Any) -> Any:
        """Return the final solution; None if the process is to end at once or none is found."""
        if self._solving_since is not None or self._worker.fault:
            # The worker solves for fewer poses, or waits before it starts again.
            self._end_worker()
            self._start_worker()
        self._worker.begin(function, task)
        begin, last_death, is_noted = perf_counter(), self._worker.deaths + FINAL_ATTEMPTS, False
        while self._worker.deaths < last_death and not self._stop.is_urgent():
            final = self._worker.result()
            self._report_deaths()
            if isinstance(final, FailedTask):
                self._session.give_up(task, final.error)
                break
            if final is not None:
                return final
            if not is_noted and perf_counter() - begin > FINAL_NOTE_AFTER:
                is_noted = True
                self.get_logger().info(
                    'computing the final solution; a second signal keeps the one before')
            sleep(FINAL_CHECK_PERIOD)
        self.get_logger().warning(
            'no final solution: the poses since the last one are those of the filter')
        self._solving_since = begin
        return None

    def _report_deaths(self) -> None:
        diagnostics = self._session.diagnostics
        diagnostics.solver_fault = self._worker.fault
        if self._worker.deaths > self._reported_deaths:
            self._reported_deaths = self._worker.deaths
            diagnostics.solver_restarts += 1
            self.get_logger().error(self._worker.fault)

    def _add_poses(self) -> bool:
        """Add and publish due poses for a short time; return whether there may be more."""
        if self._publish_some(self._session.take):
            return True
        if self._is_input_paused():
            if self._publish_some(self._session.release):
                return True
            self._pause.rest()
        return False

    def _publish_some(self, poses: Callable[[int], Iterator[Publication]]) -> bool:
        begin = now = perf_counter()
        while now - begin < ADDING_TIME:
            if not self._topics.publish(poses(1)):
                return False
            before, now = now, perf_counter()
            self._session.diagnostics.step_times.append(now - before)
        return True


#: Runs the node until SIGINT, SIGTERM or its lifecycle shutdown; returns the exit status.
main = partial(spin, make_node=SmootherNode)
