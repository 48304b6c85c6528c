# SPDX-License-Identifier: Apache-2.0
"""Is a recording usable? Asked in seconds, before anyone dismounts the tracker."""
