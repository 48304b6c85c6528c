# SPDX-License-Identifier: Apache-2.0
"""Inputs that contradict each other: found in seconds, said in one message, not solved.

``before`` asks recordings, ``no_match`` says why a track does not follow its path, ``examine``
asks runs that are reduced to pieces, ``worth`` the result. One check is one file; docs/
contradictions.md lists what each says.
"""
