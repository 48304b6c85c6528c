# SPDX-License-Identifier: Apache-2.0
"""Simulated runs of chains with and without rotary axes, with one reflector and with several."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import some_machine
from rotary_cells import machine as trunnion

from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.model.chain import Sight
from otf_core.model.frames import RigidTransform
from otf_core.model.machine import Target, machine_from_dict
from otf_core.planning.forecast import Setup
from otf_core.planning.part_choice import planned
from otf_core.sim.cell import BROKEN_BEAM, random_tables, simulate

RATE = 20.0
SILENT = AppliedEffect(REGISTRY['tracker_noise'], {'level_range': 0.0, 'level_angle': 0.0})


def several(link, **targets):
    """A machine of three linear axes with more reflectors before a tracker on a link."""
    machine = some_machine('w-Y-b-X-Z-t')
    own = {name: Target(on, (0.05, -0.02, -0.1)) for name, on in targets.items()}
    return replace(machine, tracker=replace(machine.tracker, link=link), stated_targets=own)


def fewer(chain, **targets):
    """A machine that has some of the axes of the trunnion alone."""
    data = trunnion().to_dict()
    axes = {name: own for name, own in data['axes'].items() if name in chain}
    tracker = {**data['tracker'], 'link': 'b' if targets else 'w'}
    own = {'chain': chain, 'axes': axes, 'targets': targets, 'tracker': tracker}
    return machine_from_dict(data | own)


NEST = {'link': 'w', 'place': [0.1, 0.02, 0.06], 'u': 1e-3}
MACHINES = {
    'three axes': some_machine('w-Y-b-X-Z-t'),
    'two lengths': several('w', long='t'),
    'on the bed': several('b', nest='w'),
    'trunnion': trunnion(),
    'plotter': fewer('w-b-X-Y-t'),
    'rotary table': fewer('w-C-b-t', nest=NEST),
}
every_machine = pytest.mark.parametrize('machine', MACHINES.values(), ids=MACHINES)


def simulated(machine, effects=(SILENT,), **options):
    config = SimulationConfig(**{'seed': 4, 'rate': RATE, 'clock_drift': 0.0} | options)
    plan = planned(Setup.of(machine), PlannerConfig(passes=1, levels=2))
    tables = random_tables(machine, 1e-5, np.random.default_rng(1)).scaled(0.0)
    return simulate(machine, plan, config, tables, effects)


def parts_of(run):
    """Times since the start of every part, and points seen from the link of the tracker."""
    breaks = np.flatnonzero(np.diff(run.samples.time) > 1.9) + 1
    pose = RigidTransform(run.pose.rotation, run.pose.translation)
    points = np.split(pose.apply(run.samples.xyz), breaks)
    times = np.split(run.samples.time, breaks)
    return [time - time[0] for time in times], points


@every_machine
def test_machine_without_errors_is_where_the_plan_says(machine):
    run = simulated(machine)
    times, points = parts_of(run)
    assert len(points) == len(run.parts) == len(run.drives)
    for drive, time, seen in zip(run.drives, times, points, strict=True):
        target = machine.targets[drive.part.target]
        place = run.places[drive.part.target]
        sight = Sight(machine, machine.tracker.link, target.link, place)
        assert np.abs(seen - sight.nominal(drive.at(time))).max() < 1e-9
        assert np.abs(place - target.place).max() < 6 * target.u + 1e-12
        assert time[-1] == pytest.approx(drive.duration, abs=2.0 / RATE)
    assert run.samples.time[-1] == pytest.approx(
        sum(d.duration for d in run.drives) + BROKEN_BEAM * (len(run.drives) - 1), abs=2.0 / RATE
    )


@every_machine
def test_states_of_samples_tell_how_they_are_driven(machine):
    run = simulated(machine)
    for drive, time in zip(run.drives, parts_of(run)[0], strict=True):
        now = drive.motion(time + 1e-4)
        slope = (drive.at(time + 2e-4) - drive.at(time)) / 2e-4
        smooth = np.minimum(now.from_corner, now.to_corner) > 1e-3
        assert np.abs(slope - now.rates)[smooth].max() < 2e-3
        assert np.all(now.from_corner > -1e-12) and np.all(now.to_corner > -1e-12)
        assert now.line[0] == 0 and now.line[-1] == len(drive.corners) - 2
        assert np.all(np.diff(now.leg) >= 0) and now.leg[-1] == len(drive.unit) - 1


@every_machine
def test_rounding_lost_packets_and_effects_act_on_every_machine(machine):
    plain = simulated(machine)
    rounded = simulated(machine, resolution=1e-6).samples.xyz
    assert np.abs(rounded - plain.samples.xyz).max() <= 0.5e-6 * (1 + 1e-6)
    np.testing.assert_allclose(rounded, np.rint(rounded * 1e6) * 1e-6, atol=1e-15)
    lossy = simulated(machine, packet_loss=0.2).samples
    kept = np.isin(plain.samples.stamp_ns, lossy.stamp_ns)
    np.testing.assert_array_equal(lossy.xyz, plain.samples.xyz[kept])
    assert 0.05 < 1 - kept.mean() < 0.4
    gaps = np.diff(lossy.stamp_ns) * 1e-9
    assert gaps[gaps > 0.1].min() == pytest.approx(1 / 3, abs=0.06)
    offset = AppliedEffect(REGISTRY['tracker_range_offset'], {'c': 1e-4})
    moved = simulated(machine, [SILENT, offset])
    far = [np.linalg.norm(r.samples.xyz, axis=1) for r in (plain, moved)]
    np.testing.assert_allclose(far[1] - far[0], 1e-4, atol=1e-9)
