# SPDX-License-Identifier: Apache-2.0
"""``python -m otf_core.cli VERB ...``."""

import sys

if __name__ == '__main__':
    try:
        from otf_core.cli import main
    except KeyboardInterrupt:
        sys.exit(130)
    sys.exit(main())
