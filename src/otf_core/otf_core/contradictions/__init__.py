# SPDX-License-Identifier: Apache-2.0
"""Inputs that contradict each other: found in seconds, stated in one message, not solved.

``recording_checks`` looks at recordings, ``no_match`` states why a track does not follow its
path, ``examine`` looks at runs that are reduced to pieces, ``table_checks`` at the tables;
docs/commands.md lists their messages.
"""
