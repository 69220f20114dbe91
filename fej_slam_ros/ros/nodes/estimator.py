# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator as a node: topics in, fused poses and the map out."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from time import monotonic, perf_counter

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import Trigger

from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.diagnostics import Diagnostics
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.nodes.managed import ManagedNode
from fej_slam_ros.ros.nodes.process import descriptor, ros, RoundExecutor
from fej_slam_ros.ros.nodes.topics import Topics
from fej_slam_ros.ros.run import Run

NODE = 'estimator'
REPORT_PERIOD = 1.0
SPIN_TIMEOUT = 0.1
#: So many messages of each topic are taken in between steps at most.
MAX_ROUNDS = 1000


class EstimatorNode(ManagedNode):
    """
    Declares, converts, calls, converts, publishes.

    Attributes
    ----------
    received : how many messages have come
    is_active : whether it listens to its inputs

    """

    def __init__(self) -> None:
        super().__init__(NODE)
        self.received = 0
        self.is_active = False
        self._settings = self._read_settings()
        lacks_tf = self._settings.publish_tf and find_spec('tf2_msgs') is None
        if lacks_tf:
            self._settings = replace(self._settings, publish_tf=False)
        self._next_settings = self._settings
        self._last_input: int | None = None
        self._saved_at = monotonic()
        self._topics = Topics(self, self._receive)
        self._has_run = False
        # What undoes `configure` and what undoes `activate`.
        self._configured, self._activated = ExitStack(), ExitStack()
        self.add_on_set_parameters_callback(self._set_parameters)
        if self._settings.autostart:
            self.make(self.trigger_configure)
            self.make(self.trigger_activate)
        if lacks_tf:
            self.get_logger().info(
                'no transforms on /tf because tf2_msgs is missing: install ros-jazzy-tf2-msgs, or'
                ' set publish_tf to false')

    def configure(self) -> None:
        """Begin a run and create its outputs."""
        self._begin(self._next_settings)
        self._has_run = True
        self._configured.callback(self._discard)
        self._configured.callback(self._topics.match_outputs, {}, active=False)
        self._match_topics()
        self._tell_team()
        for service in (
            self.create_service(Trigger, '~/reset', self._reset),
            self.create_service(Trigger, '~/save', self._save),
        ):
            self._configured.callback(self.destroy_service, service)

    def activate(self) -> None:
        """Listen, and report."""
        self.is_active = True
        self._activated.callback(self._topics.match_inputs, {})
        self._match_topics()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        timer = self.create_timer(REPORT_PERIOD, self._report, clock=steady)
        self._activated.callback(self.destroy_timer, timer)
        self._warn_of_overrides_without_effect()

    def deactivate(self) -> None:
        """Finish and publish the steps that wait, as where the input rests."""
        self._stop_listening()
        self._topics.publish(self._run.release())
        self._report()

    def clean_up(self) -> None:
        """Complete the files and forget the run."""
        self._end_run()
        self._topics.wait_for_arrival()
        self.forget()

    def finish(self) -> None:
        """Finish and publish the last steps and complete the files."""
        self._stop_listening()
        if self._has_run:
            self._end_run()

    def forget(self) -> None:
        """Leave nothing of the run, and no file that is not complete."""
        self._stop_listening()
        self._configured.close()
        self._has_run = False

    def close(self) -> None:
        """Shut down, the input having ended, and let the last messages arrive."""
        if not self.is_finalized:
            self.make(self.trigger_shutdown)
        self._topics.wait_for_arrival()

    def _read_settings(self) -> Settings:
        settings = parameters.parse(self.given)
        robots = [robot.name for robot in settings.robots]
        told, kinds = parameters.describe(robots), parameters.kinds(robots)
        for name in self.given:
            if name in told or name.startswith(parameters.QOS_OVERRIDES):
                self.undeclare_parameter(name)
        # What was given is declared anew, as checked: an integer has become a float. Overrides of
        # the quality of service are declared with their topics.
        for name, value in parameters.as_parameters(settings).items():
            described = descriptor(told[name], kinds[name], read_only=name != 'robots')
            self.declare_parameter(name, value, described, ignore_override=True)
        return settings

    def _warn_of_overrides_without_effect(self) -> None:
        for name in self.given:
            if name.startswith(parameters.QOS_OVERRIDES) and not self.has_parameter(name):
                self.get_logger().warning(
                    f'parameter {name!r} has no effect: this node has no such topic or policy')

    def _stop_listening(self) -> None:
        self.is_active = False
        self._last_input = None
        self._activated.close()

    def _end_run(self) -> None:
        if self._settings.autosave_period:
            self._autosave()
        self._topics.publish(self._run.close())
        self._report()
        told = self._run.keep()
        self.get_logger().info(f'state hash {told["state_hash"]}')
        output = self._run.estimator.settings.output
        if output:
            self.get_logger().info(f'files are in {output}')
        self._next_settings = self._run.next_settings(self._next_output())

    def _begin(self, settings: Settings) -> None:
        self._run = Run(settings, Path(settings.output) if settings.output else None)
        if settings.restore:
            goes_on = 'goes on from' if self._run.is_restored else 'begins anew: there is not yet'
            self.get_logger().info(f'{goes_on} {settings.restore}')
        self._diagnostics = Diagnostics(self._run.estimator, self._run.inputs)
        self._last_input = None

    def _begin_next(self) -> None:
        """Complete the run and begin another one."""
        ended = self._run
        self._topics.publish(ended.close())
        ended.keep()
        self._begin(ended.next_settings(self._next_output()))
        self._run.follow(ended)

    def _discard(self) -> None:
        self._run.discard()

    def _next_output(self) -> str:
        """Return a folder of its own for the files of a further run."""
        output = self._settings.output
        folders = (f'{output}_{number}' for number in count(2))
        return output and next(folder for folder in folders if not Path(folder).exists())

    def _set_parameters(self, changes: Sequence[RosParameter]) -> SetParametersResult:
        """Let robots come and leave; rclpy refuses all other changes."""
        for change in changes:
            if change.name == 'robots':
                try:
                    self._change_team(change.value)
                except UserError as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _change_team(self, names: Sequence[str]) -> None:
        if not self._has_run:
            raise UsageError('robots come and leave in a run: configure the node first')
        self._run.change_team(names)
        self._match_topics()

    def _tell_team(self) -> None:
        """Let the parameter say which robots are there, after a restored run has told."""
        names = list(self._run.estimator.robots)
        if names != list(self.get_parameter('robots').value):
            self.set_parameters([RosParameter('robots', value=names)])

    def _match_topics(self) -> None:
        """Have the outputs and, if active, the inputs of the robots that are there."""
        self._topics.match_outputs(self._run.outputs.topics, self.is_active)
        self._topics.match_inputs(self._run.inputs.topics if self.is_active else {})

    def _receive(self, topic: str, type_name: str, raw: bytes) -> None:
        self.received += 1
        self._last_input = now = self._now()
        self._run.receive(RawMessage(topic, type_name, now, raw))
        if self._run.is_over():
            self.get_logger().warning('time jumped back: a new run begins')
            self._begin_next()

    def do_steps(self) -> None:
        """Do and publish the steps that are due."""
        begin = perf_counter()
        if self._topics.publish(self._run.take()):
            self._diagnostics.step_times.append(perf_counter() - begin)

    def release_if_idle(self) -> None:
        """Do and publish the last steps where no input has come for a while."""
        now = self._now()
        if now is None or self._last_input is None:
            return
        # A clock that went back has left the input behind, too.
        if not 0 <= now - self._last_input <= self._settings.stale_after * 1e9:
            self._last_input = None
            self._topics.publish(self._run.release())

    def autosave_if_due(self) -> None:
        """Save the run where it has not been saved for a while."""
        period = self._settings.autosave_period
        if period and monotonic() - self._saved_at >= period:
            self._autosave()

    def _autosave(self) -> None:
        self._saved_at = monotonic()
        self._diagnostics.unsaved = ''
        try:
            self._run.save()
        except UserError as error:
            self._diagnostics.unsaved = str(error)
            self.get_logger().error(str(error))

    def _report(self) -> None:
        now = self._now() or 0
        self._note_incompatible_qos()
        self._topics.publish(self._run.outputs.overview(self._topics.is_wanted))
        self._topics.publish([self._diagnostics.report(now, at_rest=self._last_input is None)])

    def _note_incompatible_qos(self) -> None:
        incompatible = self._topics.incompatible()
        for ends in incompatible:
            if ends not in self._diagnostics.incompatible:
                self.get_logger().error(str(ends))
        self._diagnostics.incompatible = incompatible

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._begin_next()
        response.success = True
        response.message = 'forgot everything; step 0 is to come'
        return response

    def _save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = f'saved to {self._run.save()}'
            response.success = True
        except UserError as error:
            response.message = str(error)
        return response

    def _now(self) -> int | None:
        """Return ROS time [ns], or None while simulated time has not begun."""
        return self.get_clock().now().nanoseconds or None


def main(ros_args: Sequence[str]) -> int:
    """Run the node until SIGINT or SIGTERM, or until it is shut down."""
    with ros(ros_args) as stopped:
        node = EstimatorNode()
        executor = RoundExecutor()
        executor.add_node(node)
        try:
            while not (stopped.is_set() or node.is_finalized):
                serve(node, executor)
            serve(node, executor)
            node.close()
        finally:
            node.forget()
            node.destroy_node()
    return 0


def serve(node: EstimatorNode, executor: RoundExecutor) -> None:
    """
    Take in all messages that are there, then do the steps that are due.

    A round takes one message of each topic, so that after a stall the topics are out of step with
    each other and with time; only after a round without messages is it known what has arrived.

    """
    executor.spin_round(SPIN_TIMEOUT)
    for _ in range(MAX_ROUNDS):
        before = node.received
        executor.spin_round(0.0)
        if node.received == before:
            break
    if node.is_active:
        node.do_steps()
        node.release_if_idle()
        node.autosave_if_due()
