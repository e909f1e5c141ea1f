"""``python -m skfem_joint`` is the command line."""

import sys

# "-m" puts the current folder first on the path, where any file could pass for a library.
if not sys.flags.safe_path:
    del sys.path[0]

from skfem_joint.cli import main

sys.exit(main())
