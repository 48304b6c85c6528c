# SPDX-License-Identifier: Apache-2.0
import re
from pathlib import Path

from setuptools import find_packages, setup

INIT = Path(__file__).resolve().parent / 'otf_core' / '__init__.py'
VERSION = re.search(r"__version__ = '(.+)'", INIT.read_text(encoding='utf-8'))[1]

setup(
    name='otf_core',
    version=VERSION,
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
