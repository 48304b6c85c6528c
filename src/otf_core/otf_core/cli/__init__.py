# SPDX-License-Identifier: Apache-2.0
"""Command line of the offline verbs; ``./otf VERB --help`` describes each.

Exit codes: 0 done, 1 internal error, 2 wrong usage or configuration, 3 input unusable, 4 done but
a quality gate failed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from otf_core.cli.arguments import (
    add_checking_verbs,
    add_judging_verbs,
    add_measuring_verbs,
    add_planning_verbs,
)
from otf_core.cli.exporting import add_exporting_verbs, add_keeping_verbs
from otf_core.cli.options import Handler, read_config
from otf_core.cli.output import LONGEST_MESSAGE, OutputFull, answer, log_to_stderr, note
from otf_core.cli.parser import HelpFormatter, Parser, parse_arguments
from otf_core.cli.simulating import add_plant_verbs
from otf_core.cli.verbs import EXAMPLES, VERBS
from otf_core.errors import OtfError
from otf_core.files.message_text import without_middle
from otf_core.version import __version__


def _examples(name: str) -> str:
    lines = [f'  {line}' for line in EXAMPLES[name]]
    return '\n'.join([f'example{"s" if len(lines) > 1 else ""}:', *lines])


def _parser() -> Parser:
    parser = Parser(
        prog='otf', description='On-the-fly machine-tool calibration: offline commands.',
        epilog='otf VERB --help shows options and examples.',
    )  # fmt: skip
    parser.add_argument('--version', action='version', version=f'otf {__version__}')
    verbs = parser.add_subparsers(dest='verb', metavar='VERB', required=True)

    def verb(name: str, handler: Handler) -> argparse.ArgumentParser:
        sub: argparse.ArgumentParser = verbs.add_parser(
            name, help=VERBS[name], description=VERBS[name], epilog=_examples(name),
            formatter_class=HelpFormatter,
        )  # fmt: skip
        sub.set_defaults(handler=handler, config_values={})
        sub.add_argument(
            '--json', action='store_true', help='print one JSON object; text goes to stderr'
        )
        return sub

    own = (add_checking_verbs, add_measuring_verbs, add_judging_verbs, add_planning_verbs)
    others = (add_exporting_verbs, add_plant_verbs, add_keeping_verbs)
    for add in (*own, *others):
        add(verb)
    return parser


def _joined(argv: Sequence[str]) -> list[str]:
    """Join --tracker-place with its value: argparse takes '-0.3,0,0' for an option."""
    joined: list[str] = []
    for word in argv:
        if joined and joined[-1] == '--tracker-place':
            joined[-1] += '=' + word
        else:
            joined.append(word)
    return joined


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb; return the exit code."""
    arguments = parse_arguments(_parser(), _joined(sys.argv[1:] if argv is None else argv))
    try:
        with log_to_stderr():
            if getattr(arguments, 'config', None):
                verb = getattr(arguments, 'what', arguments.verb)
                arguments.config_values = read_config(arguments.config, verb)
            return int(arguments.handler(arguments))
    except OutputFull as error:
        note(f'otf {arguments.verb}: {error}')
        return error.exit_code
    except OtfError as error:
        words = f'otf {arguments.verb}: {without_middle(str(error), LONGEST_MESSAGE)}'
        if not arguments.json:
            note(words)
        else:
            answer(arguments, words, {'exit': error.exit_code, 'error': str(error)})
        return error.exit_code
    except KeyboardInterrupt:
        note(f'otf {arguments.verb}: interrupted')
        return 130
    except BrokenPipeError:
        sys.stderr.close()
        return 0
