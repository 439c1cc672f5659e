from pathlib import Path

from setuptools import find_packages, setup

package_name = "fringedic_bringup"

setup(
    name=package_name,
    version="0.1.0",
    description="The graph of a rig, launch files, rig configurations and the fringedic command",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/launch", sorted(str(path) for path in Path("launch").glob("*.py"))),
        (f"share/{package_name}/config", sorted(str(path) for path in Path("config").glob("*.*ml"))),
    ],
    entry_points={"console_scripts": ["fringedic = fringedic_bringup.command:main"]},
)
