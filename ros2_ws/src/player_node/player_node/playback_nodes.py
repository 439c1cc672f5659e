"""The nodes that a recording is played to: their subscriptions, their parameters and their answers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future

from fringedic.errors import WaitTimeoutError
from fringedic.steps.recorded_parameters import present_name
from fringedic_msgs.msg import NodeParameters, NodeStatus, StepStatus
from fringedic_ros.matching import Matching, shares_process
from fringedic_ros.qos import EVENTS
from fringedic_ros.topics import DERIVED_TOPICS, PROCESSING_INPUTS, PUBLISHED, READERS
from fringedic_ros.waiting import Patience


class PlaybackNodes:
    """Processing nodes, and optionally a recorder, that receive what a player publishes.

    Parameters
    ----------
    node
        The player; its callbacks are served while this object waits.
    recorder
        Whether a recorder receives all topics as well.
    timeout_s
        Longest wait [s]; it only ends a replay that would never end.
    """

    def __init__(self, node: Node, *, recorder: bool, timeout_s: float) -> None:
        self._node = node
        self._recorder = recorder
        self._timeout_s = timeout_s
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._statuses: dict[str, NodeStatus] = {}
        for name in PROCESSING_INPUTS:
            node.create_subscription(NodeStatus, f"{name}/status", self._take_status, EVENTS)
        names = [*PROCESSING_INPUTS, *(["recorder"] if recorder else [])]
        self._get = {name: node.create_client(GetParameters, f"{name}/get_parameters") for name in names}
        self._set = {
            name: node.create_client(SetParametersAtomically, f"{name}/set_parameters_atomically")
            for name in PROCESSING_INPUTS
        }
        self._matching = Matching(node, PUBLISHED, READERS)

    def await_subscriptions(self, publishers: Collection[Publisher], names: Iterable[str]) -> None:
        """Wait until every node is subscribed to all of its topics, and every publisher is connected to its readers.

        Parameters
        ----------
        publishers
            Publishers of the player, in the order of their names.
        names
            Relative names of what the player publishes.

        Raises
        ------
        WaitTimeoutError
            The message names the nodes or topics.
        """
        played = list(names)
        inputs = self._inputs(played)
        self._wait(
            lambda: not self._unready(inputs),
            lambda: f"these nodes are not subscribed: {'; '.join(self._unready(inputs))}",
        )
        for name, publisher in zip(played, publishers, strict=True):
            readers = sum(name in topics for topics in inputs.values())
            self._await_readers(name, publisher, readers)
        unmatched = self._matching.unmatched
        self._wait(
            lambda: not unmatched(PUBLISHED), lambda: f"{', '.join(unmatched(PUBLISHED))}: not all readers connected"
        )

    def _await_readers(self, name: str, publisher: Publisher, readers: int) -> None:
        self._wait(
            lambda: publisher.get_subscription_count() >= readers, lambda: f"{name}: not all readers are connected"
        )

    def await_handled(self, publishers: Iterable[Publisher]) -> None:
        """Wait until every node has handled what these publishers have sent.

        The acknowledgements confirm the receipt. The executor of a node takes messages before service requests, so that
        its response to a request confirms that the messages are handled.

        Raises
        ------
        WaitTimeoutError
            A node does not answer.
        """
        for publisher in publishers:
            publisher.wait_for_all_acked()
        self._await_responses({name: client.call_async(GetParameters.Request()) for name, client in self._get.items()})

    def set_parameters(self, recorded: NodeParameters, kept: Collection[str]) -> str:
        """Set the recorded parameters of a processing node, and return why it refused them; empty when it did not.

        Parameters that this version does not have are left out.

        Parameters
        ----------
        recorded
            Parameters of one of the processing nodes.
        kept
            Parameters that keep the value of the node, such as ``dic.window``.
        """
        values = {present_name(recorded.node, each.name): each.value for each in recorded.parameters}
        chosen = [
            Parameter(name=name, value=value)
            for name, value in values.items()
            if name is not None and f"{recorded.node}.{name}" not in kept
        ]
        if not chosen:
            return ""
        call = self._set[recorded.node].call_async(SetParametersAtomically.Request(parameters=chosen))
        self._await_responses({recorded.node: call})
        result = call.result().result
        return "" if result.successful else f"{recorded.node} refuses its recorded parameters: {result.reason}"

    def begin_step(self) -> None:
        """Forget the answers to earlier steps."""
        self._statuses.clear()

    def await_statuses(self, step: StepStatus) -> dict[str, NodeStatus]:
        """Wait until every processing node has answered a step, and return their statuses.

        Raises
        ------
        WaitTimeoutError
            The message names the nodes that did not answer.
        """

        def silent() -> list[str]:
            key = (step.experiment, step.step)
            answered = {name for name, each in self._statuses.items() if (each.experiment, each.step) == key}
            return [name for name in PROCESSING_INPUTS if name not in answered]

        def message() -> str:
            others = ", ".join(f"{name}: {each.error_message or 'done'}" for name, each in self._statuses.items())
            return f"{step_name(step)}: no status from {', '.join(silent())} (status of the others: {others or 'none'})"

        self._wait(lambda: not silent(), message)
        return dict(self._statuses)

    def _take_status(self, status: NodeStatus) -> None:
        self._statuses[status.node] = status

    def _inputs(self, played: Collection[str]) -> dict[str, list[str]]:
        """Return the topics that each node has to be subscribed to."""
        inputs = {
            node: [name for name in names if name in played or name in DERIVED_TOPICS]
            for node, names in PROCESSING_INPUTS.items()
        }
        if self._recorder:
            inputs["recorder"] = [*played, *DERIVED_TOPICS]
        return inputs

    def _unready(self, inputs: dict[str, list[str]]) -> list[str]:
        """Return the nodes without parameter service or without a subscription that they need."""
        missing = []
        for node, names in inputs.items():
            topics = [name for name in names if node not in self._subscribers(name) and not self._passed_on(name, node)]
            if topics:
                missing.append(f"{node} (to {', '.join(topics)})")
        return missing + [
            f"{node} (no parameter service)" for node, client in self._get.items() if not client.service_is_ready()
        ]

    def _passed_on(self, name: str, node: str) -> bool:
        """Return whether a processing node receives a result from another node of its process, without the topic."""
        topics = map(self._node.resolve_topic_name, (name, f"{node}/status"))
        return node in PUBLISHED and name in DERIVED_TOPICS and shares_process(self._node, *topics)

    def _subscribers(self, name: str) -> set[str]:
        topic = self._node.resolve_topic_name(name)
        return {each.node_name for each in self._node.get_subscriptions_info_by_topic(topic)}

    def _await_responses(self, calls: dict[str, Future]) -> None:
        def silent() -> str:
            return ", ".join(node for node, call in calls.items() if not call.done())

        self._wait(lambda: not silent(), lambda: f"no answer from {silent()}")

    def _wait(self, done: Callable[[], bool], message: Callable[[], str]) -> None:
        patience = Patience(self._timeout_s)
        while not done():
            if patience.is_over():
                raise WaitTimeoutError(f"{message()} after {self._timeout_s:g} s")
            self._executor.spin_once(timeout_sec=0.05)


def step_name(step: StepStatus) -> str:
    """Return the name of a step for messages."""
    return f"experiment '{step.experiment}', step {step.step}"
