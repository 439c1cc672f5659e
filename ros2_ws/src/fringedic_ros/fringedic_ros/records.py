"""Messages of exposures, clocks and calibrations from records of the library."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fringedic.frames.clocks import ClockEstimate
from fringedic.frames.records import FrameRecord
from fringedic_msgs.msg import ClockDrift, Exposure, RigCalibration
from fringedic_ros.stamps import to_msg

if TYPE_CHECKING:
    from fringedic.rig.model import RigModel


def exposure_message(record: FrameRecord, *, frame_id: str) -> Exposure:
    """Return the message of the record of one frame."""
    message = Exposure(
        sensor=record.sensor,
        experiment=record.experiment,
        step=record.step,
        index=record.index,
        count=record.count,
        kind=int(record.pattern.kind),
        orientation=int(record.pattern.orientation),
        pitch=float(record.pattern.pitch),
        shift=record.pattern.shift,
        shifts=record.pattern.shifts,
        exposure_time=float(record.exposure_time),
        dropped=record.dropped,
        image_crc=record.image_crc,
    )
    message.header.stamp = to_msg(record.stamp)
    message.header.frame_id = frame_id
    return message


def clock_message(clock: str, estimate: ClockEstimate) -> ClockDrift:
    """Return the message of the clock of a device relative to this computer."""
    message = ClockDrift(
        clock=clock,
        offset=estimate.offset,
        drift=estimate.drift,
        drift_sigma=estimate.drift_sigma,
        samples=estimate.samples,
    )
    message.header.stamp = to_msg(estimate.stamp_ns)
    return message


def calibration_message(rig: RigModel, *, stamp_ns: int, frame_id: str) -> RigCalibration:
    """Return the message of a rig model; the fields have the same names and units."""
    message = RigCalibration()
    for name, value in rig.message_fields().items():
        setattr(message, name, value)
    message.header.stamp = to_msg(stamp_ns)
    message.header.frame_id = frame_id
    return message
