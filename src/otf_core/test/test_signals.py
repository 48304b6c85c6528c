# SPDX-License-Identifier: Apache-2.0
"""Signals beside the samples: read from bags, lagged, found as what a displacement follows."""

from dataclasses import replace

import numpy as np
import pytest
from core_cells import some_machine
from effect_cells import driven_state
from engine_cells import holding, noise, solved_rows
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from otf_core.bags.bag import BagContent, read_bag, write_bag
from otf_core.bags.bag_signals import read_signals
from otf_core.config import PlannerConfig, SimulationConfig
from otf_core.diagnosis.cause_parameters import fitted_causes
from otf_core.diagnosis.engine.search import search, tried_effects
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.effects_yaml import effects_from_data, effects_to_data
from otf_core.effects.free_form import signal_forms
from otf_core.errors import ConfigError
from otf_core.model.machine import machine_from_dict
from otf_core.model.sections import SIGNAL_DRIVEN
from otf_core.model.signals import LAGS, Courses, Signal
from otf_core.planning.path_creation import plan_path
from otf_core.sim.cell import simulate

START = 1_700_000_000_000_000_000


def test_a_step_is_followed_as_one_minus_an_exponential():
    stamps = START + np.int64(1e9) * np.array([0, 10, 200], dtype=np.int64)
    step = Signal(stamps, np.array([20.0, 23.0, 23.0]))
    time = np.array([-5.0, 5.0, 10.0, 40.0, 300.0])
    found = step.at(START, time, 30.0)
    later = np.maximum(time - 10.0, 0.0)
    assert np.allclose(found, 20.0 + 3.0 * (1 - np.exp(-later / 30.0)))
    assert np.allclose(step.at(START, time), [20.0, 21.5, 23.0, 23.0, 23.0])


def test_lags_longer_than_the_signal_are_left_out():
    signal = Signal(START + np.arange(5) * 20_000_000_000, np.arange(5.0))
    found = Courses({'signal:/t': signal}, START, np.arange(3.0))
    assert max(LAGS) > 80.0 > min(LAGS)
    assert list(found) == ['signal:/t', *(f'signal:/t@{n:g}' for n in LAGS if n < 80.0)]


def bag_of_signals(folder):
    """A bag with a temperature and a switch."""
    store = get_typestore(Stores.ROS2_JAZZY)
    header, stamp = (
        store.types[n] for n in ('std_msgs/msg/Header', 'builtin_interfaces/msg/Time')
    )
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {'/motor': 'sensor_msgs/msg/Temperature', '/coolant': 'std_msgs/msg/Bool'}
        to = {t: writer.add_connection(t, k, typestore=store) for t, k in kinds.items()}
        for k in range(4):
            received = START + k * 1_000_000_000
            head = header(stamp=stamp(sec=received // 10**9, nanosec=500), frame_id='')
            warm = store.types[kinds['/motor']](header=head, temperature=20.0 + k, variance=0.0)
            on = store.types[kinds['/coolant']](data=k > 1)
            for topic, message in (('/motor', warm), ('/coolant', on)):
                data = store.serialize_cdr(message, kinds[topic])
                writer.write(to[topic], received, data)
    return folder


def test_numbers_are_read_with_their_own_stamps(tmp_path):
    bag = bag_of_signals(tmp_path / 'bag')
    found = read_signals(bag, declaring({'/motor': {}, '/coolant:data': {}}).signals)
    warm, on = found['signal:/motor'], found['signal:/coolant:data']
    assert warm.value.tolist() == [20.0, 21.0, 22.0, 23.0] and warm.stamp_ns[0] == START + 500
    assert on.value.tolist() == [0.0, 0.0, 1.0, 1.0] and on.stamp_ns[0] == START
    with pytest.raises(ConfigError, match='name a field of sensor_msgs/msg/Temperature'):
        read_signals(bag, declaring({'/motor:colour': {}}).signals)


def test_a_lag_between_the_usual_ones_and_a_fixed_point_anywhere_are_found():
    """An axis that grows from its far end, 43 s behind a switch; what a table of steps says."""
    rows = solved_rows()
    seconds = np.arange(400.0)
    switch = ((seconds > 8.0) & (seconds % 60.0 < 35.0)).astype(float)
    warm = np.zeros_like(seconds)
    for k in range(1, len(warm)):
        warm[k] = switch[k - 1] + (warm[k - 1] - switch[k - 1]) * np.exp(-1.0 / 43.0)
    beside = {'signal:/motor': Signal(np.int64(1e9) * seconds.astype(np.int64), switch)}
    states = tuple(replace(s, more=Courses(beside, 0, s.time, s.more)) for s in rows.states)
    far = some_machine().upper[0]
    parts = [
        np.einsum(
            'cpk,pk->cp',
            run.system.axes,
            (2e-5 * np.interp(s.time, seconds, warm) * (s.q[:, 0] - far) / far)[:, None]
            * [1, 0, 0],
        ).ravel()
        for run, s in zip(rows.done.runs, states, strict=True)
    ]
    rows = holding(noise(9) + np.concatenate(parts), replace(rows, states=states))
    names = ['thermal_axis_expansion', 'thermal_structure_drift']
    tried, _ = tried_effects(rows, [REGISTRY[n] for n in names], {})
    causes, _ = search(rows, tried)
    (cause,), (part,) = causes, fitted_causes(causes, rows)
    (signal,) = cause.option.effect.spans
    assert signal.startswith('signal:/motor@') and abs(float(signal.split('@')[1]) - 43.0) < 4.0
    assert (cause.option.effect.name, cause.option.axes) == ('thermal_axis_expansion', ('X',))
    places = [part.names.index(f'{n}_X_1') for n in 'SD']
    strain, shift = part.value[places]
    slope = np.array([shift / strain**2, -1.0 / strain])
    u = float(np.sqrt(slope @ part.covariance[np.ix_(places, places)] @ slope))
    assert -shift / strain == pytest.approx(far, abs=3.0 * u) and u < 0.05 * far
    given = [AppliedEffect(cause.option.effect, {'S_X_1': strain, 'D_X_1': shift})]
    assert (
        effects_from_data(effects_to_data(given, some_machine()), 'file', some_machine())[0].effect
        == cause.option.effect
    )
    moved = given[0].effect.displacement(states[0], given[0].parameters)
    assert np.abs(moved[:, 1:]).max() == 0.0 < np.abs(moved[:, 0]).max()


# ---------------------------------------------------------------- declared in machine.yaml

DECLARED = {
    '/motor': {'unit': 'K', 'acts_on': ['thermal_axis_expansion']},
    '/coolant': {'type': 'std_msgs/msg/Bool'},
    '/state:load.percent': {'unit': '%'},
}


def declaring(signals):
    """A machine with a section of signals."""
    return machine_from_dict({**some_machine().to_dict(), 'signals': signals})


def test_declared_signals_are_echoed_and_read_where_a_bag_has_them(tmp_path, caplog):
    machine = declaring({**DECLARED, '/oil': {}})
    assert machine_from_dict(machine.to_dict()).signals == machine.signals
    motor, coolant, state, _ = machine.signals
    assert (motor.type, coolant.unit, state.type) == ('sensor_msgs/msg/Temperature', '', '')
    bag = bag_of_signals(tmp_path / 'bag')
    found = read_signals(bag, machine.signals)
    assert list(found) == ['signal:/motor', 'signal:/coolant']
    assert found['signal:/motor'].value.tolist() == [20.0, 21.0, 22.0, 23.0]
    assert 'no topic /oil, a signal of the machine' in caplog.text


@pytest.mark.parametrize(
    ('signals', 'words'),
    [
        ({'motor': {}}, 'signals: motor:'),
        (
            {'/motor': {'type': 'a/msg/B'}},
            "'a/msg/B' is not a message with one number; possible: s",
        ),
        ({'/motor:mass': {'type': 'std_msgs/msg/Bool'}}, 'has no field mass; its number is data'),
        ({'/motor': {'acts_on': ['backlash']}}, 'acts_on:'),
        ({'/motor': {'colour': 'red'}}, 'colour:'),
    ],
)
def test_what_is_wrong_with_a_declaration_is_said(signals, words):
    with pytest.raises(ConfigError) as caught:
        declaring(signals)
    assert words in str(caught.value)


def test_a_signal_drives_only_what_it_may_act_on():
    machine = declaring(DECLARED)
    probe = driven_state()
    course = np.arange(float(len(probe)))
    states = [replace(probe, machine=machine, more={'signal:/motor@30': course})]
    named = {e: signal_forms(REGISTRY[e], states) for e in SIGNAL_DRIVEN}
    assert [e for e, forms in named.items() if forms] == ['thermal_axis_expansion']


def test_a_simulated_run_holds_the_signals_that_effects_follow(tmp_path):
    """The displacement is read off the samples again: 2 um per K of what the bag says."""
    machine = declaring({'/coolant': {'type': 'std_msgs/msg/Float64'}})
    follows = effects_from_data([{
        'effect': 'thermal_structure_drift', 'form': 'free', 'parameters': {'Z_1': 6e-6},
        'inputs': {'signal:/spindle': [20.0, 26.0]},
    }], 'effects', machine)  # fmt: skip
    plan = plan_path(machine, PlannerConfig(passes=1, levels=2, feed=0.5))
    config = SimulationConfig(rate=20.0, seed=3)
    run, still = simulate(machine, plan, config, effects=follows), simulate(machine, plan, config)
    write_bag(tmp_path / 'bag', BagContent(run.samples, plan.path, signals=run.signals))
    declared = declaring({'/spindle': {}, '/coolant': {}}).signals
    read = read_signals(tmp_path / 'bag', declared)
    warm = read['signal:/spindle']
    assert {s.wanted for s in run.signals} == {'/spindle', '/coolant'}
    assert set(read['signal:/coolant'].value.tolist()) == {0.0, 1.0}
    assert warm.value.min() == 20.0 and 22.0 < warm.value.max() <= 26.0
    moved = (run.samples.xyz - still.samples.xyz) @ run.pose.rotation.T
    stamps = run.samples.stamp_ns - warm.stamp_ns[0]
    kelvin = np.interp(stamps, warm.stamp_ns - warm.stamp_ns[0], warm.value) - 20.0
    assert np.allclose(moved, np.outer(kelvin, [0.0, 0.0, 2e-6]), atol=1e-9)
    assert read_bag(tmp_path / 'bag').samples.xyz.tobytes() == run.samples.xyz.tobytes()
