"""After its rehearsal, a node has loaded the machine code that its first steps need."""

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fringedic.configuration.virtual_calibration import calibration_of
from fringedic.frames.collector import Stack
from fringedic.frames.records import FrameRecord
from fringedic.patterns.sequences import fringe_sequence
from fringedic.steps.displacement_tracker import DisplacementTracker
from fringedic.steps.parameters import DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration, preset

MOVED = 5e-4  # [m]

# Measures two steps in a process of its own, after the rehearsal, and prints what was loaded for them.
PROGRAM = """
import pickle, sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from fringedic.steps.displacement_tracker import DisplacementTracker
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.steps.step_results import DicResult, displacement_field
from fringedic.steps import rehearsal

part, inputs = sys.argv[1], sys.argv[2]
with open(inputs, "rb") as file:
    stacks, phases, results, calibration = pickle.load(file)

def received(array):
    array = np.ascontiguousarray(array)
    array.setflags(write=False)
    return array

for phase in phases:
    for name in phase.maps:
        received(phase.maps[name].values)

def loaded():
    modules = [vars(module) for name, module in list(sys.modules.items()) if name.startswith("fringedic")]
    kernels = {kernel for module in modules for kernel in module.values() if isinstance(kernel, Dispatcher)}
    return {f"{kernel.__module__}.{kernel.__name__}{code}" for kernel in kernels for code in kernel.overloads}

getattr(rehearsal, f"rehearse_{part}")()
before = loaded()
displacement, coupling = DisplacementTracker(DicParameters()), ShapeTracker(CouplingParameters(strain_window_px=11))
coupling.set_calibration(calibration)
for stack, phase, result in zip(stacks, phases, results):
    if part == "phase":
        phase_step(stack, PhaseParameters())
    elif part == "displacement":
        displacement.step("test", phase.step, phase.step, phase.texture)
    else:
        labels = dict(result.field.attrs)
        field = displacement_field(
            received(result.displacement), received(result.sigma), origin=(0, 0), spacing=labels["spacing_px"],
            window=labels["window_px"], method=labels["method"])
        surface = coupling.surface(phase)
        coupling.step(phase, DicResult("test", phase.step, phase.step, 0, 0, field), surface=surface)
print(len(before), *sorted(loaded() - before), sep="\\n")
"""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two steps of the virtual plate, with their results."""
    configuration = VirtualRigConfiguration.from_dict(preset("plate", size="tiny"))
    rig = VirtualRig(configuration)
    rows, columns = rig.projector_shape
    sequence = fringe_sequence(columns, rows, [columns, 10], 4)
    stacks = []
    for step, position in enumerate((0.0, MOVED)):
        frames = np.stack([rig.expose(pattern, position, 100 * step + i) for i, pattern in enumerate(sequence)])
        records = [
            FrameRecord("test", step, index, len(sequence), pattern, stamp=index, exposure_time=0.01, dropped=0)
            for index, pattern in enumerate(sequence.patterns)
        ]
        stacks.append(Stack("test", step, records, frames, stamp=len(sequence)))
    phases = [phase_step(stack, PhaseParameters()) for stack in stacks]
    tracker = DisplacementTracker(DicParameters())
    results = [tracker.step("test", phase.step, phase.step, phase.texture) for phase in phases]
    path = tmp_path_factory.mktemp("rehearsal") / "inputs.pickle"
    path.write_bytes(pickle.dumps((stacks, phases, results, calibration_of(configuration))))
    return path


@pytest.mark.parametrize("part", ["phase", "displacement", "coupling"])
def test_first_steps_load_no_machine_code(part: str, inputs: Path) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM, part, inputs], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rehearsed, *further = done.stdout.splitlines()
    assert int(rehearsed) > 0
    assert further == []
