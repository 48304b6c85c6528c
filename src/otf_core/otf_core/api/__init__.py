# SPDX-License-Identifier: Apache-2.0
"""The functions behind the public names of ``otf_core``: what the command line does, as calls."""
