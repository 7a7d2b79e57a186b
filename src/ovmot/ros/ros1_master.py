"""Watches the ROS master: without one, connected nodes go on, but new ones cannot be found."""

from typing import Any

from ovmot.ros.watch import Line


class MasterWatch:
    """Reports once that the master is gone; registers this node again when there is a new one."""

    def __init__(self, rospy: Any) -> None:
        import rosgraph

        self._rospy = rospy
        self._master = rosgraph.Master(rospy.get_name())
        self._pid: int | None = self._ask()

    def look(self) -> list[Line]:
        """Lines for the user."""
        before, self._pid = self._pid, self._ask()
        if self._pid == before:
            return []
        if self._pid is None:
            gone = "the ROS master is gone: connections stay, new ones cannot be made; going on"
            return [Line(gone)]
        self._register_again()
        return [Line("there is a ROS master again: registered with it", "info")]

    def published(self) -> dict[str, str] | None:
        """The types of all topics that anybody publishes, None where the master is gone."""
        try:
            return {str(topic): str(kind) for topic, kind in self._master.getPublishedTopics("")}
        except Exception:  # as below
            return None

    def _ask(self) -> int | None:
        try:
            return int(self._master.getPid())
        except Exception:  # whatever socket and XML-RPC make of a master that is not there
            return None

    def _register_again(self) -> None:
        """A new master knows nobody. It hands our topics on to nodes that come after us, and rospy
        connects to those that it knew before us."""
        from rospy.impl import registration

        listeners = registration.get_registration_listeners()
        topics = registration.get_topic_manager()
        services = registration.get_service_manager()
        for topic, kind in topics.get_publications():
            listeners.notify_added(topic, kind, registration.Registration.PUB)
        for topic, kind in topics.get_subscriptions():
            listeners.notify_added(topic, kind, registration.Registration.SUB)
        for name, uri in services.get_services():
            listeners.notify_added(name, uri, registration.Registration.SRV)
