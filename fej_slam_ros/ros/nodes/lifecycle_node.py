# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The life cycle of a managed node, with the reason where a transition fails."""

from collections.abc import Callable
import traceback

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.nodes.ros_process import ParameterNode

SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE
ERROR = TransitionCallbackReturn.ERROR


class ManagedNode(LifecycleNodeMixin, ParameterNode):
    """
    A lifecycle node that tells why a transition fails; rclpy keeps that to itself.

    A transition that fails leaves the node unconfigured, or finalized where it was to shut down.

    Attributes
    ----------
    is_finalized : whether it was shut down

    """

    def __init__(self, name: str) -> None:
        ParameterNode.__init__(self, name)
        LifecycleNodeMixin.__init__(self)
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._change_state_if_possible
        self.is_finalized = False
        self._is_asked = True
        self._failure: Exception | None = None

    def configure(self) -> None:
        """Get ready, from nothing."""
        raise NotImplementedError

    def activate(self) -> None:
        """Begin to work; publishers are active already."""
        raise NotImplementedError

    def deactivate(self) -> None:
        """Stop working; publishers are active still."""
        raise NotImplementedError

    def clean_up(self) -> None:
        """Finish and go back to nothing."""
        raise NotImplementedError

    def finish(self) -> None:
        """Finish, in whatever state."""
        raise NotImplementedError

    def forget(self) -> None:
        """Go back to nothing, however far a transition has come."""
        raise NotImplementedError

    def make(self, trigger: Callable[[], object]) -> None:
        """Make a transition unasked; what goes wrong is raised instead of logged."""
        self._is_asked, self._failure = False, None
        trigger()
        self._is_asked = True
        if self._failure is not None:
            raise self._failure

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the transition from unconfigured to inactive."""
        return self._attempt(self.configure, FAILURE)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the transition from inactive to active."""
        super().on_activate(state)
        return self._attempt(self.activate, ERROR)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the transition from active to inactive."""
        done = self._attempt(self.deactivate, ERROR)
        super().on_deactivate(state)
        return done

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the transition from inactive to unconfigured."""
        return self._attempt(self.clean_up, ERROR)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the transition from any state to finalized."""
        self.is_finalized = True
        return self._attempt(self.finish, FAILURE)

    def _change_state_if_possible(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Refuse what is no transition from here; in rclpy that would end the process."""
        try:
            return self._change_state(request, response)
        except RuntimeError:
            response.success = False
            return response

    def _attempt(
        self, transition: Callable[[], None], otherwise: TransitionCallbackReturn
    ) -> TransitionCallbackReturn:
        try:
            transition()
        # rclpy drops whatever is raised.
        except Exception as error:  # noqa: BLE001
            self._failure = error
            self.forget()
            if self._is_asked:
                of_user = isinstance(error, UserError)
                self.get_logger().error(str(error) if of_user else traceback.format_exc())
            return otherwise
        return SUCCESS
