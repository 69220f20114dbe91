# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Base class of the nodes `estimator` and `smoother`, which run a session on topics.

``main`` of each node calls `event_loop.spin`, which creates the node and calls `event_loop.serve`
until the end: add all messages that have arrived, then process the steps that are due.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

from rclpy.timer import Timer
from std_srvs.srv import Trigger

from fej_slam_ros.core.pieces import between_pieces, EndedError
from fej_slam_ros.core.records import NS, PosePrior
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.nodes import log_writer
from fej_slam_ros.ros.nodes.endpoints import end_service
from fej_slam_ros.ros.nodes.input_pause import InputPause
from fej_slam_ros.ros.nodes.live_parameters import LiveParameters
from fej_slam_ros.ros.nodes.map_publisher import MapPublisher
from fej_slam_ros.ros.nodes.node_diagnostics import NodeDiagnostics
from fej_slam_ros.ros.nodes.node_files import next_folder, NodeFiles, REQUEST_WAIT
from fej_slam_ros.ros.nodes.ros_process import Stop
from fej_slam_ros.ros.nodes.run_saver import RunSaver
from fej_slam_ros.ros.nodes.settings_node import SettingsNode
from fej_slam_ros.ros.nodes.team_endpoints import TeamEndpoints
from fej_slam_ros.ros.nodes.topics import NodeTopics
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.diagnostics import DIAGNOSTICS_PERIOD
from fej_slam_ros.ros.session.late_starts import StartCheck
from fej_slam_ros.ros.session.session import Session
from fej_slam_ros.ros.topic_types import EXCHANGE_TOPIC


class SessionNode(SettingsNode):
    """
    A lifecycle node that runs a session: adds messages, publishes results.

    Parameters
    ----------
    stop : request to end the process, which limits the work at the end

    Attributes
    ----------
    exit_status : of the process: 1 if files are not complete
    received : number of messages received
    taken : number of messages taken without the executor since its last rounds
    is_active : whether the node is in the lifecycle state active
    is_behind : whether more work is due immediately, even without a message

    """

    _session: Session

    def __init__(self, name: str, stop: Stop) -> None:
        super().__init__(name)
        self._stop = stop
        self.received = self.taken = 0
        self.is_active = self.is_behind = False
        self._pause = InputPause()
        self._topics = NodeTopics(self, self._receive)
        self._files = NodeFiles(self.get_logger())
        self._maps = MapPublisher(self._topics, stop.is_overdue)
        self._diagnostics = NodeDiagnostics(self, self._topics, self._files)
        self._saver = RunSaver(self.get_logger(), self._files, lambda: self._session)
        self._endpoints = TeamEndpoints(self, self._topics, self._relocalization)
        self._has_session = self._is_in_step = False
        self._live_parameters = LiveParameters(
            self, self._change_parameters, self._changeable_values)
        # Callbacks that undo `configure` and `activate`.
        self._configured, self._activated = ExitStack(), ExitStack()

    def new_session(self, settings: RunSettings, folder: Path | None) -> Session:
        """Return a new session with a folder for its files, None for no files."""
        raise NotImplementedError

    @property
    def exit_status(self) -> int:
        return 1 if self._files.has_failed else 0

    def work(self) -> None:
        """Process the steps that are due; called after all messages that arrived are added."""
        raise NotImplementedError

    def write_log(self) -> None:
        """Write the new lines of the log of the session."""
        log_writer.write(self.get_logger(), self._session.log.take())

    def start(self) -> None:
        """Configure and activate the node if the parameter ``autostart`` is true."""
        if self._settings.node.autostart:
            self.transition(self.trigger_configure)
            self.transition(self.trigger_activate)
        else:
            name = self.get_fully_qualified_name()
            self.get_logger().info(
                'not started, as autostart is false: configure and activate it, for example by'
                f' ros2 lifecycle set {name} configure')
        if self._lacks_tf():
            self.get_logger().info(
                'transforms are not published on /tf because tf2_msgs is missing: install'
                f' ros-jazzy-tf2-msgs, or set {self.tf_parameter} to false')

    def configure(self) -> None:
        """Start a session and create its outputs."""
        self._configured.callback(self._files.close)
        self._files.open_checkpoint(self._next_settings.node.checkpoint)
        self._start_session(self._next_settings)
        self._has_session = True
        self._settings = replace(self._settings, estimation=self._session.present_settings())
        # A restored run may have another team, and parameters that were changed.
        self._live_parameters.match()
        self._configured.callback(self._discard_files)
        self._configured.callback(self._endpoints.close)
        self._endpoints.match(self._session, self.is_active)
        for service in (
                self.create_service(Trigger, '~/reset', self._reset),
                self.create_service(Trigger, '~/save', self._saver.save)):
            self._configured.callback(end_service, self, service)
        names = log_writer.grouped(map(self.resolve_topic_name, self._session.inputs.topics))
        self.get_logger().info(f'configured: {self._session.log.description()}; inputs {names}')

    def activate(self) -> None:
        """Subscribe to the inputs and start the timers."""
        self.is_active = True
        self._activated.callback(self._topics.match_inputs, {})
        self._endpoints.match(self._session, self.is_active)
        self._map_timer = self.start_timer(
            self._settings.node.map_period, lambda: self._maps.renew(self._session.outputs))
        self.start_timer(DIAGNOSTICS_PERIOD, self._publish_diagnostics)
        self._warn_of_unused_overrides()
        self.get_logger().info('active')

    def deactivate(self) -> None:
        """Process and publish the waiting steps, as during a pause of the input."""
        self._stop_listening()
        self._topics.publish(self._session.release())
        self._publish_maps_and_diagnostics()
        self.get_logger().info('inactive')

    def clean_up(self) -> None:
        """Complete the files and delete the session."""
        self._end_session()
        self._topics.wait_for_arrival()
        self.dispose()

    def finish(self) -> None:
        """Process and publish the last steps and complete the files."""
        self._stop_listening()
        if self._has_session:
            self._end_session()

    def dispose(self) -> None:
        """Delete the session and its incomplete files."""
        self._stop_listening()
        self._configured.close()
        self._has_session = False

    def close(self) -> None:
        """Shut down at the end of the process; if not urgent, wait for arrival of all messages."""
        if not self.is_finalized:
            self.transition(self.trigger_shutdown)
        self._topics.wait_for_arrival(self._stop.is_urgent)

    def take_messages(self, kind: str = '') -> int:
        """Handle what has arrived on all topics, or on those of a kind; return the number."""
        taken = self._topics.take(kind)
        self.taken += taken
        return taken

    @contextmanager
    def timed_callback(self) -> Iterator[None]:
        """Measure a callback, which blocks all others for its duration."""
        begin = perf_counter()
        yield
        if self._has_session:
            self._session.diagnostics.callback_times.append(perf_counter() - begin)

    def start_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """Call a function once in a period [s] of real time until the node is inactive."""
        timer = self.create_steady_timer(period, self.timed_callback()(callback))
        self._activated.callback(self.destroy_timer, timer)
        return timer

    def _change_parameters(self, values: Mapping[str, Any]) -> None:
        """Change the parameters of the node, or raise a UserError before any is changed."""
        checked = parameters.checked_changes(self._settings, values, self.audience)
        node = parameters.with_node_values(self._settings.node, checked)
        estimation = self._changed_estimation({
            name: value for name, value in checked.items()
            if name not in vars(node) or name == 'peers'})
        self._settings = RunSettings(estimation, node)
        if self._has_session:
            self._session.change_node_settings(
                parameters.with_node_values(self._session.settings.node, checked))
        else:
            # The next run has another output folder than the first, and restores nothing.
            self._next_settings = self._next_settings.followed_by(
                estimation, parameters.with_node_values(self._next_settings.node, checked))
        if self.is_active:
            self._map_timer.timer_period_ns = round(node.map_period * NS)

    def _changed_estimation(self, values: Mapping[str, Any]) -> Settings:
        """Change the team by the parameter ``robots``; return the settings of estimation."""
        if 'robots' in values:
            self._change_team(values['robots'])
        return self._session.present_settings() if self._has_session else self._settings.estimation

    def _change_team(self, names: Sequence[str]) -> None:
        if not self._has_session:
            raise UsageError('the team can only change during a run: configure the node first')
        self._endpoints.check_robots(self._session, names)
        self._session.change_team(names)
        self._maps.drop()
        self._endpoints.match(self._session, self.is_active)

    def _stop_listening(self) -> None:
        self.is_active = False
        self._pause.rest()
        self._activated.close()

    def _start_session(self, settings: RunSettings) -> None:
        self._files.begin(is_first=not self._has_session)
        folder = Path(settings.node.output) if settings.node.output else None
        self._session = self.new_session(settings, folder)
        if settings.node.restore:
            self.get_logger().info(
                f'the run continues from {settings.node.restore}' if self._session.is_restored else
                f'a new run begins: {settings.node.restore} does not exist yet')
            if changed := parameters.changes_before(self._session.settings):
                self.get_logger().warning(
                    f'the run began with changed parameters, which stay in force: {changed}; to'
                    f' use the given ones, remove {settings.node.restore} before the start')
        self._session.diagnostics.node_name = self.get_fully_qualified_name().lstrip('/')
        self._session.log.topic_name = self.resolve_topic_name
        self._session.outputs.is_wanted = self._topics.is_wanted
        self._maps.drop()
        self._pause.rest()

    def _end_session(self) -> None:
        if self._settings.node.autosave_period:
            self._saver.save_last()
        with between_pieces(lambda: None, self._stop.is_overdue):
            self._topics.publish(self._session.close())
        self.write_log()
        self._publish_maps_and_diagnostics()
        self._session.check_time = self._stop.check_time
        state_hash = self._session.write_files()['state_hash']
        self.get_logger().info(
            f'state hash {state_hash or "is missing: the end was requested before it was known"}')
        output = self._session.settings.node.output
        if self._files.finish() and output:
            self.get_logger().info(f'files are in {output}')
        self._next_settings = self._next_run(self._session)
        self._settings = replace(self._settings, estimation=self._next_settings.estimation)

    def _restart(self) -> str:
        """Begin a new run; return which files of either run are not complete, or ''."""
        ended = self._session
        # A new run begins where the robots are.
        self._topics.first_messages.close()
        self._topics.publish(ended.close())
        self._topics.publish(ended.outputs.cleared_maps())
        self.write_log()
        ended.write_files()
        self._files.end(REQUEST_WAIT)
        self._start_session(self._next_run(ended))
        self._session.inputs.start_check = StartCheck()
        self._session.continue_from(ended)
        return self._files.check().get('output', '')

    def _next_run(self, ended: Session) -> RunSettings:
        """Return the settings of the run that follows another, with a folder of its own."""
        return ended.next_settings(next_folder(self._settings.node.output))

    def _discard_files(self) -> None:
        self._session.discard_files()

    def _relocalization(self, robot: str) -> PosePrior:
        if not self.is_active:
            raise UsageError(f'the {self.get_name()} is not active: activate it first')
        return self._session.relocalization(robot)

    def _receive(self, topic: str, type_name: str, raw: bytes) -> None:
        with self.timed_callback():
            self.received += 1
            now = self._now()
            # Steps do not wait for smoothers of other robots, whose hellos never end.
            if topic != EXCHANGE_TOPIC:
                self._pause.receive(now)
            # Predicted poses do not wait for the steps.
            self._topics.publish(self._session.receive(RawMessage(topic, type_name, now, raw)))
            if self._session.inputs.time_jump_detector.has_ended_run() and not self._is_in_step:
                self.get_logger().warning('time jumped back: a new run begins')
                self._restart()

    def _is_input_paused(self) -> bool:
        return self._pause.has_begun(self._now(), self._settings.estimation.stale_after)

    def _publish_maps_and_diagnostics(self) -> None:
        # Large maps, which take long, are left out when the process is to end.
        with suppress(EndedError), between_pieces(self._stop.check_time):
            self._maps.publish_all(self._session.outputs)
        self._publish_diagnostics()

    def _publish_diagnostics(self) -> None:
        now, at_rest = self._now(), self._pause.is_at_rest and not self._stop.is_overdue()
        self._diagnostics.publish(self._session.diagnostics, now, at_rest)
        if self.is_active:
            self._session.check(now)
            self.write_log()

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self.timed_callback():
            error = self._restart()
        self.get_logger().info('reset: a new run begins with the next input')
        response.success = not error
        response.message = 'a new run begins with the next input' + (error and f', but {error}')
        return response

    def _now(self) -> int | None:
        """Return ROS time [ns], None while simulated time has not begun."""
        self.take_clock()
        return self.get_clock().now().nanoseconds or None
