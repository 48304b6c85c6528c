# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name='otf_compensator',
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/otf_compensator']),
        ('share/otf_compensator', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='OTF calibration maintainers',
    description='Node that corrects commanded positions by error tables.',
    license='Apache-2.0',
    entry_points={'console_scripts': ['compensator = otf_compensator.__main__:main']},
)
