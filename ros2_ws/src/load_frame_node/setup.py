from setuptools import find_packages, setup

package_name = "load_frame_node"

setup(
    name=package_name,
    version="0.1.0",
    description="Talks to testing machines; a simulated load frame is included",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    entry_points={
        "console_scripts": [
            "load_frame = load_frame_node.load_frame_node:main",
            "stage = load_frame_node.stage_node:main",
        ],
    },
)
