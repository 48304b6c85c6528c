# SPDX-License-Identifier: Apache-2.0
"""What all launch files share: unknown arguments are refused, and an end is not passed over."""

import logging
import sys
from difflib import get_close_matches

from launch.actions import Shutdown

SWITCH = {'true': True, 'yes': True, 'on': True, '1': True,
          'false': False, 'no': False, 'off': False, '0': False}  # fmt: skip
CAUGHT = 'Caught exception in launch (see debug for traceback): '
ALL_ENDS = ', so all nodes are ended'


def refuse_unknown(known, words, files):
    """Name launch arguments that nothing reads; launch itself takes any.

    Parameters
    ----------
    known : sequence of str
        Names of the arguments that are read.
    words : sequence of str
        'name:=value' as typed.
    files : tuple of str
        Launch files that check; of others that include them these are not the words.
    """
    if not any(word.endswith(files) for word in sys.argv):
        return
    for name in [word.partition(':=')[0] for word in words if ':=' in word]:
        if name not in known:
            near = get_close_matches(name, known, 1)
            hint = f'; did you mean {near[0]!r}?' if near else ''
            raise RuntimeError(f'launch argument {name!r} is unknown{hint}; --show-args lists all')


def is_on(given, name):
    """Return whether a launch argument is on; RuntimeError if its word says neither.

    Parameters
    ----------
    given : mapping of str to str
        Launch arguments.
    """
    word = given[name].strip().lower()
    if word not in SWITCH:
        raise RuntimeError(f'{name}: {given[name]!r}; give true or false')
    return SWITCH[word]


class ProcessFailed(RuntimeError):
    """A process has failed: it ends the launch with exit code 1, as only an exception can."""


class _WithoutFalseAlarm(logging.Filter):
    """Takes the words about an exception off the message on an end that is as it should be."""

    def filter(self, record):
        text, mark = record.getMessage(), ALL_ENDS
        if text.startswith(CAUGHT) and mark in text:
            record.msg, record.args = text.removeprefix(CAUGHT), ()
        return True


def shut_down_on_exit(event, context, hint=''):
    """End all where one process ends by itself; with an error where that was one."""
    if context.is_shutdown:
        return []
    if event.returncode:
        logging.getLogger('launch').addFilter(_WithoutFalseAlarm())
        raise ProcessFailed(
            f'{event.process_name} ended with exit code {event.returncode}{ALL_ENDS}{hint}'
        )
    return [Shutdown(reason=f'{event.process_name} has ended')]
