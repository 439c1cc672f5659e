from setuptools import find_packages, setup

package_name = "fringedic"

setup(
    name=package_name,
    version="0.1.0",
    description="3D shape and 3D displacement of a surface from one camera and one projector: the library, without ROS",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "report/*.j2"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=[
        "h5netcdf",
        "h5py",
        "jinja2",
        "matplotlib",
        "mcap",
        "numba",
        "numpy>=1.26",
        "opencv-python-headless",
        "pillow",
        "plotly",
        "pydantic>=2",
        "pyvista",
        "pyyaml",
        "rosbags",
        "scikit-image",
        "scipy",
        "tifffile",
        "xarray",
        "zarr",
        "zstandard",
    ],
)
