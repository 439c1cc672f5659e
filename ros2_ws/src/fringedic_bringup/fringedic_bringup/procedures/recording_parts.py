"""Parts of a recording: each recorder of a run writes one, and in the end they are joined."""

from __future__ import annotations

import shutil
from pathlib import Path

from fringedic.command.outcome import Progress
from fringedic.recording.bag_files import numbered_parts
from fringedic.recording.repair import join
from fringedic.recording.sentences import content_sentences
from fringedic.recording.writer import Split


def next_part(bag: Path) -> Path:
    """Return the folder of the next part of a recording: bag-2, bag-3 ... beside bag."""
    return bag.with_name(f"{bag.name}-{max(numbered_parts(bag), default=1) + 1}")


def join_parts(bag: Path, progress: Progress, split: Split) -> None:
    """Join the parts that several recorders wrote into one recording; the parts are moved into a folder beside it.

    Parameters
    ----------
    bag
        Folder of the first part, and of the joined recording in the end. Without other parts nothing is done.
    progress
        Receives the progress, and what is missing in the parts.
    split
        When the joined recording continues in its next file.
    """
    parts = [bag, *numbered_parts(bag).values()]
    if parts == [bag]:
        return
    progress.stage(f"joining {len(parts)} parts of the recording")
    joining = bag.with_name("joining")
    shutil.rmtree(joining, ignore_errors=True)  # of a command that was killed
    try:
        joined = join(parts, joining / bag.name, split=split)  # whose name is that of its files
    except BaseException:  # a second Ctrl-C, or a full disk: the next run in the folder joins the parts
        shutil.rmtree(joining, ignore_errors=True)
        raise
    # what lies beside the recording is not a part of it yet, so that a later run joins only that
    kept = bag.with_name("parts")
    kept.mkdir(exist_ok=True)
    number = max(numbered_parts(kept / bag.name), default=0) + 1
    bag.rename(kept / f"{bag.name}-{number}")
    (joining / bag.name).rename(bag)
    joining.rmdir()
    for later, part in enumerate(parts[1:], number + 1):
        part.rename(kept / f"{bag.name}-{later}")
    if not joined.whole:
        progress.note(f"parts of the recording are not complete: {'; '.join(content_sentences(joined))}")
