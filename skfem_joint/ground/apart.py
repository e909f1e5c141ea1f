"""Files read by libraries in a process of its own, with a limit of time and of memory.

Compiled libraries follow what a file says, and a damaged one could end this process. The other one
hands arrays over in a file.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from skfem_joint.ground.array_files import npz_arrays

#: Seconds for a file, and bytes beside it that the other process may take for each byte of it.
_SECONDS, _MEMORY, _PER_BYTE = 50, 2**31, 16
#: Status of the other process where its library is not installed.
_MISSING = 3
_SCRIPT = """
import sys
path, to, most = sys.argv[1], sys.argv[2], int(sys.argv[3])
try:
    import numpy as np
    {imports}
except ImportError:
    sys.exit(3)
try:
    import resource
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
except ImportError:
    pass
arrays = {{}}
{read}
np.savez(to, **arrays)
"""


def arrays_read_apart(path: Path, imports: str, read: str, library: str, cure: str) -> dict[
    str, np.ndarray
]:  # fmt: skip
    """Arrays that a few lines of Python put into the dictionary ``arrays``.

    Parameters
    ----------
    path : Path
        File, which the lines have as ``path``.
    imports, read : str
        A line that imports the library, and lines that read the file.
    library, cure : str
        Name of the library, and what to do where it is not installed.

    Raises
    ------
    ValueError
        If the library is not installed, ends with an error, or exceeds its limits.
    """
    with tempfile.TemporaryDirectory() as folder:
        to = Path(folder) / "arrays.npz"
        script = _SCRIPT.format(imports=imports, read=read)
        most = str(_MEMORY + _PER_BYTE * path.stat().st_size)
        command = [sys.executable, "-c", script, str(path.resolve()), str(to), most]
        try:
            ended = subprocess.run(
                command, capture_output=True, text=True, timeout=_SECONDS, check=False
            )
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"could not be read within {_SECONDS} s") from error
        if ended.returncode == _MISSING:
            raise ValueError(f"needs {library}: {cure}")
        if ended.returncode or not to.is_file():
            said = (ended.stderr.strip().splitlines() or ["its reader ended without a word"])[-1]
            raise ValueError(f"{library}: {said[:200]}")
        return npz_arrays(io.BytesIO(to.read_bytes()))
