# SPDX-License-Identifier: Apache-2.0
"""``python -m otf_core.cli VERB ...``."""

import sys

from otf_core.cli import main

if __name__ == '__main__':
    sys.exit(main())
