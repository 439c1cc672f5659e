"""Messages of exposures, clocks and calibrations from the library's records."""

from __future__ import annotations

from fringedic.clocks import ClockEstimate
from fringedic.rig import RigModel
from fringedic.sequence import FrameRecord
from fringedic_msgs.msg import ClockDrift, Exposure, RigCalibration
from fringedic_ros.stamps import to_msg


def exposure_message(record: FrameRecord, *, frame_id: str) -> Exposure:
    """Message of one frame's record."""
    message = Exposure(
        experiment=record.experiment,
        step=record.step,
        index=record.index,
        count=record.count,
        kind=int(record.projection.kind),
        orientation=int(record.projection.orientation),
        pitch=float(record.projection.pitch),
        shift=record.projection.shift,
        shifts=record.projection.shifts,
        exposure_time=float(record.exposure_time),
        dropped=record.dropped,
    )
    message.header.stamp = to_msg(record.stamp)
    message.header.frame_id = frame_id
    return message


def clock_message(clock: str, known: ClockEstimate) -> ClockDrift:
    """Message of how a device's clock runs against this computer's."""
    message = ClockDrift(
        clock=clock, offset=known.offset, drift=known.drift, drift_sigma=known.drift_sigma, samples=known.samples
    )
    message.header.stamp = to_msg(known.stamp_ns)
    return message


def calibration_message(rig: RigModel, *, stamp_ns: int, frame_id: str = "reference_plane") -> RigCalibration:
    """Message of a rig model; the fields have the same names and units."""
    message = RigCalibration()
    for name, value in rig.message_fields().items():
        setattr(message, name, value)
    message.header.stamp = to_msg(stamp_ns)
    message.header.frame_id = frame_id
    return message
