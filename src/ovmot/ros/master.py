"""A look at the ROS master now and then: nodes live on without it, but cannot find each other."""

from typing import Any


class MasterWatch:
    """Says once that the master is gone; when there is one again, makes this node known to it."""

    def __init__(self, rospy: Any) -> None:
        import rosgraph

        self._rospy = rospy
        self._master = rosgraph.Master(rospy.get_name())
        self._pid: int | None = self._ask()

    def look(self) -> list[str]:
        """Lines for the user."""
        before, self._pid = self._pid, self._ask()
        if self._pid == before:
            return []
        if self._pid is None:
            return ["the ROS master is gone: connections stay, new ones cannot be made; going on"]
        try:
            self._register_again()
        except OSError as error:  # it has gone again
            self._pid = None
            return [f"the new ROS master does not answer ({error}); going on"]
        return ["there is a ROS master again: registered with it"]

    def _ask(self) -> int | None:
        try:
            return int(self._master.getPid())
        except Exception:  # whatever socket and XML-RPC make of a master that is not there
            return None

    def _register_again(self) -> None:
        """A new master knows nobody; it hands our topics on to nodes that come after us."""
        from rospy.impl.registration import get_service_manager

        uri = self._rospy.core.get_node_uri()
        topics = self._rospy.topics.get_topic_manager()
        for topic, kind in topics.get_publications():
            self._master.registerPublisher(topic, kind, uri)
        for topic, kind in topics.get_subscriptions():
            self._master.registerSubscriber(topic, kind, uri)
        services = get_service_manager()
        for name, service_uri in services.get_services():
            self._master.registerService(name, service_uri, uri)
