# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Base class of the nodes `estimator` and `smoother`, which run a session on topics.

``main`` of each node calls `event_loop.spin`, which creates the node and calls `event_loop.serve`
until the end: add all messages that have arrived, then process the steps that are due.
"""

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
from itertools import count, islice
from pathlib import Path
from time import perf_counter

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from std_srvs.srv import Trigger

from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.nodes.lifecycle_node import ManagedNode
from fej_slam_ros.ros.nodes.ros_process import descriptor
from fej_slam_ros.ros.nodes.topics import NodeTopics
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.session.session import Session

#: Period of /diagnostics [s], as REP-107 recommends.
DIAGNOSTICS_PERIOD = 1.0


class SessionNode(ManagedNode):
    """
    A lifecycle node that runs a session: declares parameters, adds messages, publishes results.

    Attributes
    ----------
    received : number of messages received
    callbacks : number of callbacks handled
    is_active : whether the node is in the lifecycle state active
    is_behind : whether more work is due immediately, even without a message

    """

    _session: Session

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.received = self.callbacks = 0
        self.is_active = self.is_behind = False
        self._settings = self._next_settings = self._read_settings()
        self._last_input: int | None = None
        self._topics = NodeTopics(self, self._receive)
        self._has_session = False
        # Maps and paths are published one by one, so that no step waits for all of them.
        self._pending_maps: Iterator[Publication] = iter(())
        # Callbacks that undo `configure` and `activate`.
        self._configured, self._activated = ExitStack(), ExitStack()

    def new_session(self, settings: RunSettings) -> Session:
        """Return a new session."""
        raise NotImplementedError

    def work(self) -> None:
        """Process the steps that are due; called after all messages that arrived are added."""
        raise NotImplementedError

    def start(self) -> None:
        """Configure and activate the node if the parameter ``autostart`` is true."""
        if self._settings.node.autostart:
            self.transition(self.trigger_configure)
            self.transition(self.trigger_activate)

    def configure(self) -> None:
        """Start a session and create its outputs."""
        self._start_session(self._next_settings)
        self._has_session = True
        self._configured.callback(self._discard_files)
        self._configured.callback(self._topics.match_outputs, {}, active=False)
        self._match_topics()
        reset = self.create_service(Trigger, '~/reset', self._reset)
        self._configured.callback(self.destroy_service, reset)

    def activate(self) -> None:
        """Subscribe to the inputs and start the timers."""
        self.is_active = True
        self._activated.callback(self._topics.match_inputs, {})
        self._match_topics()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        for period, callback in (
            (DIAGNOSTICS_PERIOD, self._publish_diagnostics),
            (self._settings.node.map_period, self._renew_pending_maps),
        ):
            timer = self.create_timer(period, self.timed_callback()(callback), clock=steady)
            self._activated.callback(self.destroy_timer, timer)
        self._warn_of_unused_overrides()

    def deactivate(self) -> None:
        """Process and publish the waiting steps, as during a pause of the input."""
        self._stop_listening()
        self._topics.publish(self._session.release())
        self._publish_maps_and_diagnostics()

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
        """Shut down at the end of the process, and wait for the last messages to arrive."""
        if not self.is_finalized:
            self.transition(self.trigger_shutdown)
        self._topics.wait_for_arrival()

    @contextmanager
    def timed_callback(self) -> Iterator[None]:
        """Measure a callback, which blocks all others for its duration."""
        begin = perf_counter()
        yield
        self.callbacks += 1
        if self._has_session:
            self._session.diagnostics.callback_times.append(perf_counter() - begin)

    def _read_settings(self) -> RunSettings:
        settings = parameters.parse(self.given, self.get_logger().warning)
        known = parameters.known_parameters([robot.name for robot in settings.estimation.robots])
        accepted = known.keys() | parameters.RENAMED_PARAMETERS.keys()
        for name in self.given:
            if name in accepted or name.startswith(parameters.QOS_OVERRIDES):
                self.undeclare_parameter(name)
        # Parameters are declared again as parsed: an integer has become a float. Overrides of the
        # quality of service are declared with their topics.
        for name, value in parameters.as_parameters(settings).items():
            described = descriptor(known[name], self._is_read_only(name))
            self.declare_parameter(name, value, described, ignore_override=True)
        return settings

    def _is_read_only(self, name: str) -> bool:
        return True

    def _warn_of_unused_overrides(self) -> None:
        for name in self.given:
            if name.startswith(parameters.QOS_OVERRIDES) and not self.has_parameter(name):
                self.get_logger().warning(
                    f'parameter {name!r} has no effect: this node has no such topic or policy')

    def _stop_listening(self) -> None:
        self.is_active = False
        self._last_input = None
        self._activated.close()

    def _start_session(self, settings: RunSettings) -> None:
        self._session = self.new_session(settings)
        self._session.diagnostics.node_name = self.get_fully_qualified_name().lstrip('/')
        self._pending_maps = iter(())
        self._last_input = None

    def _end_session(self) -> None:
        self._topics.publish(self._session.close())
        self._publish_maps_and_diagnostics()
        summary = self._session.write_files()
        self.get_logger().info(f'state hash {summary["state_hash"]}')
        output = self._session.settings.node.output
        if output:
            self.get_logger().info(f'files are in {output}')
        self._next_settings = self._session.next_settings(self._next_output())

    def _restart(self) -> None:
        ended = self._session
        self._topics.publish(ended.close())
        ended.write_files()
        self._start_session(ended.next_settings(self._next_output()))
        self._session.continue_from(ended)

    def _discard_files(self) -> None:
        self._session.discard_files()

    def _next_output(self) -> str:
        """Return a new folder for the files of the next run, '' for no files."""
        output = self._settings.node.output
        folders = (f'{output}_{number}' for number in count(2))
        return output and next(folder for folder in folders if not Path(folder).exists())

    def _match_topics(self) -> None:
        """Create the outputs and, if active, the inputs of the present team; destroy others."""
        self._topics.match_outputs(self._session.outputs.topics, self.is_active)
        self._topics.match_inputs(self._session.inputs.topics if self.is_active else {})

    def _receive(self, topic: str, type_name: str, raw: bytes) -> None:
        with self.timed_callback():
            self.received += 1
            self._last_input = now = self._now()
            self._session.receive(RawMessage(topic, type_name, now, raw))
            if self._session.must_restart():
                self.get_logger().warning('time jumped back: a new run begins')
                self._restart()

    def _is_input_paused(self) -> bool:
        """Return whether input has arrived before, but not for ``stale_after``."""
        now = self._now()
        if now is None or self._last_input is None:
            return False
        # The input has also ended if the clock went back.
        return not 0 <= now - self._last_input <= self._settings.estimation.stale_after * 1e9

    def _publish_next_map(self) -> bool:
        """Publish one pending map or path; return whether there was any."""
        return self._topics.publish(islice(self._pending_maps, 1)) > 0

    def _renew_pending_maps(self) -> None:
        # Maps that take longer than the period are published completely first.
        if not self._publish_next_map():
            self._pending_maps = self._session.outputs.maps_and_paths(self._topics.is_wanted)

    def _publish_maps_and_diagnostics(self) -> None:
        self._topics.publish(self._session.outputs.maps_and_paths(self._topics.is_wanted))
        self._publish_diagnostics()

    def _publish_diagnostics(self) -> None:
        diagnostics, incompatible = self._session.diagnostics, self._topics.incompatible()
        for endpoint in incompatible:
            if endpoint not in diagnostics.incompatible:
                self.get_logger().error(str(endpoint))
        diagnostics.incompatible = incompatible
        diagnostics.publishers = self._topics.publishers(incompatible)
        at_rest = self._last_input is None
        self._topics.publish([diagnostics.report(self._now() or 0, at_rest)])

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self.timed_callback():
            self._restart()
        response.success = True
        response.message = 'a new run begins with the next input'
        return response

    def _now(self) -> int | None:
        """Return ROS time [ns], None while simulated time has not begun."""
        return self.get_clock().now().nanoseconds or None
