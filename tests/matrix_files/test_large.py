"""A million unknowns in OUTPUT4 are read within 60 s of one processor and 8 GiB."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from benchmarks import op4_reading

SCRIPT = Path(op4_reading.__file__)


def test_the_file_of_the_benchmark_holds_what_it_says(tmp_path):
    K, *_ = op4_reading.measured(3 * 50)
    node = np.arange(50)
    apart = np.abs(node[:, np.newaxis] - node)
    coupled = np.isin(apart, np.abs(op4_reading.COUPLED))
    blocks = np.where(coupled & (apart > 0), -1.0 / (2.0 + apart), 0.0)
    expected = np.kron(blocks, np.ones((3, 3))) + np.kron(np.eye(50), 29.5 * np.eye(3) + 0.5)
    assert K.toarray() == pytest.approx(expected, rel=1e-15)


@pytest.mark.slow
def test_a_million_unknowns_take_less_than_a_minute_and_8_gib():
    run = [sys.executable, str(SCRIPT), "--unknowns", "1000000"]
    said = subprocess.run(run, capture_output=True, text=True, check=True).stdout
    seconds, gib = map(float, re.findall(r"read in ([\d.]+) s, ([\d.]+) GiB", said)[0])
    assert "999999 unknowns, 32.9 entries a row" in said
    assert seconds < 60.0
    assert gib < 8.0
