"""From the raw topics of a recording to measured steps, by the step functions that the nodes call."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import numpy as np

from fringedic.chain import (
    CouplingResult,
    DicResult,
    DisplacementTracker,
    PhaseResult,
    ShapeTracker,
    phase_step,
    white_texture,
)
from fringedic.errors import FringedicError
from fringedic.results.messages import image_array
from fringedic.results.recorded_parameters import RecordedParameters
from fringedic.results.rows import Row, Settings, displacement_maps
from fringedic.rig import RigModel
from fringedic.sequence import FrameCollector, FrameRecord, PatternKind, Stack, frame_record, stamp_of

_UNPAIRED = 64  # images or exposure records that may wait for each other
_ERROR_STAGE = 4  # of fringedic_msgs/StepStatus


class Chain:
    """The phase, dic and coupling nodes in one, fed with the recorded messages.

    Parameters
    ----------
    overrides
        Parameters that replace the recorded ones.
    experiment
        The experiment whose messages come.
    reference
        A step that is the reference of all others, whatever the recording says; give its messages first.
    calibration
        Of the rig, whatever the recording says.
    """

    def __init__(
        self, overrides: Mapping[str, Any], experiment: str, reference: int | None, calibration: RigModel | None = None
    ) -> None:
        self._reference = reference
        self._parameters = RecordedParameters(overrides)
        self._collector = FrameCollector()
        self._displacement = DisplacementTracker(self._parameters.dic)
        self._shape = ShapeTracker(self._parameters.coupling)
        self._calibration_given = calibration is not None
        self._calibration: RigModel | None = None
        self._images: OrderedDict[int, Any] = OrderedDict()
        self._records: OrderedDict[int, FrameRecord] = OrderedDict()
        self._answered: set[int] = set()
        if reference is not None:
            self._displacement.set_reference(experiment, reference)
            self._shape.set_reference(experiment, reference)
        if calibration is not None:
            self._set_calibration(calibration)

    def settings(self) -> Settings:
        return self._parameters.settings(self._calibration)

    def take(self, topic: str, message: Any, wanted: set[int] | None) -> list[Row]:
        """Take one recorded message and return the steps that it completes."""
        if topic == "node_parameters":
            self._parameters.take(message)
        elif topic == "calibration":
            if not self._calibration_given:
                self._set_calibration(RigModel.from_message(message))
        elif topic == "experiment/reference":
            if self._reference is not None:
                return []
            self._displacement.set_reference(message.experiment, message.step)
            self._shape.set_reference(message.experiment, message.step)
        elif topic == "experiment/step":
            return self._end(message)
        elif topic == "camera/image_raw":
            return self._join(stamp_of(message), image=message, wanted=wanted)
        else:
            return self._join(stamp_of(message), record=frame_record(message), wanted=wanted)
        return []

    def finish(self) -> list[Row]:
        """Return the steps that the recording leaves incomplete."""
        return [self._abandoned(*key) for key in self._collector.open_steps]

    def _set_calibration(self, calibration: RigModel) -> None:
        self._calibration = calibration
        self._shape.set_calibration(calibration)

    def _end(self, message: Any) -> list[Row]:
        key = (message.experiment, message.step)
        if message.stage == _ERROR_STAGE and key in self._collector.open_steps:
            return [self._abandoned(*key)]
        return []

    def _abandoned(self, experiment: str, step: int) -> Row:
        self._answered.add(step)
        return Row(step, error=str(self._collector.abandon(experiment, step)))

    def _join(
        self, stamp: int, *, image: Any = None, record: FrameRecord | None = None, wanted: set[int] | None
    ) -> list[Row]:
        if image is not None:
            self._images[stamp] = image
        if record is not None:
            self._records[stamp] = record
        for waiting in (self._images, self._records):
            while len(waiting) > _UNPAIRED:
                waiting.popitem(last=False)
        if stamp not in self._images or stamp not in self._records:
            return []
        image, record = self._images.pop(stamp), self._records.pop(stamp)
        unwanted = wanted is not None and record.step not in wanted
        if record.projection.kind == PatternKind.OTHER or unwanted or record.step in self._answered:
            return []
        return self._collect(record, image)

    def _collect(self, record: FrameRecord, image: Any) -> list[Row]:
        try:
            stack = self._collector.add(record, image_array(image))
        except FringedicError as error:
            self._collector.abandon(record.experiment, record.step)
            self._answered.add(record.step)
            return [Row(record.step, record.stamp, error=str(error))]
        if stack is None:
            return []
        self._answered.add(record.step)
        return [self._measure(stack)]

    def _measure(self, stack: Stack) -> Row:
        row = Row(stack.step, stack.stamp)
        try:
            if stack.kind == PatternKind.WHITE:
                _add_displacement(row, self._displace(stack, white_texture(stack.frames[-1])))
            else:
                phase = phase_step(stack, self._parameters.phase)
                _add_phase(row, phase)
                displacement = self._displace(stack, phase.texture)
                _add_displacement(row, displacement)
                _add_coupling(row, self._couple(phase, displacement))
        except FringedicError as error:
            row.error = str(error)
        return row

    def _displace(self, stack: Stack, texture: np.ndarray) -> DicResult:
        self._displacement.parameters = self._parameters.dic
        return self._displacement.step(stack.experiment, stack.step, stack.stamp, texture)

    def _couple(self, phase: PhaseResult, displacement: DicResult) -> CouplingResult:
        self._shape.parameters = self._parameters.coupling
        return self._shape.step(
            phase.experiment,
            phase.step,
            phase.stamp,
            phase.phase,
            phase.sigma,
            displacement.displacement,
            displacement.sigma,
            pitch=phase.pitch,
            orientation=phase.orientation,
            relative=phase.relative,
            spacing=displacement.spacing,
            origin=displacement.origin,
            window=self._parameters.dic.window,
            method=self._parameters.dic.method,
        )


def _add_phase(row: Row, result: PhaseResult) -> None:
    row.valid_fraction = result.valid_fraction
    row.maps |= {
        "phase": result.phase,
        "phase_sigma": result.sigma,
        "modulation": result.modulation,
        "texture": result.texture,
    }


def _add_displacement(row: Row, result: DicResult) -> None:
    row.valid_fraction = result.valid_fraction
    row.reference_step = result.reference_step
    row.correlated_step = result.correlated_step
    row.maps |= displacement_maps(result.displacement, result.sigma)


def _add_coupling(row: Row, result: CouplingResult) -> None:
    row.valid_fraction = result.valid_fraction
    row.rms_displacement = result.rms
    row.maps |= {f"shape_{name}": values for name, values in result.shape.items()}
    row.maps |= result.displacement
