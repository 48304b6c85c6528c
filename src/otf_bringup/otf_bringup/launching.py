# SPDX-License-Identifier: Apache-2.0
"""What all launch files share: unknown arguments are refused, and an end is not passed over."""

import sys
from difflib import get_close_matches

from launch.actions import Shutdown


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
            raise RuntimeError(f'launch argument {name!r} is unknown{hint} --show-args lists all')


def ended(event, context, hint=''):
    """End all where one process ends by itself; with an error where that was one."""
    if context.is_shutdown:
        return []
    if event.returncode:
        raise RuntimeError(
            f'{event.process_name} ended with exit code {event.returncode}, so all ends{hint}'
        )
    return [Shutdown(reason=f'{event.process_name} has ended')]
