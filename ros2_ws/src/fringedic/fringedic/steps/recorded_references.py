"""The reference of each step of a recording: one decision for everything that is computed from recorded frames."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

from fringedic.frames.records import stamp_of
from fringedic.recording.reader import BagReader
from fringedic.steps.recorded_parameters import parameter_values
from fringedic.steps.references import StepKey

REFERENCE, STEP, NODE_PARAMETERS = "experiment/reference", "experiment/step", "node_parameters"
REFERENCE_TOPICS = (REFERENCE, STEP, NODE_PARAMETERS)
"""Topics that the decision needs; a recording needs the first one."""
_END = 3  # stage of fringedic_msgs/StepStatus
_KEEPERS = ("dic", "coupling")  # nodes that keep the reference step in memory


class RecordedReferences:
    """Decides which step the following ones are measured against, from the messages of a recording.

    A reference is the step that was announced, if it is the first one or a person, a programme or a controller asked
    for it. Nodes that were started again have lost the reference, and so have those of ``fringedic run --continue``:
    the next step then takes its place, at whatever load it is, and the results of the nodes count from there. The
    frames of the reference before it are recorded: everything computed from them goes on to count from that one, if it
    was measured.

    Attributes
    ----------
    replaced
        (experiment, step) -> reference that it took the place of, for steps that nodes measured against and that are no
        reference here.
    unreplaced
        (experiment, step) of references that took the place of one which the recording does not contain.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> recorded = RecordedReferences()
    >>> recorded.take("experiment/reference", Message(experiment="e", step=0, previous_lost=False))
    0
    >>> recorded.take("experiment/step", Message(experiment="e", step=0, stage=3))
    >>> recorded.take("experiment/reference", Message(experiment="e", step=4, previous_lost=True))
    0
    >>> recorded.of("e"), recorded.replaced
    ({0}, {('e', 4): 0})
    """

    def __init__(self) -> None:
        self.replaced: dict[StepKey, int] = {}
        self.unreplaced: set[StepKey] = set()
        self._announced: defaultdict[str, list[int]] = defaultdict(list)
        self._measured: set[StepKey] = set()
        self._starts = _Starts()

    def take(self, topic: str, message: Any) -> int | None:
        """Take the next message in the order of publishing.

        Parameters
        ----------
        topic
            Relative name; messages of other topics than `REFERENCE_TOPICS` are ignored.
        message
            Decoded.

        Returns
        -------
        int or None
            The reference of the following steps of the experiment of a message on ``experiment/reference``; None for
            any other message.
        """
        if topic == NODE_PARAMETERS:
            self._starts.take(message)
        elif topic == STEP and message.stage == _END:
            self._measured.add((message.experiment, message.step))
        elif topic == REFERENCE:
            return self._decided(message.experiment, message.step, message.previous_lost)
        return None

    def of(self, experiment: str) -> set[int]:
        """Return the references of an experiment so far."""
        return set(self._announced[experiment])

    def _decided(self, experiment: str, step: int, previous_lost: bool | None) -> int:
        announced = self._announced[experiment]
        if previous_lost is None:
            previous_lost = step not in announced and self._starts.lost
        if previous_lost:
            for earlier in reversed(announced):
                if (experiment, earlier) in self._measured:
                    self.replaced[experiment, step] = earlier
                    return earlier
            if not announced:
                self.unreplaced.add((experiment, step))
        self._starts.lost = False
        announced.append(step)
        return step


def recorded_steps_and_references(bag: BagReader) -> tuple[set[int], set[int]]:
    """Return the numbers of all steps of a recording, and of its references.

    Parameters
    ----------
    bag
        The recording.

    Raises
    ------
    RecordingError
        It is damaged.
    """
    relative = {full: name for name, full in bag.find_optional(*REFERENCE_TOPICS).items()}
    recorded, steps, experiments = RecordedReferences(), set[int](), set[str]()
    for raw in bag.published(relative):
        topic, message = relative[raw.topic], bag.decode(raw.topic, raw.data)
        recorded.take(topic, message)
        if topic == STEP:
            steps.add(message.step)
            experiments.add(message.experiment)
    return steps, set[int]().union(*map(recorded.of, experiments))


def is_reference_known(bag: BagReader, experiment: str | None = None) -> bool:
    """Return whether the reference of the first frames of a recording is known.

    Its announcement was published before the first frame was; a recorder may receive it later than that. The recording
    is read as far as the first of each.

    Parameters
    ----------
    bag
        The recording.
    experiment
        Name; None for any. Frames without an experiment, of a free run, have no reference.

    Raises
    ------
    RecordingError
        It is damaged.
    """

    def published(topic: str) -> int | None:
        for raw in bag.raw(bag.find_optional(topic).values()):
            found = bag.decode(raw.topic, raw.data).experiment
            if found == experiment or (experiment is None and found):
                return raw.publish_time
        return None

    announced = published(REFERENCE)
    if announced is None:
        return False
    exposed = published("camera/exposure")
    return exposed is None or announced <= exposed


class _Starts:
    """Starts of nodes in recordings of earlier versions, whose references do not contain `previous_lost`.

    Attributes
    ----------
    lost
        Nodes have lost the reference since the latest one was announced: a node that keeps it was started again, or an
        experiment is continued without it. A node publishes its parameters at its start and after a change; at a start
        they are those of an earlier time.
    """

    def __init__(self) -> None:
        self.lost = False
        self._published: defaultdict[str, dict[int, dict[str, Any]]] = defaultdict(dict)  # by node, then by stamp

    def take(self, message: Any) -> None:
        """Take the published parameters of a node."""
        published, stamp, values = self._published[message.node], stamp_of(message), parameter_values(message)
        if stamp in published:
            return  # latched, for a recorder that was started again
        if message.node in _KEEPERS:
            self.lost = self.lost or values in published.values()
        elif message.node == "experiment":
            self.lost = self.lost or (values.get("first_step", 0) > 0 and values.get("reference_step", -1) < 0)
        published[stamp] = values
