# SPDX-License-Identifier: Apache-2.0
"""Errors that cross from a worker process to its parent."""

import importlib
import pickle
import pkgutil

import pytest

import otf_core
from otf_core.errors import OtfError


def every_error(kind=OtfError):
    """The error and all its subclasses, in every module of the package."""
    for module in pkgutil.walk_packages(otf_core.__path__, 'otf_core.'):
        if not module.name.endswith('__main__'):
            importlib.import_module(module.name)
    found, left = {kind}, [kind]
    while left:
        more = [c for c in left.pop().__subclasses__() if c not in found]
        found.update(more)
        left += more
    return sorted(found, key=lambda c: c.__name__)


@pytest.mark.parametrize('kind', every_error(), ids=lambda c: c.__name__)
def test_an_error_keeps_kind_and_message_between_processes(kind):
    error = pickle.loads(pickle.dumps(kind('run1: what and where')))
    assert type(error) is kind
    assert str(error) == 'run1: what and where'
