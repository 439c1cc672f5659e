from setuptools import find_packages, setup

package_name = "fringedic_ros"

setup(
    name=package_name,
    version="0.1.0",
    description="What every fringedic node shares: QoS profiles, images and clouds, typed parameters, diagnostics",
    license="Apache-2.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
)
