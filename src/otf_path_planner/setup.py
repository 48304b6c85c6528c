# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name='otf_path_planner',
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/otf_path_planner']),
        ('share/otf_path_planner', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='OTF calibration maintainers',
    description='Node that publishes the nominal path and the plan of a calibration run.',
    license='Apache-2.0',
    entry_points={'console_scripts': ['path_planner = otf_path_planner.__main__:main']},
)
