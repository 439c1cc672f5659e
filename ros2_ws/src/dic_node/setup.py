from setuptools import find_packages, setup

package_name = "dic_node"

setup(
    name=package_name,
    version="0.1.0",
    description="Texture images to in-plane displacement",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    entry_points={
        "console_scripts": [
            "dic = dic_node.dic_node:main",
            "extensometer = dic_node.extensometer_node:main",
        ],
    },
)
