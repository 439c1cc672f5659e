"""What a recording says of the clocks of its camera and its testing machine."""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path
from typing import Any

from fringedic.errors import RecordingError
from fringedic.recording import BagReader

TOPICS = {"camera/clock": "camera", "load_frame/clock": "load frame"}


def clocks_in_words(bag: Path) -> list[str]:
    """Return a sentence for each device whose clock was compared with the computer's; none of a damaged recording."""
    said = []
    try:
        reader = BagReader(bag)
        for name, topic in reader.find_optional(*TOPICS).items():
            for _, message, _ in deque(reader.messages([topic]), maxlen=1):
                said.append(_sentence(TOPICS[name], message))
    except RecordingError:
        return said
    return said


def _sentence(name: str, clock: Any) -> str:
    words = f"clock of the {name}: {1e3 * clock.offset:+.3f} ms against this computer's since the first comparison"
    if math.isnan(clock.drift):
        return words
    uncertain = "" if math.isnan(clock.drift_sigma) else f", standard uncertainty {1e6 * clock.drift_sigma:.2g} ppm"
    return f"{words}; drift {1e6 * clock.drift:+.1f} ppm{uncertain}"
