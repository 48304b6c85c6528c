# SPDX-License-Identifier: Apache-2.0
"""Markdown tables and lists on the command line, for the benches."""


def heading(titles):
    """First two lines of a table; the first column to the left, the others to the right."""
    return f'| {" | ".join(titles)} |\n|---|{"---:|" * (len(titles) - 1)}'


def row(cells):
    """One line of a table."""
    return f'| {" | ".join(str(c) for c in cells)} |'


def texts(line):
    """Split a list given with commas."""
    return tuple(part.strip() for part in line.split(',') if part.strip())


def numbers(line):
    """Split a list of numbers given with commas."""
    return tuple(float(part) for part in texts(line))
