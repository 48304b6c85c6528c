# SPDX-License-Identifier: Apache-2.0
"""Budget of uncertainty by source (GUM; JCGM 102 section 6 for several quantities at once)."""
