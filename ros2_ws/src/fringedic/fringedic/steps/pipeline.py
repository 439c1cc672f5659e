"""The phase, dic and coupling steps in one process: recorded frames to whole step results, without ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fringedic.errors import FringedicError, reason_of
from fringedic.frames.collector import FrameCollector, Stack
from fringedic.frames.records import StepKey
from fringedic.patterns.pattern import PatternKind
from fringedic.recording.frames import RecordedFrame, RecordedMessage
from fringedic.rig.compatibility import RigSetup, check_calibration
from fringedic.rig.model import RigModel
from fringedic.steps.closures import ClosureChecks
from fringedic.steps.displacement_tracker import DisplacementTracker, white_texture
from fringedic.steps.phase import phase_step
from fringedic.steps.recorded_parameters import RecordedParameters, StepSettings
from fringedic.steps.recorded_references import RecordedReferences
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.steps.step_results import CouplingResult, DicResult, PhaseResult

_ERROR_STAGE = 4  # of fringedic_msgs/StepStatus


@dataclass
class MeasuredStep:
    """The results of one recorded step, as far as it could be measured.

    Attributes
    ----------
    step
        Its number.
    stamp
        Its time [ns], see `Stack.time`; None when its last frame is missing.
    error
        Why it could not be measured to the end, without the name of the step; empty when it could.
    phase, displacement, coupling
        The results; None for those that a white step does not have, and after an error.
    closures
        Independent checks, see `ClosureChecks`, by the names of their maps [standard deviations].
    """

    step: int
    stamp: int | None = None
    error: str = ""
    phase: PhaseResult | None = None
    displacement: DicResult | None = None
    coupling: CouplingResult | None = None
    closures: dict[str, np.ndarray] = field(default_factory=dict)


class OfflinePipeline:
    """Measures recorded steps with the functions that the phase, dic and coupling nodes call.

    Parameters
    ----------
    overrides
        Parameters that replace the recorded ones, ``{"dic.window": 24}``.
    experiment
        The experiment whose frames follow.
    references
        Steps that are references, whatever the recording names: the first one of all steps until the next one. The
        frames of the first one come first. Empty: as recorded, see `RecordedReferences`.
    calibration
        Of the rig, instead of the recorded one.

    Raises
    ------
    ConfigurationError
        An override is unknown or not allowed.
    CalibrationError
        The lengths of the calibration contradict each other.
    """

    def __init__(
        self,
        overrides: Mapping[str, Any],
        experiment: str,
        references: Sequence[int] = (),
        calibration: RigModel | None = None,
    ) -> None:
        self._fixed_references = frozenset(references)
        self._fixed_calibration = calibration is not None
        self._calibration: RigModel | None = None
        self._parameters = RecordedParameters(overrides)
        self._references = RecordedReferences()
        self._collector = FrameCollector()
        self._displacement = DisplacementTracker(self._parameters.dic)
        self._shape = ShapeTracker(self._parameters.coupling)
        self._checks = ClosureChecks()
        self._answered: set[int] = set()
        if references:
            self._displacement.set_reference(experiment, references[0])
        if calibration is not None:
            self._set_calibration(calibration)

    @property
    def settings(self) -> StepSettings:
        """Everything that the next step is measured with."""
        return self._parameters.settings(self._calibration)

    def take(
        self, event: RecordedFrame | RecordedMessage, wanted: AbstractSet[int] | None = None
    ) -> list[MeasuredStep]:
        """Take what was recorded next and return the steps that it completes.

        Parameters
        ----------
        event
            From `fringedic.recording.frames.events`.
        wanted
            Numbers of the steps to measure; None for all.
        """
        if isinstance(event, RecordedFrame):
            return self._take_frame(event, wanted)
        message = event.message
        reference = self._references.take(event.topic, message)
        if reference is not None and not self._fixed_references:
            self._displacement.set_reference(message.experiment, reference)
        if event.topic == "node_parameters":
            self._parameters.take(message)
        elif event.topic == "calibration" and not self._fixed_calibration:
            self._set_calibration(RigModel.from_message(message))
        elif event.topic == "experiment/step":
            ended = (message.experiment, message.step)
            if message.stage == _ERROR_STAGE:
                return [self._abandoned(key) for key in self._collector.open_steps if key[:2] == ended]
        return []

    def finish(self) -> list[MeasuredStep]:
        """Return the steps that the recording leaves incomplete."""
        return [self._abandoned(key) for key in self._collector.open_steps]

    def _set_calibration(self, calibration: RigModel) -> None:
        check_calibration(calibration, RigSetup())
        self._calibration = calibration
        self._shape.set_calibration(calibration)

    def _abandoned(self, key: StepKey) -> MeasuredStep:
        self._answered.add(key.step)
        error = self._collector.abandon(key)
        return MeasuredStep(key.step, error=error.reason if error is not None else "")

    def _take_frame(self, frame: RecordedFrame, wanted: AbstractSet[int] | None) -> list[MeasuredStep]:
        record = frame.record
        unwanted = wanted is not None and record.step not in wanted
        if record.pattern.kind == PatternKind.OTHER or unwanted or record.step in self._answered:
            return []
        # steps are exposed one after the other: what is missing of one before is lost
        lost = [self._abandoned(key) for key in self._collector.open_steps if key.step != record.step]
        if record.step in self._fixed_references:
            self._displacement.set_reference(record.experiment, record.step)
        try:
            stack = self._collector.add(record, frame.image)
        except FringedicError as error:
            self._collector.abandon(record.step_key)
            self._answered.add(record.step)
            return [*lost, MeasuredStep(record.step, record.stamp, error=reason_of(error))]
        if stack is None:
            return lost
        self._answered.add(record.step)
        return [*lost, self._measure(stack)]

    def _measure(self, stack: Stack) -> MeasuredStep:
        measured = MeasuredStep(stack.step, stack.time)
        try:
            if stack.kind == PatternKind.WHITE:
                self._displace(stack, white_texture(stack.frames[-1]), measured)
                return measured
            measured.phase = phase_step(stack, self._parameters.phase)
            measured.closures |= self._checks.phase(stack, measured.phase)
            self._displace(stack, measured.phase.texture, measured)
            self._shape.parameters = self._parameters.coupling
            assert measured.displacement is not None
            measured.coupling = self._shape.step(measured.phase, measured.displacement)
        except FringedicError as error:
            measured.error = reason_of(error)
        return measured

    def _displace(self, stack: Stack, texture: np.ndarray, measured: MeasuredStep) -> None:
        self._displacement.parameters = self._parameters.dic
        result = self._displacement.step(stack.experiment, stack.step, stack.stamp, texture)
        measured.displacement = result
        measured.closures |= self._checks.displacement(result, texture, self._parameters.dic.kept_steps)
