"""Sentences about recordings: their content, their verification, the clocks of their devices."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from fringedic.frames.clocks import ClockEstimate
from fringedic.recording.bag_files import METADATA
from fringedic.recording.manifest import MANIFEST, ManifestCheck
from fringedic.recording.programme_end import ProgrammeEnd
from fringedic.recording.reader import describe_parts
from fringedic.recording.repair import Content
from fringedic.recording.topics import EXPOSURE, IMAGE
from fringedic.recording.verification import Verification
from fringedic.wording.numbers import counted, grouped

REFERENCE, PARAMETERS, CALIBRATION = "experiment/reference", "node_parameters", "calibration"
IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


def content_sentences(content: Content) -> list[str]:
    """Return what of a recording can be read, and what is lost.

    Examples
    --------
    >>> from pathlib import Path
    >>> image, force = "/rig/camera/image_raw", "/rig/load_frame/state"
    >>> content_sentences(Content(Path("bag"), {image: 36, force: 1200}, {}, ""))
    ['whole: 36 frames, 1 236 messages of all topics', 'lost: nothing']
    >>> content_sentences(Content(Path("bag"), {image: 24, force: 80}, {image: 12, force: 1120}, "not closed"))
    ['whole: 24 of 36 frames, 104 of 1 236 messages of all topics', 'lost: 12 frames, 1 120 other messages; not closed']
    """
    messages = content.messages, sum(content.missing.values())
    frames = _frames(content.counts), _frames(content.missing)
    lines = [f"whole: {_share(*frames)} frames, {_share(*messages)} messages of all topics"]
    if content.unlisted:
        lines.append(f"not listed in {METADATA}, but read: {', '.join(content.unlisted)}; remove other recordings")
    if content.whole:
        return [*lines, "lost: nothing"]
    missing = f"{counted(frames[1], 'frame')}, {counted(messages[1] - frames[1], 'other message')}"
    lost = missing if content.missing else "", content.damage, describe_parts(content.parts)
    return [*lines, f"lost: {'; '.join(filter(None, lost))}"]


def programme_sentences(end: ProgrammeEnd | None) -> list[str]:
    """Return how the programme of a recording ended.

    Examples
    --------
    >>> programme_sentences(ProgrammeEnd("plate", 3, "the machine reports a fault", 203))
    ['programme: plate ended early at step 3: the machine reports a fault']
    >>> programme_sentences(ProgrammeEnd("plate", 10))
    ['programme: plate is complete']
    """
    if end is None:
        return []
    how = f"ended early at step {end.step}: {end.reason}" if end.reason else "is complete"
    return [f"programme: {end.experiment} {how}"]


def next_command(content: Content, types: Mapping[str, str] | None = None) -> str:
    """Return the command that follows after the content of a recording is known.

    Parameters
    ----------
    content
        What of the recording can be read.
    types
        Types of its topics, None where they are not known; images without exposure records can be measured by them.

    Examples
    --------
    >>> from pathlib import Path
    >>> next_command(Content(Path("bag"), {"/rig/camera/image_raw": 24}, {}, "not closed"))
    'next: `fringedic recover bag` writes a recording of what is whole'
    >>> next_command(Content(Path("bag"), {"/left/image": 24}, {}, ""), {"/left/image": "sensor_msgs/msg/Image"})
    'next: `fringedic measure bag --bag /left/image` measures displacement and strain of the images, without a rig'
    """
    path = content.path
    if not content.whole:
        written = "one recording of all parts" if content.parts else "a recording of what is whole"
        return f"next: `fringedic recover {path}` writes {written}"
    if any(f"/{name}".endswith("/dic/status") and count for name, count in content.counts.items()):
        return f"next: `fringedic report {path}` shows the results; `fringedic process {path}` computes them again"
    if _recorded(content, IMAGE) and _recorded(content, EXPOSURE):
        return _process_command(content)
    images = [name for name, type_name in (types or {}).items() if type_name in IMAGE_TYPES and content.counts[name]]
    if images:
        commands = " or ".join(f"`fringedic measure {path} --bag {name}`" for name in images)
        return f"next: {commands} measures displacement and strain of the images, without a rig"
    return "next: measure again; without frames there is nothing to process"


def _process_command(content: Content) -> str:
    """Return the command that measures the frames, with the options for what is not recorded."""
    path, options, notes = content.path, "", ""
    if not _recorded(content, REFERENCE):
        options += " --reference STEP"
    if not _recorded(content, PARAMETERS):
        options += " --set specimen.force_sign=1 --set specimen.force_tare_newton=0"
        notes += "; no settings are recorded (node_parameters), defaults are used"
    if not _recorded(content, CALIBRATION):
        notes += "; fringes need --calibration FILE, none is recorded"
    return f"next: `fringedic process {path}{options}` measures the recorded frames{notes}"


def _recorded(content: Content, name: str) -> bool:
    return any(f"/{topic}".endswith(f"/{name}") and count for topic, count in content.counts.items())


def _frames(counts: Mapping[str, int]) -> int:
    return sum(count for name, count in counts.items() if f"/{name}".endswith(f"/{IMAGE}"))


def _share(readable: int, missing: int) -> str:
    total = f" of {grouped(readable + missing)}" if missing else ""
    return f"{grouped(readable)}{total}"


def verification_sentences(verification: Verification) -> Iterator[str]:
    """Yield the outcome of a verification; the last sentence counts the frames."""
    files, messages = verification.files, grouped(verification.messages)
    yield f"recording: {verification.path}, {messages} messages in {files} file{'s' if files != 1 else ''}"
    yield f"files: {_manifest(verification.manifest)}"
    yield f"chunks: {_chunks(verification)}"
    yield f"publishers' counts: {_counts(verification)}"
    for (experiment, step), (recorded, frames) in verification.unfinished_steps.items():
        name = f"step {step} of {experiment or 'no experiment'}"
        yield f"{name}: no successful end recorded, {recorded} of {frames} frames"
    for experiment, step in verification.repeated_steps:
        yield f"step {step} of {experiment}: measured more than once under this number"
    if verification.dropped:
        yield f"camera: dropped {grouped(verification.dropped)} frames before it published them"
    exposed = verification.frames + verification.lost_frames
    yield f"{grouped(verification.frames)} of {grouped(exposed)} frames, {grouped(verification.lost_frames)} lost"


def _counts(verification: Verification) -> str:
    gaps = ", ".join(f"{grouped(count)} of {name}" for name, count in sorted(verification.gaps.items()))
    if not verification.uncounted:
        return f"missing are {gaps}" if gaps else "no message is missing"
    topics = ", ".join(verification.uncounted)
    unknown = f"whether messages are missing cannot be known of {topics}, which have no sequence numbers"
    return f"missing are {gaps}; {unknown}" if gaps else unknown


def _chunks(verification: Verification) -> str:
    number = verification.unchecked
    unchecked = f"{counted(number, 'chunk')} {'has' if number == 1 else 'have'} no checksum" if number else ""
    if number and not verification.manifest.present:
        unchecked += f" and no {MANIFEST}: a changed byte would not be found, record with checksums"
    return "; ".join(filter(None, (verification.damage, unchecked))) or "all fit their checksums"


def _manifest(check: ManifestCheck) -> str:
    if not check.present:
        absent = f"no {MANIFEST}, because the recording was not closed or an earlier version wrote it"
        return "; ".join([absent, *(f"{name} is not listed in {METADATA}" for name in check.unlisted)])
    if check.fits:
        return f"all {len(check.equal)} fit {MANIFEST}"
    problems = [f"{name} has changed since the recording was closed" for name in check.changed]
    problems += [f"{name} is missing" for name in check.missing]
    problems += [f"{name} is not listed in {MANIFEST}" for name in check.unlisted]
    if check.unreadable:
        problems.append(f"{MANIFEST} is damaged")
    return "; ".join(problems)


_MS, _PPM = 1e3, 1e6


def clock_sentences(clocks: Mapping[str, ClockEstimate]) -> list[str]:
    """Return one sentence for each device with a clock of its own: its offset and its drift.

    Parameters
    ----------
    clocks
        Estimates by the name of the device, as `fringedic.signals.clocks.recorded_clocks` returns them.

    Examples
    --------
    >>> clock_sentences({"camera": ClockEstimate(0, offset=1.5e-3, drift=2e-5, drift_sigma=3e-7, samples=40)})
    ['Clock of the camera: +1.500 ms relative to this computer since the first comparison; drift +20.0 ppm (standard \
uncertainty 0.3 ppm).']
    """
    return [_sentence(name, clock) for name, clock in clocks.items()]


def _sentence(name: str, clock: ClockEstimate) -> str:
    words = f"Clock of the {name}: {_MS * clock.offset:+.3f} ms relative to this computer since the first comparison"
    if math.isnan(clock.drift):
        return f"{words}."
    sigma = "" if math.isnan(clock.drift_sigma) else f" (standard uncertainty {_PPM * clock.drift_sigma:.2g} ppm)"
    return f"{words}; drift {_PPM * clock.drift:+.1f} ppm{sigma}."
