from setuptools import find_packages, setup

package_name = "coupling_node"

setup(
    name=package_name,
    version="0.1.0",
    description="Phase, in-plane displacement and calibration to shape and 3D displacement point clouds",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    entry_points={
        "console_scripts": [
            "coupling = coupling_node.coupling_node:main",
        ],
    },
)
