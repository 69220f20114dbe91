# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node ``estimator``: odometry and observations in, poses, map and diagnostics out."""

from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from fej_slam_ros.core.pieces import between_pieces
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages.common import from_time
from fej_slam_ros.ros.nodes.event_loop import spin
from fej_slam_ros.ros.nodes.ros_process import Stop
from fej_slam_ros.ros.nodes.session_node import SessionNode
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.live_outputs import LiveOutputs
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.topic_types import INITIALPOSE

#: Duration of due steps [s] after which waiting messages are handled first: the steps that a slow
#: robot has delayed must not delay the predicted poses of others. It is longer for steps that have
#: waited for the processor for some time [s]: the fewer the changes between messages and steps,
#: the faster are both.
MAX_STEPS_TIME, MAX_LATE_STEPS_TIME, LATE_AFTER = 0.005, 0.05, 0.1
#: Period [s] in which odometry is handled during a long step.
SERVING_PERIOD = 0.02
#: Duration [s] for which due steps may wait for the processor before scans are rejected, and the
#: period of that; number of observations above which a scan is large; rate [Hz] above which scans
#: of a robot are a flood, and number of them that may wait.
MAX_TIME_BEHIND, SHEDDING_PERIOD = 1.0, 0.1
LARGE_SCAN = 200
FLOOD_RATE, MAX_LATE_SCANS = 100.0, 1000


class EstimatorNode(SessionNode):
    """A session of the estimator, whose team may change and which can be saved."""

    tf_parameter = 'publish_tf'
    _session: EstimatorSession

    def __init__(self, stop: Stop) -> None:
        super().__init__('estimator', stop)
        self._served_at = monotonic()
        self._behind_since: float | None = None
        self._has_served = False
        self.start()

    def new_session(self, settings: RunSettings, folder: Path | None) -> EstimatorSession:
        """Return a new session, which may continue from a checkpoint."""
        # A reset needs no file that may be gone.
        prior = self._session.prior if self._has_session else None
        session = EstimatorSession(
            settings, folder, outputs=LiveOutputs, open_files=self._files.open, prior=prior)
        session.check_starts(self._topics.first_messages)
        return session

    def work(self) -> None:
        """Process the steps that are due, and publish one pending map or path."""
        self._has_served = False
        with between_pieces(self._serve_odometry, self._stop.is_overdue):
            is_late = self._publish_due_steps()
            if self._is_input_paused():
                self._pause.rest()
                while self._publish(self._session.release(1)) and not self._has_served:
                    pass
            self.is_behind = self._maps.publish_next() or is_late or self._has_served
        self._saver.work(self._settings.node.autosave_period)

    def _publish_due_steps(self) -> bool:
        """Process due steps for a limited time; return whether more may be due."""
        end = monotonic() + self._steps_time()
        while self._publish(self._session.take(1)):
            # After odometry alone, the next step would lack the observations that have arrived.
            if self._has_served or monotonic() >= end:
                self._shed_load()
                return True
        self._behind_since = None
        return False

    def _steps_time(self) -> float:
        """Return the longest duration of due steps [s] before messages are handled."""
        since = self._behind_since
        is_late = since is not None and monotonic() - since > LATE_AFTER
        return MAX_LATE_STEPS_TIME if is_late else MAX_STEPS_TIME

    def _shed_load(self) -> None:
        """Reject large scans and floods of scans if steps have waited long for the processor."""
        now = monotonic()
        self._behind_since = self._behind_since or now
        if now - self._behind_since > MAX_TIME_BEHIND + SHEDDING_PERIOD:
            self._behind_since = now - MAX_TIME_BEHIND
            self._session.estimator.sequencer.shed(
                LARGE_SCAN, MAX_LATE_SCANS, FLOOD_RATE)

    def _serve_odometry(self) -> None:
        """Handle odometry that has arrived during a step, for predicted poses."""
        now = monotonic()
        if now - self._served_at >= SERVING_PERIOD:
            self._served_at, self._is_in_step = now, True
            self._has_served |= self.take_messages('odom') > 0
            self._is_in_step = False

    def _changed_estimation(self, values: Mapping[str, Any]) -> Settings:
        """Change the team by the parameter ``robots``, then the other parameters."""
        settings = super()._changed_estimation(values)
        others = {name: value for name, value in values.items() if name != 'robots'}
        if not self._has_session:
            return parameters.with_values(settings, others.items())
        if others:
            self._session.change_parameters(others)
        return self._session.present_settings()

    def _receive(self, topic: str, type_name: str, raw: bytes) -> None:
        super()._receive(topic, type_name, raw)
        if topic == INITIALPOSE and self._session.inputs.robot_of_initialpose() is None:
            robots = ', '.join(self._session.estimator.robots)
            self.get_logger().warning(
                f"{INITIALPOSE} is not used: set the parameter 'initialpose_robot' to its robot,"
                f' one of {robots}', throttle_duration_sec=10.0)

    def _publish(self, publications: Iterable[Publication]) -> int:
        """Publish messages, with the latency of poses; return their number."""
        published, latencies = 0, self._session.diagnostics.latencies
        for topic, message in publications:
            published += self._topics.publish([(topic, message)])
            if topic.endswith('/pose') and (now := self._now()) is not None:
                latencies.append((now - from_time(message.header.stamp)) / NS)
        return published


#: Runs the node until SIGINT, SIGTERM or its lifecycle shutdown; returns the exit status.
main = partial(spin, make_node=EstimatorNode)
