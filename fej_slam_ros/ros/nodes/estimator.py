# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator as a node: topics in, fused poses and the map out."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from time import monotonic

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import Trigger

from fej_slam_ros.core.records import NS
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.messages.common import from_time
from fej_slam_ros.ros.nodes.session_node import RunNode, spin
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.outputs import Publication

NODE = 'estimator'


class EstimatorNode(RunNode):
    """A run of the estimator, whose team may change and which may be saved."""

    _run: EstimatorSession

    def __init__(self) -> None:
        super().__init__(NODE)
        node = self._settings.node
        lacks_tf = node.publish_tf and find_spec('tf2_msgs') is None
        if lacks_tf:
            self._settings = self._next_settings = replace(
                self._settings, node=replace(node, publish_tf=False))
        self._saved_at = monotonic()
        self.add_on_set_parameters_callback(self._set_parameters)
        self.start()
        if lacks_tf:
            self.get_logger().info(
                'no transforms on /tf because tf2_msgs is missing: install ros-jazzy-tf2-msgs, or'
                ' set publish_tf to false')

    def new_run(self, settings: RunSettings) -> EstimatorSession:
        """Return a run that begins, or goes on from a checkpoint."""
        folder = Path(settings.node.output) if settings.node.output else None
        run = EstimatorSession(settings, folder, is_wanted=self._topics.is_wanted)
        if settings.node.restore:
            goes_on = 'goes on from' if run.is_restored else 'begins anew: there is not yet'
            self.get_logger().info(f'{goes_on} {settings.node.restore}')
        return run

    def configure(self) -> None:
        """Begin a run and create its outputs."""
        super().configure()
        self._tell_team()
        save = self.create_service(Trigger, '~/save', self._save)
        self._configured.callback(self.destroy_service, save)

    def work(self) -> None:
        """Do the steps that are due, and tell a part of the overview."""
        self._publish(self._run.take())
        self._release_if_idle()
        self._autosave_if_due()
        self.is_behind = self._tell()

    def _is_fixed(self, name: str) -> bool:
        return name != 'robots'

    def _end_run(self) -> None:
        if self._settings.node.autosave_period:
            self._autosave()
        super()._end_run()

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
        self._told = iter(())
        self._match_topics()

    def _tell_team(self) -> None:
        """Let the parameter say which robots are there, after a restored run has told."""
        names = list(self._run.estimator.robots)
        if names != list(self.get_parameter('robots').value):
            self.set_parameters([RosParameter('robots', value=names)])

    def _publish(self, publications: Iterable[Publication]) -> None:
        """Publish, and take note of how old poses have become on their way through here."""
        latencies = self._run.diagnostics.latencies
        for topic, message in publications:
            self._topics.publish([(topic, message)])
            now = self._now()
            if topic.endswith('/pose') and now is not None:
                latencies.append((now - from_time(message.header.stamp)) / NS)

    def _release_if_idle(self) -> None:
        """Do and publish the last steps where no input has come for a while."""
        if self._is_input_at_rest():
            self._last_input = None
            self._publish(self._run.release())

    def _autosave_if_due(self) -> None:
        """Save the run where it has not been saved for a while."""
        period = self._settings.node.autosave_period
        if period and monotonic() - self._saved_at >= period:
            self._autosave()

    def _autosave(self) -> None:
        self._saved_at = monotonic()
        self._run.diagnostics.unsaved = ''
        try:
            self._run.save()
        except UserError as error:
            self._run.diagnostics.unsaved = str(error)
            self.get_logger().error(str(error))

    def _save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = f'saved to {self._run.save()}'
            response.success = True
        except UserError as error:
            response.message = str(error)
        return response


def main(ros_args: Sequence[str]) -> int:
    """Run the node until SIGINT or SIGTERM, or until it is shut down."""
    return spin(ros_args, EstimatorNode)
