# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name='otf_tracker_driver',
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/otf_tracker_driver']),
        ('share/otf_tracker_driver', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='OTF calibration maintainers',
    description='Node that publishes tracker samples: simulated, replayed, or measured.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'tracker_driver = otf_tracker_driver.__main__:main',
        ]
    },
)
