# SPDX-License-Identifier: Apache-2.0
"""Recordings as people have them: bags, exports of trackers as text, with a path beside them."""
