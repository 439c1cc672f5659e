"""Samples of a machine at a fixed rate, in a thread of their own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from fringedic.errors import MachineError
from fringedic_ros.diagnostics import NodeDiagnostics
from load_frame_node.crosshead import Crosshead
from load_frame_node.machines import LoadMode, Sample

_LONGEST_DELAY_S = 1.0  # of a sample; samples that are later are counted as lost


class Sampler:
    """Reads the machine of a crosshead at a fixed rate.

    Parameters
    ----------
    crosshead
        The machine.
    rate_hz
        Samples per second [Hz].
    on_sample
        Called in the thread of the sampler with each sample; UNKNOWN and NaN when the machine does not answer.
    on_error
        Called in the thread of the sampler with the reason why the machine gives no sample; sampling goes on.
    diagnostics
        Counts samples and lost samples.
    """

    def __init__(
        self,
        crosshead: Crosshead,
        rate_hz: float,
        on_sample: Callable[[Sample], None],
        on_error: Callable[[MachineError], None],
        diagnostics: NodeDiagnostics,
    ) -> None:
        self._crosshead = crosshead
        self._period = 1 / rate_hz
        self._on_sample = on_sample
        self._on_error = on_error
        self._diagnostics = diagnostics
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="load_frame-sampling", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the sampling and its thread."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stopping.is_set():
            self._take_sample()
            due += self._period
            now = time.monotonic()
            if due < now - _LONGEST_DELAY_S:  # the machine did not answer for some time: skip the samples of that time
                self._diagnostics.drop(int((now - due) / self._period))
                due = now
            self._stopping.wait(max(due - now, 0))

    def _take_sample(self) -> None:
        begun_s = time.monotonic()
        try:
            sample = self._crosshead.read()
        except Exception as error:  # whatever a machine answers, a thread that ended would leave its last state valid
            known = error if isinstance(error, MachineError) else _unforeseen(error)
            self._on_error(known)
            sample = Sample.without_answer(begun_s, str(known))
        else:
            if sample.unknown and sample.mode is LoadMode.UNKNOWN:
                self._on_error(MachineError(sample.unknown))
            elif sample.unknown:
                self._diagnostics.failure(sample.unknown)
            else:
                self._diagnostics.success()
        self._on_sample(sample)


def _unforeseen(error: Exception) -> MachineError:
    unforeseen = MachineError(f"the answer of the machine cannot be used: {type(error).__name__}: {error}")
    unforeseen.__cause__ = error
    return unforeseen
