from setuptools import find_packages, setup

package_name = "experiment_node"

setup(
    name=package_name,
    version="0.1.0",
    description="Runs load steps, records raw topics to MCAP and replays recordings through the processing nodes",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    entry_points={
        "console_scripts": [
            "experiment = experiment_node.experiment_node:main",
            "recorder = experiment_node.recorder_node:main",
            "player = experiment_node.player_node:main",
        ],
    },
)
