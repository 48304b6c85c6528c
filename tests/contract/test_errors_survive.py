# SPDX-License-Identifier: Apache-2.0
"""Public names exist, and errors keep their message between processes."""

import importlib
import inspect
import pickle
import pkgutil

import pytest

import otf_core

NAMES = (
    *('read_bag', 'write_bag', 'load_machine', 'load_tables', 'Machine', 'Recording', 'Samples'),
    *('calibrate', 'diagnose', 'predict', 'plan', 'simulate', 'summary', 'OtfError'),
    *('write_calibration', 'write_diagnosis', 'write_plan'),
)


def test_public_names_are_there():
    assert set(NAMES) <= set(otf_core.__all__)
    assert all(getattr(otf_core, name) is not None for name in otf_core.__all__)


def errors():
    """OtfError and all classes that derive from it, wherever in the package."""
    for module in pkgutil.walk_packages(otf_core.__path__, 'otf_core.'):
        if not module.name.endswith('__main__'):
            try:
                importlib.import_module(module.name)
            except ImportError:  # what is optional is not installed
                continue
    found, left = [], [otf_core.OtfError]
    while left:
        kind = left.pop()
        found.append(kind)
        left += kind.__subclasses__()
    return found


def made(kind):
    """An error of the kind: a message, and something for whatever else it asks for."""
    parameters = list(inspect.signature(kind).parameters.values())
    if any(p.kind is p.VAR_POSITIONAL for p in parameters) or not parameters:
        return kind('line 7: what, where, what to do')
    needed = [p for p in parameters if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
    words = ['line 7: what, where, what to do', *[[1, 2]] * (len(needed) - 1)]
    return kind(*words[: max(1, len(needed))])


def test_every_error_keeps_its_message_when_it_is_pickled():
    kinds = errors()
    assert len(kinds) >= 4
    lost = []
    for kind in kinds:
        error = made(kind)
        try:
            again = pickle.loads(pickle.dumps(error))
        except TypeError as trouble:
            lost.append(f'{kind.__name__}: {trouble}')
            continue
        if type(again) is not kind or str(again) != str(error):
            lost.append(f'{kind.__name__}: {again!r}')
    assert not lost, '\n'.join(lost)


@pytest.mark.parametrize('code', [2, 3])
def test_errors_carry_the_exit_code_of_the_command(code):
    kind = {2: otf_core.ConfigError, 3: otf_core.InputError}[code]
    assert kind('x').exit_code == code
