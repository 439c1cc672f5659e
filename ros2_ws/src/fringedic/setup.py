"""Packaging of every Python package of this workspace: theirs run this file in their own folder.

Name, version, description, maintainer, licence and addresses come from package.xml; the rest, which differs, is in
setup.cfg.
"""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

package = ElementTree.parse("package.xml").getroot()
name = package.findtext("name", "")
maintainer = package.find("maintainer")
addresses = {each.get("type", "website"): each.text or "" for each in package.findall("url")}
readme = Path(__file__).resolve().parents[3] / "README.md"  # beside the workspace; a wheel without it has none
share = f"share/{name}"
folders = {folder: sorted(str(path) for path in Path(folder).glob("*.*")) for folder in ("config", "launch", "rviz")}

MANUAL = ("*.md", "*/*.md", "*/*.png", "*/*.svg")


class BuildWithManual(build_py):
    """Copies the manual of the repository into the library, whose page of a rig shows it."""

    def run(self) -> None:
        """Copy the packages, and the manual where it is there."""
        super().run()
        docs = Path(__file__).resolve().parents[3] / "docs"
        target = Path(self.build_lib) / "fringedic" / "report" / "page_server" / "manual_pages"
        if name != "fringedic" or self.editable_mode:
            return
        for file in (each for pattern in MANUAL for each in docs.glob(pattern)):
            copy = target / file.relative_to(docs)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(file.read_bytes())


setup(
    name=name,
    cmdclass={"build_py": BuildWithManual},
    version=package.findtext("version", ""),
    description=package.findtext("description", ""),
    license=package.findtext("license", ""),
    long_description=readme.read_text("utf-8") if readme.is_file() else "",
    long_description_content_type="text/markdown",
    author="" if maintainer is None else maintainer.text,
    maintainer="" if maintainer is None else maintainer.text,
    maintainer_email="" if maintainer is None else maintainer.get("email"),
    url=addresses.get("repository", ""),
    project_urls={"Repository": addresses.get("repository", ""), "Issues": addresses.get("bugtracker", "")},
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Topic :: Scientific/Engineering :: Image Processing",
        "Topic :: Scientific/Engineering :: Physics",
    ],
    python_requires=">=3.11",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
        (share, ["package.xml"]),
        *((f"{share}/{folder}", files) for folder, files in folders.items() if files),
        *((f"lib/{name}", [str(path)]) for path in Path("scripts").glob("*")),
    ],
)
