# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node ``adapter``: poses of tags and other objects in, landmarks and robots out."""

from collections.abc import Mapping
from functools import partial

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files.ids_file import IdsFile
from fej_slam_ros.ros.nodes.endpoints import check_installed
from fej_slam_ros.ros.nodes.front_end import FrontEndNode, spin
from fej_slam_ros.ros.parameters.adapter_settings import known_parameters, parse_adapter
from fej_slam_ros.ros.session.adapter_session import AdapterSession


class AdapterNode(FrontEndNode):
    """A node that publishes the objects in the messages of other packages."""

    def __init__(self) -> None:
        super().__init__('adapter')
        settings = parse_adapter(self.given, self.get_logger().warning)
        check_installed(used.type_name for used in settings.object_formats())
        self._ids = IdsFile(settings.ids_file)
        # IDs that could not be saved, and why.
        self._unsaved: Mapping[str, int] = {}
        self._error = ''
        self.start(
            AdapterSession(settings, self._ids.ids, self._save), settings,
            known_parameters(settings.robots))

    def close(self) -> None:
        """Publish and save what is left, and wait until it has arrived."""
        super().close()
        self._retry()
        self._ids.close()

    def _report(self) -> None:
        super()._report()
        self._retry()

    def _retry(self) -> None:
        if self._unsaved:
            self._save(self._unsaved)

    def _save(self, ids: Mapping[str, int]) -> None:
        error, self._unsaved = self._error, {}
        try:
            self._ids.save(ids)
            self._error = ''
        except UserError as raised:
            # The IDs are the same without the file, which is completed later.
            self._unsaved, self._error = dict(ids), str(raised)
        if self._error not in {'', error}:
            self.get_logger().warning(f'ids_file: {self._error}')


#: Runs the node until a signal arrives; returns 0.
main = partial(spin, make_node=AdapterNode)
