# SPDX-License-Identifier: Apache-2.0
"""Ways to make a recording of ``nature`` contradict itself, its machine or another one."""

from dataclasses import replace
from functools import cache

import numpy as np
from nature import Cell

from otf_core.config import CalibrationConfig
from otf_core.contradictions.examine import examine
from otf_core.contradictions.recording_checks import check_recordings
from otf_core.model.observation import Samples
from otf_core.pieces.runs import prepare_runs

CONFIG = CalibrationConfig(piece_length=0.02, reversal='none')
SMALL = {'size': (0.3, 0.25, 0.2), 'path': 'short', 'dwell': 0.05, 'passes': 1}


@cache
def cell(seed=1, **options):
    """A small machine of its own kinematics and error forms."""
    return Cell(seed, **{**SMALL, **options})


@cache
def recorded(seed=1, rate=50.0, noise_seed=0, **options):
    """One healthy recording."""
    return replace(cell(seed, **options).recording(rate, noise_seed=noise_seed), name='run 1')


def again(recording, name='run 2', **fields):
    """The recording with other stamps (stamp_ns) or points (xyz), under another name."""
    return replace(recording, samples=replace(recording.samples, **fields), name=name)


def asked(*recordings, repair=True):
    """Findings on recordings, as calibrate comes to them."""
    check_recordings(recordings)
    runs, nodes = prepare_runs(recordings, CONFIG)
    return examine(runs, nodes, CONFIG, repair=repair)[1]


def stepped(recording, shift, at=0.5, turn=(0.0, 0.0, 0.0)):
    """Tracker moved by a shift (3,), m, and a turn (3,), rad, at a share of the samples."""
    xyz = recording.samples.xyz.copy()
    k = int(at * len(xyz))
    xyz[k:] += np.array(shift) + np.cross(turn, xyz[k:])
    return again(recording, recording.name, xyz=xyz)


def warmed(recording, strain, early=0.1):
    """A bed that grows along one direction, most of it in an early share of the samples."""
    xyz = recording.samples.xyz
    way = np.array([2.0, 1.0, -1.0]) / np.sqrt(6.0)
    share = np.linspace(0.0, 1.0, len(xyz))
    growth = strain * (1.0 - np.exp(-share / early)) * (xyz @ way)
    return again(recording, recording.name, xyz=xyz + growth[:, None] * way)


def broken(recording, breaks, shift, seed=0):
    """Beam broken for 0.3 s and found again, each time with another offset of a length, m."""
    rng = np.random.default_rng(seed)
    samples = recording.samples
    time, keep = samples.time, np.ones(len(samples), bool)
    for start in rng.uniform(0.03, 0.97, breaks) * time[-1]:
        keep &= (time < start) | (time > start + 0.3)
    part = np.cumsum(np.diff(keep.astype(int), prepend=1) > 0)
    offset = rng.standard_normal((part[-1] + 1, 3))
    offset *= shift / np.linalg.norm(offset, axis=1, keepdims=True)
    xyz = samples.xyz + offset[part]
    return replace(recording, samples=Samples(samples.stamp_ns[keep], xyz[keep]))


def spoiled_share(recording, share, size, seed=0):
    """Outliers of a size, m, in all directions."""
    rng = np.random.default_rng(seed)
    xyz = recording.samples.xyz.copy()
    bad = rng.random(len(xyz)) < share
    off = rng.standard_normal((int(bad.sum()), 3))
    xyz[bad] += size * off / np.linalg.norm(off, axis=1, keepdims=True)
    return again(recording, recording.name, xyz=xyz)


def mixed(a, b, late_ns=3_000_000, share=1.0, seed=0):
    """Two streams on one topic, the second ``late_ns`` behind and received in part."""
    keep = np.random.default_rng(seed).random(len(b.samples)) < share
    stamp = np.concatenate([a.samples.stamp_ns, b.samples.stamp_ns[keep] + late_ns])
    order = np.argsort(stamp, kind='stable')
    xyz = np.concatenate([a.samples.xyz, b.samples.xyz[keep]])[order]
    return again(a, 'mixed', stamp_ns=stamp[order], xyz=xyz)
