from setuptools import find_packages, setup

package_name = "camera_node"

setup(
    name=package_name,
    version="0.1.0",
    description="Grabs frames and publishes the images with their exposure records",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    entry_points={
        "console_scripts": [
            "camera = camera_node.camera_node:main",
            "live_view = camera_node.live_view_node:main",
        ],
    },
)
