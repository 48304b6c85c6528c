# SPDX-License-Identifier: Apache-2.0
"""Signals beside the samples: read from bags, lagged, found as what a displacement follows."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from core_cells import some_machine
from engine_cells import holding, noise, solved_rows
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from otf_core.bags.signals import read_signals
from otf_core.diagnosis.engine.catalogue import tried_effects
from otf_core.diagnosis.engine.search import search
from otf_core.effects import REGISTRY, AppliedEffect
from otf_core.effects.effects_yaml import effects_from_data, effects_to_data
from otf_core.errors import ConfigError
from otf_core.model.signals import LAGS, Signal, courses

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
    found = courses({'signal:/t': signal}, START, np.arange(3.0))
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
    found = read_signals(bag, ['/motor', '/coolant:data'])
    warm, on = found['signal:/motor'], found['signal:/coolant:data']
    assert warm.value.tolist() == [20.0, 21.0, 22.0, 23.0] and warm.stamp_ns[0] == START + 500
    assert on.value.tolist() == [0.0, 0.0, 1.0, 1.0] and on.stamp_ns[0] == START
    with pytest.raises(ConfigError, match='has no topic /oil; it has /coolant, /motor'):
        read_signals(bag, ['/oil'])
    with pytest.raises(ConfigError, match='name a field of sensor_msgs/msg/Temperature'):
        read_signals(bag, ['/motor:colour'])


def test_strain_that_follows_a_signal_is_named_with_it():
    rows, name = solved_rows(), 'signal:/motor@30'

    def course(state):
        return 20.0 + np.sin(state.time / 25.0) + 0.5 * np.sin(state.time / 7.0)

    states = tuple(
        replace(s, more={**s.more, name: course(s), 'signal:/other': np.cos(s.time / 11.0)})
        for s in rows.states
    )
    rows = replace(rows, states=states)
    parts = [
        np.einsum('cpk,pk->cp', run.system.axes,
                  (8e-6 * (course(s) - 20.0) * s.q[:, 0] / 0.3)[:, None] * [1, 0, 0]).ravel()
        for run, s in zip(rows.done.runs, states, strict=True)
    ]  # fmt: skip
    rows = holding(noise(9) + np.concatenate(parts), rows)
    names = ['thermal_axis_expansion', 'thermal_structure_drift', 'backlash']
    tried, _ = tried_effects(rows, [REGISTRY[n] for n in names], {})
    cause = search(rows, tried)[0][0]
    effect = cause.option.effect
    assert effect.name == 'thermal_axis_expansion' and list(effect.spans) == [name]
    assert cause.option.axes == ('X',)
    # 8 um over 0.3 m per unit of the signal
    given = AppliedEffect(effect, {'S_X_1': 1e-5})
    entry = yaml.safe_load(yaml.safe_dump(effects_to_data([given], some_machine())))
    assert effects_from_data(entry, 'file', some_machine()) == (given,)
