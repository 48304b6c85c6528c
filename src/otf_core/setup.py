# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name='otf_core',
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={'': ['py.typed', '*.yaml', '*.json', '*.html', '*.css', '*.js']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/otf_core']),
        ('share/otf_core', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='OTF calibration maintainers',
    maintainer_email='maintainers@example.org',
    description='ROS-free core: model, alignment, solution, bags, command line.',
    license='Apache-2.0',
)
