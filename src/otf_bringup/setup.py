# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

setup(
    name='otf_bringup',
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/otf_bringup']),
        ('share/otf_bringup', ['package.xml']),
        ('share/otf_bringup/launch', sorted(glob('launch/*.py'))),
        ('share/otf_bringup/config', sorted(glob('config/*'))),
        ('share/otf_bringup/layouts', sorted(glob('layouts/*'))),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='OTF calibration maintainers',
    description='Launch files, parameters and the demo of the calibration cell.',
    license='Apache-2.0',
    entry_points={'console_scripts': ['demo = otf_bringup.__main__:main']},
)
