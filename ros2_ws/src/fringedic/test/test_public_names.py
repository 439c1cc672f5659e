"""What `import fringedic` offers, and what it leaves alone."""

import subprocess
import sys
from pathlib import Path

import pytest

import fringedic

ENVIRONMENT = {"PYTHONPATH": str(Path(__file__).parents[1]), "PATH": ""}


@pytest.mark.parametrize("name", fringedic.__all__)
def test_every_public_name_is_there_and_documented(name):
    assert getattr(fringedic, name).__doc__
    assert name in dir(fringedic)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"attribute .?measure_everything"):
        _ = fringedic.measure_everything


def loaded_by(statement):
    code = f"{statement}; import sys; print(*sorted(m for m in sys.modules if '.' not in m))"
    done = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_a_node_that_needs_little_loads_little():
    assert not {"numba", "xarray", "matplotlib", "scipy", "pandas"} & loaded_by(
        "from fringedic.patterns.pattern import ProjectedPattern"
    )


def test_no_ros_is_imported_by_any_module():
    root = Path(fringedic.__file__).parent
    modules = [".".join(path.relative_to(root.parent).with_suffix("").parts) for path in root.rglob("*.py")]
    everything = "; ".join(f"import {module.removesuffix('.__init__')}" for module in modules)
    loaded = loaded_by(everything)
    assert "numba" in loaded
    assert not {"rclpy", "sensor_msgs", "std_msgs", "fringedic_msgs", "rosbag2_py"} & loaded


def test_the_threading_layer_is_the_one_that_stands_concurrent_calls():
    code = "import fringedic, numba; print(numba.config.THREADING_LAYER)"
    done = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "omp"
