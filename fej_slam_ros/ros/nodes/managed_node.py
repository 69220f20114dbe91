# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lifecycle node that reports why a transition fails."""

from collections.abc import Callable
import traceback

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import (
    LifecycleNodeMixin, LifecyclePublisher, LifecycleState, TransitionCallbackReturn)

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.nodes.parameter_node import drop_events, ParameterNode

SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE
TRANSITION_ERROR = TransitionCallbackReturn.ERROR

#: Maximum length of the label of a transition.
MAX_LABEL = 100


class ManagedNode(LifecycleNodeMixin, ParameterNode):
    """
    A lifecycle node that logs or raises the errors of transitions, which rclpy drops.

    After a failed transition the node is unconfigured, or finalized after a failed shutdown.

    Attributes
    ----------
    is_finalized : whether the node was shut down

    """

    def __init__(self, name: str) -> None:
        ParameterNode.__init__(self, name)
        LifecycleNodeMixin.__init__(self)
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._change_state_if_possible
        self.is_finalized = False
        self._is_requested = True
        self._failure: Exception | None = None

    def configure(self) -> None:
        """Prepare the node, from unconfigured to inactive."""
        raise NotImplementedError

    def activate(self) -> None:
        """Start work; the publishers are already active."""
        raise NotImplementedError

    def deactivate(self) -> None:
        """Stop work; the publishers are still active."""
        raise NotImplementedError

    def clean_up(self) -> None:
        """Finish the work and return to unconfigured."""
        raise NotImplementedError

    def finish(self) -> None:
        """Finish the work in any state, for shutdown."""
        raise NotImplementedError

    def dispose(self) -> None:
        """Undo everything that transitions have done, even if they failed halfway."""
        raise NotImplementedError

    def destroy_lifecycle_publisher(self, publisher: LifecyclePublisher) -> bool:
        """Destroy a publisher; its events that wait for the executor are dropped."""
        drop_events(publisher)
        return bool(super().destroy_lifecycle_publisher(publisher))

    def transition(self, trigger: Callable[[], object]) -> None:
        """Make a transition without a service request; its error is raised instead of logged."""
        self._is_requested, self._failure = False, None
        trigger()
        self._is_requested = True
        if self._failure is not None:
            raise self._failure

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle the transition from unconfigured to inactive."""
        return self._run_transition(self.configure, FAILURE)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle the transition from inactive to active."""
        super().on_activate(state)
        return self._run_transition(self.activate, TRANSITION_ERROR)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle the transition from active to inactive."""
        done = self._run_transition(self.deactivate, TRANSITION_ERROR)
        super().on_deactivate(state)
        return done

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle the transition from inactive to unconfigured."""
        return self._run_transition(self.clean_up, TRANSITION_ERROR)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Handle the transition from any state to finalized."""
        self.is_finalized = True
        return self._run_transition(self.finish, FAILURE)

    def _change_state_if_possible(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Refuse transitions that the state does not allow; in rclpy they end the process."""
        response.success = False
        # rcl logs the label of an unknown transition, which may be a million characters.
        if len(request.transition.label) > MAX_LABEL:
            return response
        try:
            return self._change_state(request, response)
        except RuntimeError:
            return response

    def _run_transition(
        self, work: Callable[[], None], on_error: TransitionCallbackReturn
    ) -> TransitionCallbackReturn:
        try:
            work()
        # rclpy drops all exceptions.
        except Exception as error:  # noqa: BLE001
            self.dispose()
            if self._is_requested:
                of_user = isinstance(error, UserError)
                self.get_logger().error(str(error) if of_user else traceback.format_exc())
            else:
                self._failure = error
            return on_error
        return SUCCESS
