# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name='otf_ros',
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/otf_ros']),
        ('share/otf_ros', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='OTF calibration maintainers',
    description='Helpers shared by the nodes: quality of service, message conversion, parameters.',
    license='Apache-2.0',
)
