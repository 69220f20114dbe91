# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator as a node: topics in, fused poses and the map out."""

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from time import monotonic, perf_counter

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import Trigger

from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.nodes.run_node import RunNode, spin
from fej_slam_ros.ros.run import Run

NODE = 'estimator'


class EstimatorNode(RunNode):
    """A run of the estimator, whose team may change and which may be saved."""

    _run: Run

    def __init__(self) -> None:
        super().__init__(NODE)
        lacks_tf = self._settings.publish_tf and find_spec('tf2_msgs') is None
        if lacks_tf:
            self._settings = self._next_settings = replace(self._settings, publish_tf=False)
        self._saved_at = monotonic()
        self.add_on_set_parameters_callback(self._set_parameters)
        self.start()
        if lacks_tf:
            self.get_logger().info(
                'no transforms on /tf because tf2_msgs is missing: install ros-jazzy-tf2-msgs, or'
                ' set publish_tf to false')

    def new_run(self, settings: Settings) -> Run:
        """Return a run that begins, or goes on from a checkpoint."""
        run = Run(settings, Path(settings.output) if settings.output else None)
        if settings.restore:
            goes_on = 'goes on from' if run.is_restored else 'begins anew: there is not yet'
            self.get_logger().info(f'{goes_on} {settings.restore}')
        return run

    def configure(self) -> None:
        """Begin a run and create its outputs."""
        super().configure()
        self._tell_team()
        save = self.create_service(Trigger, '~/save', self._save)
        self._configured.callback(self.destroy_service, save)

    def work(self) -> None:
        """Do the steps that are due."""
        self._do_steps()
        self._release_if_idle()
        self._autosave_if_due()

    def _is_fixed(self, name: str) -> bool:
        return name != 'robots'

    def _end_run(self) -> None:
        if self._settings.autosave_period:
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
        self._match_topics()

    def _tell_team(self) -> None:
        """Let the parameter say which robots are there, after a restored run has told."""
        names = list(self._run.estimator.robots)
        if names != list(self.get_parameter('robots').value):
            self.set_parameters([RosParameter('robots', value=names)])

    def _do_steps(self) -> None:
        """Do and publish the steps that are due."""
        begin = perf_counter()
        if self._topics.publish(self._run.take()):
            self._run.diagnostics.step_times.append(perf_counter() - begin)

    def _release_if_idle(self) -> None:
        """Do and publish the last steps where no input has come for a while."""
        if self._is_input_at_rest():
            self._last_input = None
            self._topics.publish(self._run.release())

    def _autosave_if_due(self) -> None:
        """Save the run where it has not been saved for a while."""
        period = self._settings.autosave_period
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
