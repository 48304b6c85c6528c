# SPDX-License-Identifier: Apache-2.0
import re
from pathlib import Path

from setuptools import find_packages, setup

FILE = Path(__file__).resolve().parent / 'otf_core' / 'version.py'
VERSION = re.search(r"__version__ = '(.+)'", FILE.read_text(encoding='utf-8'))[1]

setup(
    name='otf_core',
    version=VERSION,
    packages=find_packages(exclude=['test']),
    package_data={'': ['py.typed', '*.yaml', '*.json', '*.html', '*.css', '*.js']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/otf_core']),
        ('share/otf_core', ['package.xml']),
    ],
    python_requires='>=3.10',
    install_requires=[
        'numpy>=1.26',  # arrays, linear algebra
        'scipy>=1.11',  # sparse matrices, rotations, distributions
        'PyYAML>=6.0',  # machine.yaml and the other settings
        'mcap>=1.1.1',  # MCAP records; brings lz4
        'zstandard>=0.18',  # unpacks the chunks of MCAP files
        'rosbags>=0.11',  # bags of any storage and version, CDR, message definitions
        'threadpoolctl>=3.1',  # one thread for small matrices: faster, the same result everywhere
    ],
    extras_require={'test': ['pytest'], 'fleet': ['distributed']},
    entry_points={'console_scripts': ['otf = otf_core.cli.__main__:run']},
    zip_safe=False,
    maintainer='OTF calibration maintainers',
    maintainer_email='maintainers@example.org',
    description='ROS-free core: model, alignment, solution, bags, command line.',
    license='Apache-2.0',
)
