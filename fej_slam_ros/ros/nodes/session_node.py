# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the estimator and the smoother have in common as nodes: topics in, a run, topics out."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, ExitStack
import gc
from itertools import count, islice
from pathlib import Path
from time import perf_counter

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor
from std_srvs.srv import Trigger

from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.nodes.lifecycle_node import ManagedNode
from fej_slam_ros.ros.nodes.ros_process import descriptor, ros
from fej_slam_ros.ros.nodes.topics import Topics
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.estimator_session import Session
from fej_slam_ros.ros.session.outputs import Publication

REPORT_PERIOD = 1.0
SPIN_TIMEOUT = 0.1
#: So many times all messages of a topic are taken in between steps at most.
MAX_ROUNDS = 1000
#: A round without messages may be of a topic whose messages came with those of another round.
EMPTY_ROUNDS = 3


class RunNode(ManagedNode):
    """
    Declares, converts, calls, converts, publishes.

    Attributes
    ----------
    received : how many messages have come
    holds : how often it did something that nothing else could interrupt
    is_active : whether it listens to its inputs
    is_behind : whether there is more to do at once, even if no message comes

    """

    _run: Session

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.received = self.holds = 0
        self.is_active = self.is_behind = False
        self._settings = self._next_settings = self._read_settings()
        self._last_input: int | None = None
        self._topics = Topics(self, self._receive)
        self._has_run = False
        # What is left of the overview: it is told piece by piece, so that steps need not wait.
        self._told: Iterator[Publication] = iter(())
        # What undoes `configure` and what undoes `activate`.
        self._configured, self._activated = ExitStack(), ExitStack()

    def new_run(self, settings: RunSettings) -> Session:
        """Return a run that begins."""
        raise NotImplementedError

    def work(self) -> None:
        """Do what is to be done when all messages that have come are taken in."""
        raise NotImplementedError

    def start(self) -> None:
        """Get to work, unless that is for others to say."""
        if self._settings.node.autostart:
            self.make(self.trigger_configure)
            self.make(self.trigger_activate)

    def configure(self) -> None:
        """Begin a run and create its outputs."""
        self._begin(self._next_settings)
        self._has_run = True
        self._configured.callback(self._discard)
        self._configured.callback(self._topics.match_outputs, {}, active=False)
        self._match_topics()
        reset = self.create_service(Trigger, '~/reset', self._reset)
        self._configured.callback(self.destroy_service, reset)

    def activate(self) -> None:
        """Listen, and report."""
        self.is_active = True
        self._activated.callback(self._topics.match_inputs, {})
        self._match_topics()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        for period, act in (
            (REPORT_PERIOD, self._report_diagnostics),
            (self._settings.node.map_period, self._begin_overview),
        ):
            timer = self.create_timer(period, act, clock=steady)
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

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Take note of how long nothing else can be done."""
        begin = perf_counter()
        yield
        self.holds += 1
        if self._has_run:
            self._run.diagnostics.hold_times.append(perf_counter() - begin)

    def _read_settings(self) -> RunSettings:
        settings = parameters.parse(self.given, self.get_logger().warning)
        known = parameters.known_parameters([robot.name for robot in settings.estimation.robots])
        accepted = known.keys() | parameters.RENAMED_PARAMETERS.keys()
        for name in self.given:
            if name in accepted or name.startswith(parameters.QOS_OVERRIDES):
                self.undeclare_parameter(name)
        # What was given is declared anew, as checked: an integer has become a float. Overrides of
        # the quality of service are declared with their topics.
        for name, value in parameters.as_parameters(settings).items():
            described = descriptor(known[name], read_only=self._is_fixed(name))
            self.declare_parameter(name, value, described, ignore_override=True)
        return settings

    def _is_fixed(self, name: str) -> bool:
        """Return whether a parameter cannot be changed in mid-run."""
        return True

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
        self._topics.publish(self._run.close())
        self._report()
        told = self._run.keep()
        self.get_logger().info(f'state hash {told["state_hash"]}')
        output = self._run.settings.node.output
        if output:
            self.get_logger().info(f'files are in {output}')
        self._next_settings = self._run.next_settings(self._next_output())

    def _begin(self, settings: RunSettings) -> None:
        self._run = self.new_run(settings)
        self._told = iter(())
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
        output = self._settings.node.output
        folders = (f'{output}_{number}' for number in count(2))
        return output and next(folder for folder in folders if not Path(folder).exists())

    def _match_topics(self) -> None:
        """Have the outputs and, if active, the inputs of the robots that are there."""
        self._topics.match_outputs(self._run.outputs.topics, self.is_active)
        self._topics.match_inputs(self._run.inputs.topics if self.is_active else {})

    def _receive(self, topic: str, type_name: str, raw: bytes) -> None:
        with self.hold():
            self.received += 1
            self._last_input = now = self._now()
            self._run.receive(RawMessage(topic, type_name, now, raw))
            if self._run.is_over():
                self.get_logger().warning('time jumped back: a new run begins')
                self._begin_next()

    def _is_input_at_rest(self) -> bool:
        """Return whether no input has come for a while, since some did."""
        now = self._now()
        if now is None or self._last_input is None:
            return False
        # A clock that went back has left the input behind, too.
        return not 0 <= now - self._last_input <= self._settings.estimation.stale_after * 1e9

    def _begin_overview(self) -> None:
        with self.hold():
            # What takes longer than the period is told to its end.
            if not self._tell():
                self._told = self._run.outputs.overview(self._topics.is_wanted)

    def _tell(self) -> bool:
        """Publish one path or map of the overview; return whether there was any."""
        return self._topics.publish(islice(self._told, 1)) > 0

    def _report(self) -> None:
        self._topics.publish(self._run.outputs.overview(self._topics.is_wanted))
        self._report_diagnostics()

    def _report_diagnostics(self) -> None:
        with self.hold():
            self._publish_diagnostics()

    def _publish_diagnostics(self) -> None:
        diagnostics, incompatible = self._run.diagnostics, self._topics.incompatible()
        for ends in incompatible:
            if ends not in diagnostics.incompatible:
                self.get_logger().error(str(ends))
        diagnostics.incompatible = incompatible
        at_rest = self._last_input is None
        self._topics.publish([diagnostics.report(self._now() or 0, at_rest)])

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self.hold():
            self._begin_next()
        response.success = True
        response.message = 'forgot everything; step 0 is to come'
        return response

    def _now(self) -> int | None:
        """Return ROS time [ns], or None while simulated time has not begun."""
        return self.get_clock().now().nanoseconds or None


def spin(ros_args: Sequence[str], make: Callable[[], RunNode]) -> int:
    """Run a node until SIGINT or SIGTERM, or until it is shut down."""
    with ros(ros_args) as stopped:
        node = make()
        # Nothing of what there is now will be garbage soon: the collector need not look there.
        gc.collect()
        gc.freeze()
        # Unlike the others it does not look at every topic to find the one that has a message.
        executor = EventsExecutor()
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


def serve(node: RunNode, executor: Executor) -> None:
    """
    Take in all messages that are there, then do the steps that are due.

    A round takes all messages of one topic, so that after a stall the topics are out of step with
    each other and with time; only when nothing is left is it known what has arrived.

    """
    executor.spin_once(0.0 if node.is_behind else SPIN_TIMEOUT)
    empty = 0
    for _ in range(MAX_ROUNDS):
        before = node.holds
        executor.spin_once(0.0)
        empty = empty + 1 if node.holds == before else 0
        if empty == EMPTY_ROUNDS:
            break
    if node.is_active:
        with node.hold():
            node.work()
