# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name='otf_calibrator',
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/otf_calibrator']),
        ('share/otf_calibrator', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='OTF calibration maintainers',
    description='Node that calibrates a machine from path and samples.',
    license='Apache-2.0',
    entry_points={'console_scripts': ['calibrator = otf_calibrator.__main__:main']},
)
