"""Packaging of every Python package of this workspace: theirs run this file in their own folder.

Name, version, description and licence come from package.xml; the rest, which differs, is in setup.cfg.
"""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

package = ElementTree.parse("package.xml").getroot()
name = package.findtext("name", "")
share = f"share/{name}"
folders = {folder: sorted(str(path) for path in Path(folder).glob("*.*")) for folder in ("config", "launch", "rviz")}

setup(
    name=name,
    version=package.findtext("version", ""),
    description=package.findtext("description", ""),
    license=package.findtext("license", ""),
    python_requires=">=3.11",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (share, ["package.xml"]),
        *((f"{share}/{folder}", files) for folder, files in folders.items() if files),
        *((f"lib/{name}", [str(path)]) for path in Path("scripts").glob("*")),
    ],
)
