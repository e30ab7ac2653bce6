"""`python -m lss_motion` is `lss-motion`."""

import sys

from lss_motion.cli.start import main

if __name__ == "__main__":
    sys.exit(main())
