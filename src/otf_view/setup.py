# SPDX-License-Identifier: Apache-2.0
from setuptools import find_packages, setup

setup(
    name='otf_view',
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/otf_view']),
        ('share/otf_view', ['package.xml']),
    ],
    package_data={'otf_view': ['web/*']},
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='OTF calibration maintainers',
    description='Live view of a calibration: markers, numbers for plots, a page for any browser.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': ['viewer = otf_view.run_viewer:main', 'page = otf_view.run_page:main']
    },
)
