from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fploc.datasets.link_errors import link_errors
from fploc.datasets.packed import packed_folder, read_packed
from fploc.datasets.reading_example import reading_example

# Whatever of ours or beyond pandas were imported would end the program.
ALONE = """\
import sys
for name in ("fploc", "datamodules", "torch", "cv2", "mlcroissant"):
    sys.modules[name] = None
"""


def test_it_has_ten_lines_of_pandas() -> None:
    lines = reading_example("folder").splitlines()
    assert len([line for line in lines if line]) == 10
    assert [line for line in lines if line.startswith("import")] == [
        "import json, pathlib",
        "import pandas as pd",
    ]


def test_what_it_prints_are_the_median_errors(made_up_root: Path) -> None:
    program = ALONE + reading_example(packed_folder(made_up_root, "made-up-5").as_posix())
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    printed = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()[2:]}
    packed = read_packed(made_up_root, "made-up-5")
    assert printed.keys() == {ap.name for ap in packed.site.access_points}
    for device in (1, 2):
        recordings = [one for one in packed.recordings() if one.device == device]
        errors = link_errors(packed.site, packed.plan, recordings, "repaired")
        for index, ap in enumerate(packed.site.access_points):
            of_one, told = errors.of_access_point(index), float(printed[ap.name][device - 1])
            if not of_one.t_s.size:
                assert np.isnan(told)
                continue
            height = packed.site.height_differences_m[index]
            in_plan = np.sqrt(np.maximum(of_one.range_m**2 - height**2, 0.0))
            distance = np.sqrt(of_one.distance_m**2 - height**2)
            median = float(np.median(in_plan - distance))
            assert told == pytest.approx(median, abs=0.03)
