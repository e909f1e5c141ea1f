"""``python -m skfem_joint`` is the command line."""

import sys

from skfem_joint.cli import main

sys.exit(main())
